# SPDX-License-Identifier: Apache-2.0
"""``calibrate``: calibrate a rig from images of rods or points of another detector."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple, TypeVar

from binocular_recon.apps.progress import ProgressBar
from binocular_recon.calibration.holding import check_holding
from binocular_recon.calibration.model import DEFAULT_LENS, calibrated_lenses, lens_text
from binocular_recon.calibration.result import DEPTHS_M, CalibrationResult
from binocular_recon.calibration.screening import Rejected
from binocular_recon.calibration.session.calibration_files import save_calibration
from binocular_recon.calibration.session.captures import BoardReading, find_boards, read_captures
from binocular_recon.calibration.session.points_csv import read_points
from binocular_recon.calibration.solve import calibrate
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.rods import RodBoard, load_rods
from binocular_recon.calibration.target.target import Target
from binocular_recon.camera import StereoRig
from binocular_recon.cli.options import add_output_option, image_size, positive, say
from binocular_recon.errors import CalibrationError, ConfigError
from binocular_recon.evaluation.calibration.self_check import self_check
from binocular_recon.inputs.common_size import CommonSize
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.io.files import make_folder, write_json
from binocular_recon.machine import now_text, peak_bytes
from binocular_recon.measurement.check_distance import check_distances
from binocular_recon.measurement.results import CHECK_FILE
from binocular_recon.number_text import counted, significant

_Result = TypeVar('_Result')

# Rows of a table of points that are named one by one when they are left out.
_MOST_NAMED = 20


class _Marks(NamedTuple):
    """What a calibration is computed from."""

    captures: Sequence[Capture]
    target: RodBoard | Target
    sizes: CommonSize
    rejected: Sequence[Rejected] = ()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``calibrate``."""
    parser.add_argument(
        'captures', nargs='?', type=Path, metavar='DIR',
        help='folder of images left_NAME.png and right_NAME.png, one pair per board',
    )  # fmt: skip
    parser.add_argument(
        '--rods', type=Path, metavar='FILE.yaml', help='rods.yaml: the rods in the images'
    )
    parser.add_argument(
        '--points', type=Path, metavar='FILE.csv',
        help='instead of images: points of a flat target from another detector, with the columns'
        ' name, side, id, X_m, Y_m, u_px, v_px',
    )  # fmt: skip
    parser.add_argument(
        '--image-size', metavar='WxH', help='size of the images that --points were found in'
    )
    parser.add_argument(
        '--right-image-size', metavar='WxH',
        help='that of the right images, if it differs from the left ones',
    )  # fmt: skip
    parser.add_argument(
        '--lens', default=DEFAULT_LENS, choices=calibrated_lenses(),
        help=f'{lens_text()} (%(default)s)',
    )  # fmt: skip
    parser.add_argument(
        '--self-check', action='store_true',
        help='instead of calibrating: compare the method with the Cramer-Rao bound on simulated'
        ' boards, and repeat the tables of the paper on calibration',
    )  # fmt: skip
    parser.add_argument(
        '--sets',
        type=positive(int),
        default=20,
        metavar='N',
        help='number of sets of boards for --self-check (%(default)s)',
    )
    parser.add_argument(
        '--draws',
        type=positive(int),
        default=5,
        metavar='N',
        help='number of draws per set for --self-check (%(default)s)',
    )
    parser.add_argument(
        '--check', type=Path, metavar='RIG',
        help='instead of calibrating: check whether the calibration in the folder RIG still holds'
        ' for these boards: rows, and a check distance on each, of a rod or of two --points;'
        ' exit status 1 if it does not; with --output also DIR/check.json, for the report',
    )  # fmt: skip
    add_output_option(parser, required=False)


def run(args: argparse.Namespace) -> None:
    """Calibrate; write ``left.yaml``, ``right.yaml``, ``calibration.json``, ``report.html``."""
    _check(args)
    if args.self_check:
        make_folder(args.output)
        rows, seconds = _timed(lambda: self_check(args.sets, args.draws, say))
        write_json(args.output / 'self_check.json', rows)
        say(f'{args.output / "self_check.json"} ({seconds:.0f} s)')
        return
    read_marks = _read_points if args.points else _detect_marks
    if args.check:
        _check_holding(read_rig(args.check), read_marks(args), args.output)
        return
    (captures, target, sizes, rejected), marks_s = _timed(lambda: read_marks(args))
    result, solve_s = _timed(
        lambda: calibrate(
            captures,
            target,
            sizes.left,
            right_size=sizes.right,
            lens=args.lens,
            rejected=rejected,
        )
    )
    files, save_s = _timed(lambda: save_calibration(result, args.output, captures=args.captures))
    say(summary(result))
    say(', '.join(str(path) for path in files))
    peak = peak_bytes()
    say(
        f'{counted(len(captures) + len(rejected), "board")} in {marks_s + solve_s + save_s:.1f} s:'
        f' marks {marks_s:.1f} s, calibration {solve_s:.1f} s, report {save_s:.1f} s'
        + (f'; at most {peak / 1e6:.0f} MB of memory' if peak else '')
    )


