# SPDX-License-Identifier: Apache-2.0
"""Publish a bag as it was recorded: same bytes, timing and QoS."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from binocular_recon.errors import BagError
from binocular_recon.io.bags.reader import Bag
from binocular_recon.nodes.player import Player
from binocular_recon.nodes.runtime.process import init_ros, parameters_checked


def play(
    path: Path,
    *,
    rate: float = 1.0,
    loop: bool = False,
    clock: bool = False,
    delay_s: float = 0.0,
    ros_args: Sequence[str] = (),
) -> None:
    """Publish the messages of a bag.

    Parameters
    ----------
    path : Path
        Bag of any format.
    rate : float
        Speed as a multiple of that of the recording.
    loop : bool
        Whether to start again at the end, until interrupted.
    clock : bool
        Whether to publish the time of recording as ``/clock``.
    delay_s : float
        Least time before the first message: subscribers on a busy machine or a slow network may
        need it.
    ros_args : sequence of str
        What follows ``--ros-args`` on a node's command line.

    Raises
    ------
    BagError
        If the bag cannot be read, none of its topics can be published, or it is damaged (after
        everything before the damage was played).
    ConfigError
        If ROS rejects ``ros_args`` or a parameter in them.
    KeyboardInterrupt
        After an interruption, when the publishers have been closed.

    """
    with Bag(path) as bag:
        command_line = ['play_bag', *(['--ros-args', *ros_args] if ros_args else [])]
        init_ros(command_line, signal_handler_options=SignalHandlerOptions.NO)
        try:
            with parameters_checked():
                node = Node('play_bag', start_parameter_services=False)
        except BaseException:
            rclpy.try_shutdown()
            raise
        try:
            player = Player(node, bag, rate=rate, clock=clock)
            node.get_logger().info(player.describe())
            player.wait_for_subscribers(delay_s)
            for _ in itertools.count() if loop else (0,):
                player.play_once()
                if loop:
                    player.pause()
            player.wait_for_delivery()
        finally:
            node.destroy_node()
            rclpy.try_shutdown()
        if bag.damage:
            raise BagError('; '.join(bag.damage))
