# SPDX-License-Identifier: Apache-2.0
"""``simulate rods|scene``: images of rods, or a survey scene as a bag, with ground truth."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from binocular_recon.calibration.target.rods import RodBoard, load_rods, save_rods
from binocular_recon.cli.options import add_output_option, non_negative, positive, say
from binocular_recon.errors import FileError
from binocular_recon.evaluation.calibration.detection import score_capture, summarise_scores
from binocular_recon.images import ByteImage
from binocular_recon.io.bags.writer import BagWriter, write_pair
from binocular_recon.io.files import make_folder, write_json
from binocular_recon.io.image_files import write_image_file
from binocular_recon.io.pfm import write_pfm
from binocular_recon.number_text import counted
from binocular_recon.simulation.capture import (
    CaptureOptions,
    SimulatedCapture,
    mixed_options,
    simulate_capture,
)
from binocular_recon.simulation.render import Sensor
from binocular_recon.simulation.rig import TABLE_1_PITCH_RAD, survey_rig
from binocular_recon.simulation.rods import paper_board, with_placement
from binocular_recon.simulation.scene import (
    build_scene,
    render_scene,
    scene_truth,
    true_disparity,
)

# Time between two frames of a bag.
FRAME_NS = 100_000_000
PHOTOGRAPH_SUFFIXES = {'.jpg', '.jpeg', '.png', '.tif', '.tiff', '.bmp'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``simulate``."""
    kinds = parser.add_subparsers(dest='kind', required=True, metavar='rods|scene')
    rods = kinds.add_parser('rods', help='image pairs of rods in front of clutter')
    _add_common(rods)
    rods.add_argument(
        '--rods',
        type=Path,
        metavar='FILE.yaml',
        help='rods.yaml; by default 5 rods with 6 marks each',
    )
    rods.add_argument(
        '--boards',
        type=positive(int),
        default=11,
        metavar='N',
        help='number of boards (%(default)s)',
    )
    rods.add_argument(
        '--placement',
        type=float,
        metavar='METRES',
        help='standard deviation of the placement; by default that of --rods',
    )
    rods.add_argument(
        '--backgrounds',
        metavar='DIR',
        type=Path,
        help='folder of photographs used as the background of half of the boards',
    )
    rods.add_argument(
        '--evaluate',
        action='store_true',
        help='detect the rods and compare them with the truth (detection.json); writes no images',
    )
    rods.add_argument(
        '--clean',
        action='store_true',
        help='no rod is occluded, cut by the image border or tilted by more than 10 deg',
    )
    scene = kinds.add_parser('scene', help='two people and a bicycle at 10-20 m, as a bag')
    _add_common(scene)
    scene.add_argument(
        '--frames',
        type=positive(int),
        default=1,
        metavar='N',
        help='image pairs in the bag (%(default)s)',
    )


def run(args: argparse.Namespace) -> None:
    """Run ``simulate rods`` or ``simulate scene``."""
    {'rods': _rods, 'scene': _scene}[args.kind](args)


def load_photographs(folder: Path) -> tuple[ByteImage, ...]:
    """Read every image of a folder as (H, W, 3) uint8.

    Raises
    ------
    FileError
        If the folder holds no readable image.

    """
    paths = sorted(p for p in folder.glob('*') if p.suffix.lower() in PHOTOGRAPH_SUFFIXES)
    photographs = tuple(p for p in (cv2.imread(str(path)) for path in paths) if p is not None)
    if not photographs:
        raise FileError(f'{folder} holds no image; give a folder with .jpg or .png files')
    return photographs


def _add_common(parser: argparse.ArgumentParser) -> None:
    add_output_option(parser)
    parser.add_argument(
        '--seed',
        type=non_negative,
        default=0,
        metavar='N',
        help='seed of the random generator (%(default)s)',
    )


def _rods(args: argparse.Namespace) -> None:
    board = load_rods(args.rods) if args.rods else paper_board()
    if args.placement is not None:
        board = with_placement(board, args.placement)
    photographs = load_photographs(args.backgrounds) if args.backgrounds else ()
    rig = survey_rig(pitch_rad=TABLE_1_PITCH_RAD)
    make_folder(args.output)

    def captures() -> Iterator[SimulatedCapture]:
        for index in range(args.boards):
            # a board depends on its own seed, not on the number of boards
            rng = np.random.default_rng([args.seed, index])
            options = CaptureOptions() if args.clean else mixed_options(rng, photographs)
            yield simulate_capture(board, rig, rng, options)
            say(f'board {index + 1} of {args.boards}')

    if args.evaluate:
        _evaluate(board, captures(), args.output)
        return
    boards: list[dict[str, Any]] = []
    for index, capture in enumerate(captures()):
        write_image_file(args.output / f'left_{index:04d}.png', capture.left)
        write_image_file(args.output / f'right_{index:04d}.png', capture.right)
        boards.append({'name': f'{index:04d}', **_truth(capture)})
    save_rods(board, args.output / 'rods.yaml')
    write_json(args.output / 'truth.json', {'rig': rig.to_mapping(), 'boards': boards})


def _evaluate(board: RodBoard, captures: Iterator[SimulatedCapture], output: Path) -> None:
    """Detect the rods of every capture; print and write the figures."""
    figures = summarise_scores([score_capture(board, capture) for capture in captures])
    write_json(output / 'detection.json', figures)
    rms, seconds = figures['rms_px'], figures['seconds_per_image']
    say(
        f'{figures["boards_complete"]} of {figures["boards"]} boards with every mark visible in'
        ' both images;'
        f' {counted(figures["wrong_identities"], "wrong identity", "wrong identities")}; error'
        f' {rms["x"]:.3f} px in x, {rms["y"]:.3f} px in y (RMS of {figures["marks_measured"]}'
        f' marks); {seconds["median"]:.2f} s per image'
    )


def _scene(args: argparse.Namespace) -> None:
    """Write the bag, the last pair as images, and the truth of the left image."""
    rig = survey_rig(pitch_rad=TABLE_1_PITCH_RAD)
    rectified = rig.stereo_rig()
    rng = np.random.default_rng(args.seed)
    scene = build_scene(rng)
    make_folder(args.output)
    with BagWriter(args.output / 'bag') as writer:
        for frame in range(args.frames):
            left, right = (render_scene(scene, view, Sensor(), rng) for view in rig.views())
            write_pair(writer, rectified, (left, right), frame * FRAME_NS)
            say(f'frame {frame + 1} of {args.frames}')
    write_image_file(args.output / 'left.png', left)
    write_image_file(args.output / 'right.png', right)
    write_pfm(args.output / 'disparity.pfm', true_disparity(scene, rectified))
    write_json(args.output / 'truth.json', scene_truth(scene, rig))


def _truth(capture: SimulatedCapture) -> dict[str, Any]:
    return {
        **capture.placed.to_mapping(),
        'left_px': capture.left_px.tolist(),
        'right_px': capture.right_px.tolist(),
        'left_visible': capture.left_visible.tolist(),
        'right_visible': capture.right_visible.tolist(),
    }