def summary(result: CalibrationResult) -> str:
    """Return the result in a few lines, with Table 2 of the paper."""
    lines = [f'{"board":>12} {"marks":>6} {"planar":>9} {"corrected":>9} {"adjusted":>9}  px']
    content = result.to_mapping()
    lines += [
        f'{board["name"]:>12} {board["marks"]:6d} {board["uncorrected_px"]:9.3f}'
        f' {board["corrected_px"]:9.3f} {board["adjusted_px"]:9.3f}'
        for board in content['boards']
    ]
    lines += [f'left out: {board.name}: {board.reason}' for board in result.rejected]
    lines += [f'note: {warning}' for warning in result.warnings]
    rows = content['row_difference_px']
    sigma, calibration = result.sigma, result.calibration
    depths = (f'{significant(1e3 * result.depth_sigma_m(z))} mm at {z:g} m' for z in DEPTHS_M)
    means = ', '.join(f'{name} {values["mean"]:.3f}' for name, values in rows.items())
    lines += [
        f'{result.line} difference, mean: {means} px',
        (
            f'baseline {1e3 * calibration.baseline_m:.2f} +-'
            f' {significant(1e3 * sigma["baseline_m"], 2)} mm, focal length'
            f' {result.rig.left.K[0, 0]:.2f} / {result.rig.right.K[0, 0]:.2f} +-'
            f' {significant(sigma["fx_left_px"], 2)} px, stereo RMS {result.rms_px:.4f} px'
        ),
        f'depth sigma: {", ".join(depths)}',
    ]
    if warp := content['board_warp_m']:
        parts = (
            f'{axis} {1e3 * warp[axis]:+.2f} +- {significant(1e3 * warp["sigma"][axis], 2)} mm'
            for axis in 'xy'
        )
        lines.append(f'warp of the board: {", ".join(parts)}')
    if not result.halves.warning:
        lines.append(str(result.halves))
    lines += [f'next: {advice}' for advice in result.advice[:1]]
    return '\n'.join(lines)


def _check(args: argparse.Namespace) -> None:
    """Raise a ConfigError for arguments that are missing or contradict each other."""
    if args.output is None and not args.check:
        raise ConfigError('give --output DIR, the folder for the results')
    if args.check and args.self_check:
        raise ConfigError('--check and --self-check exclude each other; omit one of them')
    if args.self_check:
        return
    if (args.captures is None) == (args.points is None):
        raise ConfigError('give either a folder of images or --points FILE.csv')
    if args.points and args.rods:
        raise ConfigError('--rods describes rods in images; --points has its own coordinates')
    if args.captures and args.rods is None:
        raise ConfigError('images of rods need --rods rods.yaml')
    if args.right_image_size and not args.image_size:
        raise ConfigError('--right-image-size needs --image-size, that of the left images')
    if args.captures and args.image_size:
        raise ConfigError('--image-size belongs to --points; images have their own size')


def _check_holding(rig: StereoRig, marks: _Marks, output: Path | None) -> None:
    """Print how well a calibration explains new marks; raise a CalibrationError if it does not.

    The result is written to ``check.json`` in ``output``, if that is given.
    """
    holding = check_holding(rig, marks.captures, marks.target, marks.sizes.left, marks.sizes.right)
    for board in (*marks.rejected, *holding.left_out):
        say(f'left out: {board.name}: {board.reason}')
    boards, marks_ = counted(holding.boards, 'board'), counted(holding.marks, 'mark')
    say(f'{boards}, {marks_}: {holding}')
    odd = {board.name for board in holding.left_out}
    kept = [capture for capture in marks.captures if capture.name not in odd]
    distances = check_distances(rig, kept, marks.target)
    for distance in distances:
        say(distance)
    faults = [*holding.faults, *(str(one) for one in distances if not one.passed)]
    if output:
        make_folder(output)
        content = {
            'date': now_text(),
            'rows': str(holding),
            'distances': [one.to_mapping() for one in distances],
            'left_out': [asdict(board) for board in (*marks.rejected, *holding.left_out)],
            'faults': faults,
        }
        write_json(output / CHECK_FILE, content)
        say(output / CHECK_FILE)
    if faults:
        raise CalibrationError(
            f'the calibration does not hold: {"; ".join(faults)}; check the heights of the'
            ' marks in the description of the target, else calibrate again'
        )
    say('the calibration holds')


def _detect_marks(args: argparse.Namespace) -> _Marks:
    board = load_rods(args.rods)
    done: list[BoardReading] = []
    with ProgressBar(len(find_boards(args.captures)), 'boards') as bar:

        def on_progress(reading: BoardReading) -> None:
            done.append(reading)
            bar.show(len(done), reading.reason)

        found = read_captures(args.captures, board, on_progress)
    return _Marks(found.captures, board, found.sizes, found.rejected)


def _read_points(args: argparse.Namespace) -> _Marks:
    table = read_points(args.points)
    for reason in table.left_out[:_MOST_NAMED]:
        say(f'left out: {reason}')
    if len(table.left_out) > _MOST_NAMED:
        say(f'left out: {len(table.left_out) - _MOST_NAMED} more rows')
    if args.image_size is None:
        size = right_size = table.least_size
        say('image size assumed to be {}x{} px; give --image-size WxH if it is not'.format(*size))
    else:
        size = image_size(args.image_size)
        right_size = image_size(args.right_image_size) if args.right_image_size else size
    return _Marks(table.captures, table.target, CommonSize(size, right_size))


def _timed(job: Callable[[], _Result]) -> tuple[_Result, float]:
    """Return what a job returns and how long it took, s."""
    start = time.monotonic()
    return job(), time.monotonic() - start
