# SPDX-License-Identifier: Apache-2.0
"""``reconstruct``: a stereo bag in, point clouds and disparity maps out."""

from __future__ import annotations

import argparse
from pathlib import Path

from binocular_recon.cli.options import add_chain_options, chain_config, positive
from binocular_recon.errors import ConfigError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        'bag',
        type=Path,
        metavar='BAG',
        help='folder of a ROS 2 bag, or a .mcap, .db3 or ROS 1 .bag file',
    )
    parser.add_argument(
        '--output',
        type=Path,
        required=True,
        metavar='DIR',
        help='folder for NNNNNN.ply, NNNNNN_disparity.pfm and .png of each frame, summary.json;'
        ' those of an earlier run are replaced',
    )
    parser.add_argument(
        '--every', type=positive(int), default=1, metavar='N', help='take every Nth pair only'
    )
    parser.add_argument(
        '--max-frames', type=positive(int), metavar='N', help='stop after N frames'
    )
    parser.add_argument(
        '--pictures',
        action='store_true',
        help='also draw each cloud, beside the left picture: NNNNNN_cloud.png',
    )
    _add_input_options(parser)
    add_chain_options(parser)


def _add_input_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        'options of the input',
        'By default left/ and right/ image_raw with camera_info, or image_rect, in the only'
        ' namespace that has them; raw or compressed.',
    )
    group.add_argument('--namespace', metavar='NAME', help='namespace of the rig')
    for side in ('left', 'right'):
        group.add_argument(
            f'--{side}-image', metavar='TOPIC', help=f'picture of the {side} camera'
        )
        group.add_argument(
            f'--{side}-info',
            metavar='TOPIC',
            help=f'its CameraInfo (by default camera_info beside --{side}-image)',
        )
    group.add_argument(
        '--rectified',
        action=argparse.BooleanOptionalAction,
        help='whether the pictures that --left-image and --right-image name are rectified (by'
        ' default if their name says so)',
    )
    group.add_argument(
        '--calibration',
        type=Path,
        metavar='DIR',
        help="folder with left.yaml and right.yaml that replaces the bag's camera_info",
    )
    group.add_argument(
        '--alpha',
        type=float,
        default=-1.0,
        metavar='NUMBER',
        help='-1 rectifies with P as calibrated; 0 leaves no empty border, 1 loses no pixel'
        ' (%(default)s)',
    )
    group.add_argument(
        '--approximate-sync-tolerance-seconds',
        type=positive(float),
        default=0.0,
        metavar='SECONDS',
        help='pair pictures whose stamps differ by up to this; by default only equal stamps',
    )


def run(args: argparse.Namespace) -> None:
    """Reconstruct every pair of the bag.

    Raises
    ------
    BinocularReconError
        If there is nothing to reconstruct or, after all that could be read was reconstructed, if
        something could not.

    """
    from binocular_recon.apps.reconstruct_bag import BagInput, reconstruct_bag

    source = BagInput(
        bag=args.bag,
        namespace=args.namespace,
        images=_both(args, 'image'),
        infos=_both(args, 'info'),
        rectified=args.rectified,
        calibration=args.calibration,
        alpha=args.alpha,
        tolerance_ns=round(args.approximate_sync_tolerance_seconds * 1e9),
        every=args.every,
        max_frames=args.max_frames,
        pictures=args.pictures,
    )
    _check_input_options(args)
    print(reconstruct_bag(source, args.output, args.preset, chain_config(args)))


def _check_input_options(args: argparse.Namespace) -> None:
    """Raise a ConfigError if an option would have no effect beside the others."""
    if args.left_image is None:
        for flag, value in (
            ('--left-info and --right-info', args.left_info),
            ('--rectified', args.rectified),
        ):
            if value is not None:
                raise ConfigError(
                    f'{flag} without --left-image and --right-image say nothing; give these too'
                )
    elif args.namespace is not None:
        raise ConfigError(
            '--namespace looks for the topics that --left-image and --right-image name;'
            ' leave one of them out'
        )
    if args.calibration is not None and args.left_info is not None:
        raise ConfigError(
            '--calibration replaces what --left-info and --right-info name; leave one of them out'
        )


def _both(args: argparse.Namespace, kind: str) -> tuple[str, str] | None:
    """Return the topics named for left and right, or None if neither is."""
    left, right = getattr(args, f'left_{kind}'), getattr(args, f'right_{kind}')
    if (left is None) != (right is None):
        raise ConfigError(f'--left-{kind} and --right-{kind} belong together; give both')
    return None if left is None else (left, right)
