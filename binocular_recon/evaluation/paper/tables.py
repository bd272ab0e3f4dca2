# SPDX-License-Identifier: Apache-2.0
"""Tables 1, 2 and 3 of the paper beside ours, as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from binocular_recon.evaluation.paper.runs import MARK_NOISE_PX, PaperRun
from binocular_recon.evaluation.paper.site import PICK_NOISE_PX
from binocular_recon.evaluation.paper.sizes import BICYCLE, PEOPLE
from binocular_recon.evaluation.tables import markdown_table
from binocular_recon.number_text import counted, fixed

# Table 1: uncorrected left and right row, corrected left and right row of six points, px.
PAPER_ROWS = (
    (488, 483, 389, 387), (539, 534, 441, 441), (589, 584, 492, 491), (639, 634, 543, 543),
    (690, 684, 594, 594), (740, 735, 646, 646),
)  # fmt: skip
# Table 2: uncorrected and corrected error of eleven boards, px.
PAPER_BOARDS = (
    (2.537235, 1.738874), (1.724393, 1.279794), (1.621752, 0.834303), (2.096738, 1.637696),
    (1.885317, 1.330309), (1.764015, 1.296668), (2.030599, 1.433154), (1.641159, 1.171892),
    (0.8406, 1.231024), (1.344919, 0.875873), (2.359082, 1.209277),
)  # fmt: skip
# Table 3: absolute errors, mm.
PAPER_ERRORS_MM = {'person_1': 1.1, 'person_2': 4.0, 'bicycle': 6.7}
NAMES = {
    'person_1': 'person 1, 1795 mm high',
    'person_2': 'person 2, 1810 mm high',
    'bicycle': 'bicycle, wheelbase 1000 mm',
}


def report(runs: Sequence[PaperRun]) -> str:
    """Return all tables, each with what a reader must know to compare it."""
    first = [run for run in runs if run.seed == runs[0].seed]
    rows = '; '.join(
        f'{_placement(placement)}: '
        + ', '.join(f'{name} {value:.3f}' for name, value in mean_rows_px(runs, placement).items())
        for placement in sorted({run.placement_m for run in runs})
    )
    shown = nearest_to_paper(runs)
    rendered = len({run.seed for run in runs if run.rendered})
    text_1 = (
        'Table 1: rows of the marks of one rod on a board that was not used to calibrate'
        f' ({_placement(shown.placement_m)}; site {shown.seed}, whose row differences are closest'
        " to the paper's). Mean difference of the marks on all sites' boards that were not used,"
        ' px:'
        f' {rows}.'
    )
    text_2 = (
        'Table 2: reprojection error in the original images,'
        f' {counted(len(first[0].boards_px), "board")} of one site,'
        f' {_marks(first[0])}.{_other_sites(runs)}'
    )
    text_3 = (
        f'Table 3: sizes at 10-20 m, {counted(len({run.seed for run in runs}), "site")},'
        f' {len(runs[0].errors_mm[BICYCLE])} picks of each end point with {PICK_NOISE_PX:g} px of'
        f' noise per axis; rods of {counted(rendered, "site")} detected in'
        ' images. Picking alone: the same picks with perfect calibration and depth.'
    )
    tables = (table_1(shown), table_2(first), table_3(runs))
    pairs = zip((text_1, text_2, text_3), tables, strict=True)
    return '\n\n'.join(part for pair in pairs for part in pair)


def table_1(run: PaperRun) -> str:
    """Return rows of six marks before and after correction, the paper's and ours."""
    header = ['row of a mark, px', 'paper: left', 'right', 'corrected left', 'right']
    header += ['ours: left', 'right', 'corrected left', 'right', 'adjusted left', 'right']
    pairs = zip(PAPER_ROWS, run.rows, strict=True)
    rows = [
        [f'point {i + 1}', *(f'{row}' for row in paper), *(fixed(row) for row in ours)]
        for i, (paper, ours) in enumerate(pairs)
    ]
    rows.append(['mean difference', *_differences(PAPER_ROWS, 1), *_differences(run.rows, 2)])
    return markdown_table(header, rows)


def table_2(runs: Sequence[PaperRun]) -> str:
    """Return reprojection errors per board, the paper's and the first run's per placement."""
    header = ['board, px', 'paper: uncorrected', 'corrected']
    columns: list[list[float]] = []
    for run in runs:
        header += [f'{_placement(run.placement_m)}: planar', 'corrected', 'adjusted']
        columns += [
            [board[f'{stage}_px'] for board in run.boards_px]
            for stage in ('uncorrected', 'corrected', 'adjusted')
        ]
    count = max(len(column) for column in columns)
    paper = [[board[i] for board in PAPER_BOARDS] for i in range(2)]
    everything = [*paper, *columns]
    rows = [
        [f'{i + 1}', *(fixed(c[i], 3) if i < len(c) else '' for c in everything)]
        for i in range(count)
    ]
    rows.append(['mean', *(fixed(float(np.mean(column)), 3) for column in everything)])
    return markdown_table(header, rows)


