# SPDX-License-Identifier: Apache-2.0
"""``reconstruct``: from a stereo bag to point clouds and disparity maps."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from binocular_recon.cli.options import (
    add_bag_argument,
    add_chain_options,
    add_flags,
    add_output_option,
    chain_config,
    note,
    positive,
)
from binocular_recon.errors import ConfigError
from binocular_recon.inputs.options import PairingOptions


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``reconstruct``."""
    add_bag_argument(parser)
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
        '--drawings',
        '--pictures',
        action='store_true',
        help='also draw each cloud beside the left image: NNNNNN_cloud.png',
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
    _add_input_options(parser)
    add_chain_options(parser)


def _add_input_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        'input options',
        'By default image_raw and camera_info, or image_rect, under left/ and right/, in the only'
        ' namespace that has them; raw or compressed.',
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
        help='whether the images of --left-image and --right-image are rectified (by default if'
        ' their name has the word rect)',
    )
    group.add_argument(
        '--calibration',
        type=Path,
        metavar='PATH',
        help='folder with left.yaml and right.yaml that replace the camera_info of the bag; or the'
        ' calibration of another program (see import-calibration)',
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
        '--approximate-sync-tolerance-seconds',
        type=positive(float),
        default=0.0,
        metavar='SECONDS',
        help='pair images whose stamps differ by up to this; by default only equal stamps',
    )
    add_flags(group, PairingOptions)


def run(args: argparse.Namespace) -> None:
    """Reconstruct every pair of the bag.

    Raises
    ------
    BinocularReconError
        If nothing can be reconstructed; or, after the rest was, if a part could not be.

    """
    from binocular_recon.apps.bag_input import BagInput
    from binocular_recon.apps.bag_reconstruction import reconstruct_bag

    source = BagInput(
        bag=args.bag,
        namespace=args.namespace,
        images=_both(args, 'image'),
        infos=_both(args, 'info'),
        rectified=args.rectified,
        calibration=args.calibration,
        alpha=args.alpha,
        tolerance_ns=round(args.approximate_sync_tolerance_seconds * 1e9),
        pairing=PairingOptions(
            **{name: getattr(args, name) for name in ('pairing', 'stamp_offset') if name in args}
        ),
        every=args.every,
        max_frames=args.max_frames,
        near_m=args.near,
        far_m=math.inf if args.far is None else args.far,
    )
    _check_input_options(args)
    formats = ['drawing'] if args.drawings else []
    config = chain_config(args)
    print(
        reconstruct_bag(
            source,
            args.output,
            args.preset,
            config,
            formats=formats,
            least_matched=args.least_matched / 100,
            resume=args.resume,
            report=note,
        )
    )


def _check_input_options(args: argparse.Namespace) -> None:
    """Raise a ConfigError if an option would have no effect together with the others."""
    if args.far is not None and args.near is None:
        raise ConfigError('--far can only be used with --near; give both')
    if args.near is not None and ('disparity_range' in args or 'min_disparity' in args):
        raise ConfigError(
            '--near and --far replace --min-disparity and --disparity-range; omit one pair'
        )
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


def _both(args: argparse.Namespace, kind: str) -> tuple[str, str] | None:
    """Return the topics named for left and right, or None if neither is."""
    left, right = getattr(args, f'left_{kind}'), getattr(args, f'right_{kind}')
    if (left is None) != (right is None):
        raise ConfigError(f'--left-{kind} and --right-{kind} belong together; give both')
    return None if left is None else (left, right)
