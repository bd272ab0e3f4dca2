# SPDX-License-Identifier: Apache-2.0
"""Run a node in its process, from the command line to the exit status."""

from __future__ import annotations

import atexit
import contextlib
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, ParameterException
from rclpy.executors import (
    ExternalShutdownException,
    MultiThreadedExecutor,
    SingleThreadedExecutor,
)
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from binocular_recon._kernel_cache import compiled_count
from binocular_recon.apps.signals import ignore_signals, leave, raise_signals, raised
from binocular_recon.errors import BinocularReconError, ConfigError
from binocular_recon.nodes.runtime import shared_memory
from binocular_recon.options import KINDS

# The source location that ROS appends to its errors.
_LOCATION = re.compile(r', at \S+:\d+')
# How long a thread may keep the interpreter while others wait for it. Python's 5 ms are as long as
# a kernel runs, after which its thread waits for the one that receives messages.
_SWITCH_S = 0.0005
# How often to log that kernels are still being compiled.
_PROGRESS_EVERY_S = 4.0
# How ROS says that a parameter of its own has a value of a wrong type.
_WRONG_TYPE = re.compile(
    r"parameter '(?P<name>.*)' to '(?P<value>.*)' of type '\w+', expecting type '(?P<kind>\w+)'",
    re.DOTALL,
)
_KINDS = {
    'BOOL': KINDS[bool],
    'INTEGER': KINDS[int],
    'DOUBLE': f'{KINDS[float]} with a decimal point',
    'STRING': KINDS[str],
}


def init_ros(command_line: Sequence[str], **options: Any) -> None:
    """Start ROS with a command line.

    Parameters
    ----------
    command_line : sequence of str
        The program's name and its arguments.
    **options
        Passed to ``rclpy.init``.

    Raises
    ------
    ConfigError
        If ROS rejects an argument, or there is one before ``--ros-args``.

    """
    command_line = list(command_line)
    try:
        others = remove_ros_args(command_line)[1:]
        if not others:
            _prepare_shared_memory()
            rclpy.init(args=command_line, **options)
    except RuntimeError as error:
        reason = _LOCATION.sub('', str(error))
        raise ConfigError(
            f'ROS rejects the arguments {" ".join(command_line[1:])}: {reason}'
        ) from error
    if others:
        raise ConfigError(
            f'unknown arguments {" ".join(others)}; give parameters and remappings after'
            ' --ros-args'
        )


def _prepare_shared_memory() -> None:
    """Make room in shared memory; a process without it goes on, but slower."""
    if not shared_memory.in_use():
        return
    logger = get_logger('binocular_recon')
    freed = shared_memory.remove_leftovers()
    if freed:
        text = f'removed {freed / 1e6:.0f} MB of killed processes from /dev/shm'
        logger.info(text)
    short = shared_memory.shortage()
    if short:
        logger.warning(short)


@contextlib.contextmanager
def parameters_checked() -> Iterator[None]:
    """Raise a ConfigError where ROS refuses a parameter given when a node starts."""
    try:
        yield
    except InvalidParameterTypeException as error:
        found = _WRONG_TYPE.search(str(error))
        if found is None:
            raise ConfigError(f'ROS rejects a parameter: {error}') from error
        kind = _KINDS.get(found['kind'], found['kind'])
        raise ConfigError(
            f'parameter {found["name"]} must be {kind}, got {found["value"]}; correct it on the'
            ' command line or in the parameter file'
        ) from error
    except ParameterException as error:
        raise ConfigError(f'ROS rejects a parameter: {error}') from error


@contextlib.contextmanager
def saying_progress(logger: Any) -> Iterator[None]:
    """Log that kernels are compiled, and how many are, while this lasts longer than loading."""
    done = threading.Event()

    def say() -> None:
        begun_s, before = time.monotonic(), compiled_count()
        while not done.wait(_PROGRESS_EVERY_S):
            text = (
                f'compiling kernels: {compiled_count() - before} after'
                f' {time.monotonic() - begun_s:.0f} s; the first start takes up to half a minute,'
                ' unless binocular-recon warm-up ran at the installation'
            )
            logger.info(text)

    thread = threading.Thread(target=say, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def compile_elsewhere(presets: Sequence[str]) -> None:
    """Start a process, of low priority, that compiles the kernels of presets into the cache.

    It ends with this one.
    """
    command = [sys.executable, '-m', 'binocular_recon', 'warm-up', '--presets', ','.join(presets)]
    nothing = subprocess.DEVNULL
    # not in the current folder, where `-m` would look for modules first
    place = Path(__file__).parents[3]
    process = subprocess.Popen(command, stdin=nothing, stdout=nothing, stderr=nothing, cwd=place)
    os.setpriority(os.PRIO_PROCESS, process.pid, 10)

    def end() -> None:
        process.kill()
        process.wait()

    atexit.register(end)


def run_node(
    make_node: Callable[[], Node], args: Sequence[str] | None = None, *, threads: int = 1
) -> int:
    """Run a node until it is interrupted (SIGINT, SIGTERM).

    Parameters
    ----------
    make_node : callable
        Returns the node, such as its class.
    args : sequence of str, optional
        Command line with the program's name; that of the process by default, whose signals then
        end it.
    threads : int
        Callbacks that can run at the same time.

    Returns
    -------
    int
        Exit status: 0 when interrupted, 1 if arguments or parameters are not valid.

    """
    if args is not None:
        return _run(make_node, args, threads, of_process=False)
    try:
        return _run(make_node, sys.argv, threads, of_process=True)
    except KeyboardInterrupt:  # it was raised after ROS had noticed the signal by itself
        ignore_signals()
        leave(0)
    return 0


def _run(
    make_node: Callable[[], Node], args: Sequence[str], threads: int, *, of_process: bool
) -> int:
    node, status = None, 0
    try:
        if of_process:  # before ROS, whose handlers call these: SIGTERM, too, ends a compilation
            raise_signals()
            sys.setswitchinterval(_SWITCH_S)
        init_ros(args)
        with parameters_checked():
            node = make_node()
        executor = SingleThreadedExecutor() if threads == 1 else MultiThreadedExecutor(threads)
        rclpy.spin(node, executor)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception as error:
        # ROS may turn the interrupt into an error of its own, or be shut down by it
        of_ros = node is not None and isinstance(error, RuntimeError) and not rclpy.ok()
        interrupted = raised() is not None or of_ros
        if not interrupted and not isinstance(error, BinocularReconError):
            raise
        if not interrupted:
            get_logger('binocular_recon').fatal(str(error))
            status = 1
    finally:
        if of_process:
            ignore_signals()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    if of_process and node is None:  # what there is of it may crash when it is taken down
        leave(status)
    return status
