# SPDX-License-Identifier: Apache-2.0
"""``paper``: the paper end to end on simulated sites; its Tables 1, 2 and 3 beside ours."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from binocular_recon.apps.progress import ProgressBar
from binocular_recon.cli.options import add_output_option, non_negative, positive, say
from binocular_recon.errors import CalibrationError
from binocular_recon.evaluation.paper import sigmas
from binocular_recon.evaluation.paper.drawing import draw_crop, draw_sizes
from binocular_recon.evaluation.paper.runs import (
    BOARDS,
    MARK_NOISE_PX,
    FailedRun,
    PaperRun,
    Survey,
    run_paper,
)
from binocular_recon.evaluation.paper.site import PICKS
from binocular_recon.evaluation.paper.tables import mean_of_three_mm, report
from binocular_recon.evaluation.tables import to_plain
from binocular_recon.io.files import complete_file, make_folder, write_json
from binocular_recon.io.image_files import write_image_file
from binocular_recon.machine import machine_facts
from binocular_recon.simulation.rig import TABLE_1_PITCH_RAD, survey_rig

# Standard deviation of the placement of the rods, m.
PLACEMENTS_M = (0.0, 0.005)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``paper``."""
    add_output_option(parser, 'out/paper', 'paper.json, tables.md, sizes.jpg and crop.jpg')
    parser.add_argument(
        '--seeds', type=positive(int), default=10, metavar='N',
        help='number of simulated sites (%(default)s)',
    )  # fmt: skip
    parser.add_argument(
        '--first-seed',
        type=non_negative,
        default=0,
        metavar='N',
        help='seed of the first site; each further site adds 1 (%(default)s)',
    )
    parser.add_argument(
        '--boards', type=positive(int), default=BOARDS, metavar='N',
        help='boards to calibrate with (%(default)s)',
    )  # fmt: skip
    parser.add_argument(
        '--rendered', type=non_negative, default=1, metavar='N',
        help='sites whose rods are rendered in images and detected (%(default)s); for the others,'
        f' marks are simulated with {MARK_NOISE_PX:g} px noise',
    )  # fmt: skip
    parser.add_argument(
        '--sigmas', action='store_true',
        help='instead: compare the points of each site, and lengths between them, with their'
        ' stated sigma; writes sigmas.json',
    )  # fmt: skip


def run(args: argparse.Namespace) -> None:
    """Run all sites, print the tables, write ``paper.json``, ``tables.md`` and two figures.

    The files are written again after each site, so an interruption loses only the current one.
    """
    make_folder(args.output)
    start = time.monotonic()
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    if args.sigmas:
        _compare_sigmas(args.output, seeds)
        say(f'\n{args.output}/sigmas.json ({time.monotonic() - start:.0f} s)')
        return
    rig = survey_rig(pitch_rad=TABLE_1_PITCH_RAD)
    runs: list[PaperRun] = []
    failed: list[FailedRun] = []
    with ProgressBar(len(seeds) * len(PLACEMENTS_M), 'reconstructions') as bar:
        steps = run_paper(rig, seeds, PLACEMENTS_M, boards=args.boards, rendered=args.rendered)
        try:
            for step in steps:
                if isinstance(step, FailedRun):
                    failed.append(step)
                else:
                    _keep(args.output, *step, runs, failed)
                bar.show(len(runs) + len(failed))
        except KeyboardInterrupt:
            kept = f'{len(runs)} finished reconstructions are kept in {args.output}'
            raise KeyboardInterrupt(kept) from None
    if not runs:
        raise CalibrationError(f'no site could be measured; {_failures(failed)}')
    say(_text(runs, failed))
    say(f'\n{args.output}/paper.json, tables.md, sizes.jpg, crop.jpg'
          f' ({time.monotonic() - start:.0f} s)')  # fmt: skip


def _compare_sigmas(folder: Path, seeds: Sequence[int]) -> None:
    """Compare points and lengths with their sigma; ``sigmas.json`` grows with each site."""
    done: list[sigmas.SiteSigmas] = []
    with ProgressBar(len(seeds), 'sites') as bar:
        for site in sigmas.run_sites(survey_rig(), seeds):
            done.append(site)
            write_json(folder / 'sigmas.json', to_plain({'sites': done}))
            bar.show(len(done))
    say(sigmas.report(done))


def facts(runs: Sequence[PaperRun], failed: Sequence[FailedRun] = ()) -> dict[str, Any]:
    """Return the content of ``paper.json``; null = a mark that was not found."""
    placements = sorted({run.placement_m for run in runs})
    means = {
        f'{placement:g}': {
            key: mean_of_three_mm([run for run in runs if run.placement_m == placement], key)
            for key in ('errors_mm', 'floor_mm')
        }
        for placement in placements
    }
    content: dict[str, Any] = to_plain(
        {
            'machine': machine_facts(),
            'mean_of_three_mm': means,
            'picks': PICKS,
            'runs': runs,
            'failed': failed,
        }
    )
    return content


def _keep(
    folder: Path, run: PaperRun, survey: Survey, runs: list[PaperRun], failed: list[FailedRun]
) -> None:
    """Add a run and write the files of all runs."""
    if not runs:
        write_image_file(folder / 'sizes.jpg', draw_sizes(survey, run))
        write_image_file(folder / 'crop.jpg', draw_crop(survey))
    runs.append(run)
    with complete_file(folder / 'tables.md') as file:
        file.write(f'{_text(runs, failed)}\n'.encode())
    write_json(folder / 'paper.json', facts(runs, failed))


def _text(runs: Sequence[PaperRun], failed: Sequence[FailedRun]) -> str:
    return f'{report(runs)}\n\n{_failures(failed)}' if failed else report(runs)


def _failures(failed: Sequence[FailedRun]) -> str:
    reasons = (
        f'seed {run.seed}, rods {1e3 * run.placement_m:g} mm off: {run.reason}' for run in failed
    )
    return f'Not measured: {"; ".join(reasons)}.'
