# SPDX-License-Identifier: Apache-2.0
"""``reconstruct``: from a bag, images or videos to point clouds and disparity maps."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from binocular_recon.cli.options import (
    BAG_FORMS,
    add_chain_options,
    add_flags,
    add_output_option,
    chain_config,
    names,
    note,
    positive,
    say,
)
from binocular_recon.errors import ConfigError
from binocular_recon.inputs.options import PairingOptions
from binocular_recon.io.pairs.file_lists import is_video
from binocular_recon.io.pairs.file_pairs import PAIR_BY

if TYPE_CHECKING:
    from binocular_recon.apps.pair_input import PairInput


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``reconstruct``."""
    parser.add_argument(
        'inputs',
        nargs='+',
        metavar='INPUT',
        help=f'a bag ({BAG_FORMS}); or LEFT and RIGHT, each a folder of images, a quoted pattern'
        " such as 'left_*.png', an image or a video; or one video that shows left and right side"
        ' by side',
    )
    add_output_option(
        parser,
        content='NNNNNN.ply, NNNNNN_disparity.pfm and .png of each frame, and summary.json; files'
        ' of an earlier run are replaced',
    )
    parser.add_argument(
        '--resume',
        action=argparse.BooleanOptionalAction,
        default=True,
        help='continue an interrupted run of the same input and options; --no-resume starts over',
    )
    parser.add_argument(
        '--every', type=positive(int), default=1, metavar='N', help='reconstruct every Nth pair'
    )
    parser.add_argument(
        '--max-frames', type=positive(int), metavar='N', help='stop after N frames'
    )
    parser.add_argument(
        '--format',
        type=names,
        default=[],
        metavar='NAME,...',
        help='also write these: las, laz, e57 (clouds), tiff, png (depth in metres, millimetres),'
        ' grey, colour (depth to look at), drawing',
    )
    parser.add_argument(
        '--drawings',
        '--pictures',
        action='store_true',
        help='as --format drawing: each cloud beside the left image, NNNNNN_cloud.png',
    )
    parser.add_argument(
        '--near',
        type=positive(float),
        metavar='M',
        help='nearest depth to search, metres; instead of a range in pixels',
    )
    parser.add_argument(
        '--far',
        type=positive(float),
        metavar='M',
        help='with --near: farthest depth to search (infinity)',
    )
    parser.add_argument(
        '--least-matched',
        type=float,
        default=10.0,
        metavar='PERCENT',
        help='exit with status 1 if a smaller share of the pixels is measured (%(default)g)',
    )
    parser.add_argument(
        '--jobs',
        type=positive(int),
        default=1,
        metavar='N',
        help='compute N frames at a time, by processes that share the cores (%(default)s)',
    )
    parser.add_argument(
        '--scheduler',
        default='',
        metavar='ADDRESS',
        help='compute frames on a Dask cluster, whose scheduler has this address: tcp://host:8786',
    )
    _add_input_options(parser)
    add_chain_options(parser)


def _add_input_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        'input options',
        'Of a bag by default image_raw and camera_info, or image_rect, under left/ and right/, in'
        ' the only namespace that has them; raw or compressed.',
    )
    group.add_argument('--namespace', metavar='NAME', help='namespace of the rig')
    for side in ('left', 'right'):
        group.add_argument(f'--{side}-image', metavar='TOPIC', help=f'image of the {side} camera')
        group.add_argument(
            f'--{side}-info',
            metavar='TOPIC',
            help=f'its CameraInfo (by default camera_info beside --{side}-image)',
        )
    group.add_argument(
        '--rectified',
        action=argparse.BooleanOptionalAction,
        help='whether the images are rectified: of files and videos, and of --left-image and'
        ' --right-image (by default if their name or folder has the word rect)',
    )
    group.add_argument(
        '--calibration',
        type=Path,
        metavar='PATH',
        help='folder with left.yaml and right.yaml, which image files need and which replace the'
        ' camera_info of a bag; or the calibration of another program (see import-calibration)',
    )
    group.add_argument(
        '--alpha',
        type=float,
        default=-1.0,
        metavar='NUMBER',
        help='-1 rectifies with P as calibrated; 0 crops to valid pixels, 1 keeps all pixels'
        ' (%(default)s)',
    )
    group.add_argument(
        '--pair-by',
        choices=PAIR_BY,
        help='what tells which image files belong together: the number in their names, their order'
        ' or their EXIF times; of videos order or times (by default what fits the files; it is'
        ' said)',
    )
    group.add_argument(
        '--approximate-sync-tolerance-seconds',
        type=positive(float),
        default=0.0,
        metavar='SECONDS',
        help='pair images whose stamps differ by up to this; by default only equal stamps,'
        ' of files half the shortest time between two images',
    )
    add_flags(group, PairingOptions)


