# SPDX-License-Identifier: Apache-2.0
"""The life of a node's process."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import (
    ExternalShutdownException,
    MultiThreadedExecutor,
    SingleThreadedExecutor,
)
from rclpy.logging import get_logger
from rclpy.node import Node

from binocular_recon.errors import BinocularReconError


def run_node(
    make_node: Callable[[], Node], args: Sequence[str] | None = None, *, threads: int = 1
) -> int:
    """Run a node until it is interrupted (SIGINT, SIGTERM).

    Parameters
    ----------
    make_node : callable
        Makes the node, such as its class.
    args : sequence of str, optional
        Command line; that of the process by default.
    threads : int
        Callbacks that can be under way at once.

    Returns
    -------
    int
        Exit status: 0 when interrupted, 1 if the node refuses its parameters.

    """
    node = None
    rclpy.init(args=None if args is None else list(args))
    try:
        node = make_node()
        executor = SingleThreadedExecutor() if threads == 1 else MultiThreadedExecutor(threads)
        rclpy.spin(node, executor)
    except (BinocularReconError, ParameterException) as error:
        get_logger('binocular_recon').fatal(str(error))
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
