# SPDX-License-Identifier: Apache-2.0
"""``play``: publish a bag on ROS 2 topics."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path

from binocular_recon.cli.options import positive
from binocular_recon.errors import BinocularReconError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        'bag',
        type=Path,
        metavar='BAG',
        help='folder of a ROS 2 bag, or a .mcap, .db3 or ROS 1 .bag file',
    )
    parser.add_argument(
        '--rate',
        type=positive(float),
        default=1.0,
        metavar='R',
        help='speed as a multiple of that of the recording (%(default)g)',
    )
    parser.add_argument(
        '--loop', action='store_true', help='begin again at the end; stamps jump back'
    )
    parser.add_argument(
        '--clock', action='store_true', help='publish the time of recording as /clock, at 100 Hz'
    )
    parser.add_argument(
        '--delay',
        type=positive(float),
        default=0.0,
        metavar='SECONDS',
        help='least time before the first message; without it playing starts when the subscribers'
        ' there are have been found, or after 2 s',
    )
    parser.add_argument(
        '--ros-args',
        nargs=argparse.REMAINDER,
        default=[],
        metavar='ARG',
        help='arguments of every ROS node, such as -r OLD:=NEW for a topic',
    )


def run(args: argparse.Namespace) -> None:
    """Play the bag.

    Raises
    ------
    BinocularReconError
        If there is no ROS 2, or no bag that can be played to its end.

    """
    if importlib.util.find_spec('rclpy') is None:
        raise BinocularReconError(
            'ROS 2 is not installed, or not for this Python: there is no rclpy; source the setup'
            ' file of an installation or install the ROS wheels (make setup)'
        )
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

    return run_command(['play', *sys.argv[1:]])
