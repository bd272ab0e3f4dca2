# SPDX-License-Identifier: Apache-2.0
"""``play``: publish a bag on ROS 2 topics."""

from __future__ import annotations

import argparse
import importlib.util
import sys

from binocular_recon.cli.options import NO_ROS, add_bag_argument, positive
from binocular_recon.errors import BinocularReconError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``play``."""
    add_bag_argument(parser)
    parser.add_argument(
        '--rate',
        type=positive(float),
        default=1.0,
        metavar='R',
        help='multiple of the recorded speed (%(default)g)',
    )
    parser.add_argument(
        '--loop', action='store_true', help='start again at the end; stamps then jump back'
    )
    parser.add_argument(
        '--clock', action='store_true', help='publish the recorded time on /clock at 100 Hz'
    )
    parser.add_argument(
        '--delay',
        type=positive(float),
        default=0.0,
        metavar='SECONDS',
        help='minimum time before the first message; by default playback starts when all present'
        ' subscribers are connected, or after 2 s',
    )
    parser.add_argument(
        '--ros-args',
        nargs=argparse.REMAINDER,
        default=[],
        metavar='ARG',
        help='arguments of any ROS node, such as -r OLD:=NEW to remap a topic',
    )


def run(args: argparse.Namespace) -> None:
    """Play the bag.

    Raises
    ------
    BinocularReconError
        If ROS 2 is not installed, or the bag cannot be played to its end.

    """
    if importlib.util.find_spec('rclpy') is None:
        raise BinocularReconError(NO_ROS)
    from binocular_recon.nodes.play_bag import play

    play(
        args.bag,
        rate=args.rate,
        loop=args.loop,
        clock=args.clock,
        delay_s=args.delay,
        ros_args=args.ros_args,
    )


def main() -> int:
    """Run as the executable ``play_bag``."""
    from binocular_recon.cli.main import main as run_command

    sys.argv[1:] = ['play', *sys.argv[1:]]
    return run_command()