def run(args: argparse.Namespace) -> None:
    """Reconstruct every pair of the input.

    Raises
    ------
    BinocularReconError
        If nothing can be reconstructed; or, after the rest was, if a part could not be.

    """
    from binocular_recon.apps.reconstruction import reconstruct_pairs

    source = _input(args)
    _check_input_options(args)
    formats = [*args.format, *(['drawing'] if args.drawings else [])]
    config = chain_config(args)
    say(
        reconstruct_pairs(
            source,
            args.output,
            args.preset,
            config,
            formats=formats,
            least_matched=args.least_matched / 100,
            resume=args.resume,
            jobs=args.jobs,
            scheduler=args.scheduler,
            report=note,
        )
    )


def _input(args: argparse.Namespace) -> PairInput:
    """Return the input that the arguments name."""
    from binocular_recon.apps.bag_input import BagInput
    from binocular_recon.apps.file_input import FileInput
    from binocular_recon.io.pairs.file_lists import holds_images

    common: dict[str, Any] = {
        'rectified': args.rectified,
        'calibration': args.calibration,
        'alpha': args.alpha,
        'tolerance_ns': round(args.approximate_sync_tolerance_seconds * 1e9),
        'pairing': PairingOptions(
            **{name: getattr(args, name) for name in ('pairing', 'stamp_offset') if name in args}
        ),
        'every': args.every,
        'max_frames': args.max_frames,
        'near_m': args.near,
        'far_m': math.inf if args.far is None else args.far,
    }
    if _of_files(args):
        left, right = (*args.inputs, '')[:2]
        return FileInput(left, right, args.pair_by, **common)
    bag = Path(args.inputs[0])
    if holds_images(bag):
        raise ConfigError(
            f'{bag} is a folder of images; give the images of the left and of the right camera:'
            ' reconstruct LEFT RIGHT'
        )
    images, infos = _both(args, 'image'), _both(args, 'info')
    return BagInput(bag, args.namespace, images, infos, **common)


def _of_files(args: argparse.Namespace) -> bool:
    """Tell whether the input is not a bag; raises a ConfigError if there are too many."""
    if len(args.inputs) > 2:
        raise ConfigError(
            f'{len(args.inputs)} inputs are given, {args.inputs[0]!r} to {args.inputs[-1]!r};'
            " quote patterns, as in 'left_*.png' 'right_*.png', so that the shell keeps them"
        )
    return len(args.inputs) == 2 or is_video(args.inputs[0])


def _check_input_options(args: argparse.Namespace) -> None:
    """Raise a ConfigError if an option would have no effect together with the others."""
    if args.far is not None and args.near is None:
        raise ConfigError('--far can only be used with --near; give both')
    if args.near is not None and ('disparity_range' in args or 'min_disparity' in args):
        raise ConfigError(
            '--near and --far replace --min-disparity and --disparity-range; omit one pair'
        )
    if _of_files(args):
        _refuse(args, 'of a bag, not of files', 'namespace', 'left_image', 'right_image')
        _refuse(args, 'of a bag, not of files', 'left_info', 'right_info')
        if 'pairing' in args:
            raise ConfigError('--pairing is an option of a bag; for files give --pair-by')
        return
    _refuse(args, 'of image files and videos, not of a bag', 'pair_by')
    if args.left_image is None:
        for flag, value in (
            ('--left-info and --right-info', args.left_info),
            ('--rectified', args.rectified),
        ):
            if value is not None:
                raise ConfigError(
                    f'{flag} can only be used with --left-image and --right-image; give those too'
                )
    elif args.namespace is not None:
        raise ConfigError(
            '--namespace selects the topics that --left-image and --right-image name; omit one of'
            ' them'
        )
    if args.calibration is not None and args.left_info is not None:
        raise ConfigError(
            '--calibration replaces the topics of --left-info and --right-info; omit one of them'
        )


def _refuse(args: argparse.Namespace, kind: str, *names: str) -> None:
    """Raise a ConfigError if an option is given that belongs to another kind of input."""
    for name in names:
        if getattr(args, name) is not None:
            raise ConfigError(f'--{name.replace("_", "-")} is an option {kind}; omit it')


def _both(args: argparse.Namespace, kind: str) -> tuple[str, str] | None:
    """Return the topics named for left and right, or None if neither is."""
    left, right = getattr(args, f'left_{kind}'), getattr(args, f'right_{kind}')
    if (left is None) != (right is None):
        raise ConfigError(f'--left-{kind} and --right-{kind} belong together; give both')
    return None if left is None else (left, right)