def table_3(runs: Sequence[PaperRun]) -> str:
    """Return mean absolute errors of the sizes, the paper's and ours per placement."""
    placements = sorted({run.placement_m for run in runs})
    header = ['mean absolute error, mm', 'paper']
    header += [f'ours, {_placement(placement)}' for placement in placements]
    header.append('picking alone')
    rows = []
    for name in (*PEOPLE, BICYCLE):
        ours = [mean_error_mm(_of(runs, placement), 'errors_mm', name) for placement in placements]
        floor = mean_error_mm(runs, 'floor_mm', name)
        values = (PAPER_ERRORS_MM[name], *ours, floor)
        rows.append([NAMES[name], *(fixed(value) for value in values)])
    means = [mean_of_three_mm(_of(runs, placement), 'errors_mm') for placement in placements]
    paper = float(np.mean(list(PAPER_ERRORS_MM.values())))
    values = (paper, *means, mean_of_three_mm(runs, 'floor_mm'))
    rows.append(['mean of the three', *(fixed(value) for value in values)])
    ground = [mean_of_three_mm(_of(runs, p), 'errors_mm', 'on_ground_mm') for p in placements]
    rows.append(['mean, soles on the ground plane', '', *(fixed(value) for value in ground), ''])
    ratios = (fixed(_ratio(_of(runs, placement)), 2) for placement in placements)
    rows.append(['RMS of error / stated sigma', '', *ratios, ''])
    for key, text in (('on_ground_mm', 'sole on the ground plane'), ('automatic_mm', 'automatic')):
        for name in PEOPLE:
            ours = [mean_error_mm(_of(runs, placement), key, name) for placement in placements]
            label = f'{NAMES[name].split(",")[0]}, {text}'
            rows.append([label, '', *(fixed(value) for value in ours), ''])
    return markdown_table(header, rows)


def _marks(run: PaperRun) -> str:
    if run.rendered:
        return 'rods detected in images'
    return f'marks simulated with {MARK_NOISE_PX:g} px of noise'


def _other_sites(runs: Sequence[PaperRun]) -> str:
    """Return Table 2's means over all sites with simulated marks, if those are not the first."""
    if not runs[0].rendered or all(run.rendered for run in runs):
        return ''
    simulated = [run for run in runs if not run.rendered]
    means = []
    for placement in sorted({run.placement_m for run in simulated}):
        boards = [board for run in _of(simulated, placement) for board in run.boards_px]
        values = ' / '.join(
            fixed(float(np.mean([board[f'{stage}_px'] for board in boards])), 3)
            for stage in ('uncorrected', 'corrected', 'adjusted')
        )
        means.append(f'{_placement(placement)}: {values}')
    return (
        f' Mean of {counted(len({run.seed for run in simulated}), "other site")},'
        f' {_marks(simulated[0])}, planar / corrected / adjusted, px: {"; ".join(means)}.'
    )


def nearest_to_paper(runs: Sequence[PaperRun]) -> PaperRun:
    """Return the run, rods placed best, whose uncorrected rows differ most like Table 1's."""
    paper_px = float(np.mean(np.abs(np.diff(PAPER_ROWS)[:, 0])))
    best_placed = _of(runs, min(run.placement_m for run in runs))
    return min(best_placed, key=lambda run: abs(run.rows_px['uncorrected'] - paper_px))


def mean_rows_px(runs: Sequence[PaperRun], placement_m: float) -> dict[str, float]:
    """Return the mean row difference over the held-out boards of all sites, per stage, px."""
    boards = [run.rows_px for run in _of(runs, placement_m)]
    return {stage: float(np.mean([board[stage] for board in boards])) for stage in boards[0]}


def mean_error_mm(runs: Sequence[PaperRun], key: str, name: str) -> float:
    """Return the mean absolute error of a size over runs and picks, mm."""
    return float(np.mean(np.abs([getattr(run, key)[name] for run in runs])))


def mean_of_three_mm(runs: Sequence[PaperRun], key: str, people: str = '') -> float:
    """Return the mean of the three sizes' errors, mm; ``people`` gives those another key."""
    errors = [mean_error_mm(runs, people or key, name) for name in PEOPLE]
    return float(np.mean([*errors, mean_error_mm(runs, key, BICYCLE)]))


def _ratio(runs: Sequence[PaperRun]) -> float:
    """Return the root mean square of the errors of all sizes over their stated sigma."""
    names = (*PEOPLE, BICYCLE)
    errors = np.array([[run.errors_mm[name] for name in names] for run in runs])
    sigmas = np.array([[run.sigmas_mm[name] for name in names] for run in runs])
    return float(np.sqrt(np.mean((errors / sigmas) ** 2)))


def _of(runs: Sequence[PaperRun], placement_m: float) -> list[PaperRun]:
    return [run for run in runs if run.placement_m == placement_m]


def _placement(placement_m: float) -> str:
    return f'rods {1e3 * placement_m:g} mm off' if placement_m else 'rods exact'


def _differences(rows: Sequence[Sequence[float]], digits: int) -> list[str]:
    """Return the mean difference of each pair of columns, under the second one."""
    table = np.asarray(rows, np.float64)
    differences = np.abs(table[:, 0::2] - table[:, 1::2])
    # marks that were not found say nothing
    means = np.ma.masked_invalid(differences).mean(axis=0).filled(np.nan)
    return [cell for mean in means for cell in ('', fixed(float(mean), digits))]
