# SPDX-License-Identifier: Apache-2.0
"""The life of a node's process."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import (
    ExternalShutdownException,
    MultiThreadedExecutor,
    SingleThreadedExecutor,
)
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from binocular_recon.errors import BinocularReconError, ConfigError

# Where in the sources of ROS an error was found.
_PLACE = re.compile(r', at \S+:\d+')


def init_ros(words: Sequence[str], **options: Any) -> None:
    """Start ROS with a command line.

    Parameters
    ----------
    words : sequence of str
        The program's name and its arguments.
    **options
        Passed to ``rclpy.init``.

    Raises
    ------
    ConfigError
        If ROS refuses an argument, or one does not follow ``--ros-args``.

    """
    words = list(words)
    try:
        others = remove_ros_args(words)[1:]
        if not others:
            rclpy.init(args=words, **options)
    except RuntimeError as error:
        reason = _PLACE.sub('', str(error))
        raise ConfigError(f'ROS refuses the arguments {" ".join(words[1:])}: {reason}') from error
    if others:
        raise ConfigError(
            f'arguments {" ".join(others)} are not known; parameters and remappings follow'
            ' --ros-args'
        )


def run_node(
    make_node: Callable[[], Node], args: Sequence[str] | None = None, *, threads: int = 1
) -> int:
    """Run a node until it is interrupted (SIGINT, SIGTERM).

    Parameters
    ----------
    make_node : callable
        Makes the node, such as its class.
    args : sequence of str, optional
        Command line with the program's name; that of the process by default.
    threads : int
        Callbacks that can be under way at once.

    Returns
    -------
    int
        Exit status: 0 when interrupted, 1 if the node refuses its arguments or parameters.

    """
    node = None
    sys.unraisablehook = _show_unraisable
    try:
        init_ros(sys.argv if args is None else args)
        node = make_node()
        executor = SingleThreadedExecutor() if threads == 1 else MultiThreadedExecutor(threads)
        rclpy.spin(node, executor)
    except (BinocularReconError, ParameterException) as error:
        get_logger('binocular_recon').fatal(str(error))
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RuntimeError:
        # an interrupt in a destructor raises nothing; spinning then finds ROS shut down
        if node is None or rclpy.ok():
            raise
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _show_unraisable(unraisable: Any) -> None:
    """Show what cannot be raised, in a destructor, unless it is Ctrl-C."""
    if not issubclass(unraisable.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)
