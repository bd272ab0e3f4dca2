# SPDX-License-Identifier: Apache-2.0
"""``import-calibration``: ``left.yaml`` and ``right.yaml`` from another program's files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from binocular_recon.cli.options import add_output_option, image_size, names, note, positive, say
from binocular_recon.errors import ConfigError

if TYPE_CHECKING:
    from binocular_recon.io.calibrations.assembly import ImportedRig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``import-calibration``."""
    from binocular_recon.io.calibrations.registry import formats_text

    parser.epilog = f'Read are {formats_text()}.'
    parser.add_argument(
        'files',
        nargs='+',
        type=Path,
        metavar='FILE',
        help='the files of the calibration, or a folder that holds them',
    )
    add_output_option(
        parser, content='left.yaml and right.yaml; a calibration there moves to previous/'
    )
    parser.add_argument(
        '--cameras',
        type=names,
        metavar='NAME,NAME',
        help='the two cameras to take of more than two (by default the first two of the file)',
    )
    parser.add_argument(
        '--image-size', metavar='WxH', help='size of the images, where the files do not state it'
    )
    parser.add_argument(
        '--baseline',
        type=positive(float),
        metavar='M',
        help='distance between the cameras, metres, where the unit of the files is another one or'
        ' unknown',
    )


def run(args: argparse.Namespace) -> None:
    """Read the calibration and write its camera files.

    Raises
    ------
    BinocularReconError
        If the files are not the calibration of a rig, or cannot be written.

    """
    from binocular_recon.calibration.session.calibration_files import save_rig
    from binocular_recon.io.calibrations.raw_rig import Choice
    from binocular_recon.io.calibrations.registry import read_calibration

    cameras = args.cameras
    if cameras is not None and len(cameras) != 2:
        raise ConfigError(f'--cameras takes two names such as cam0,cam1, got {len(cameras)}')
    choice = Choice(
        (cameras[0], cameras[1]) if cameras else None,
        image_size(args.image_size) if args.image_size else None,
        args.baseline,
    )
    found = read_calibration(args.files, choice)
    save_rig(found.rig, args.output)
    for text in found.rig.notices:
        note(text)
    for text in found.rig.warnings:
        note(f'warning: {text}')
    say(f'{args.output}: {_sentence(found)}')


def _sentence(found: ImportedRig) -> str:
    rig = found.rig
    focal = [
        f'{side} {camera.K[0, 0]:.2f} and {camera.K[1, 1]:.2f} px'
        for side, camera in (('left', rig.left), ('right', rig.right))
    ]
    return (
        f'calibration of {found.format}, {found.names[0]} is the left camera, {found.names[1]} the'
        f' right one; baseline {rig.baseline_m:.4f} m, focal lengths {", ".join(focal)},'
        f' rectified {rig.focal_px:.2f} px; images of {rig.left.width}x{rig.left.height} px'
    )
