# SPDX-License-Identifier: Apache-2.0
"""The processes of a live measurement: nodes, cameras and a listener; none is left behind."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from binocular_recon.errors import BinocularReconError
from binocular_recon.evaluation.speed.content import Size
from binocular_recon.io.shared_files import shared_file

# How long a process may take to end before it is killed.
_END_WITHIN_S = 10.0
_PROFILE = 'config/fastdds_shared_memory.xml'
NAMESPACE = '/live_benchmark'
_SIDES = ('left', 'right')
_CAMERAS = [f'{side}/{kind}' for side in _SIDES for kind in ('image_raw', 'camera_info')]
_RECTIFIED = [f'{side}/{kind}' for side in _SIDES for kind in ('image_rect', 'camera_info_rect')]
_MEASURED = ['disparity', 'confidence', 'match_validity']


class LiveError(BinocularReconError):
    """A process of a live measurement ended or does nothing."""


class Usage(NamedTuple):
    """What a process has used.

    Attributes
    ----------
    cpu_s : float
        Processor time since its start.
    memory_mb : float
        Resident memory now.

    """

    cpu_s: float
    memory_mb: float


class Process:
    """A process whose output is read as JSON, one object a line.

    Parameters
    ----------
    name : str
        Name in errors.
    command : sequence of str
        Arguments of the interpreter.
    log : Path
        File for its standard error.

    """

    def __init__(self, name: str, command: Sequence[str], log: Path) -> None:
        self.name, self._log = name, log
        with log.open('w', encoding='utf-8') as errors:
            self._process = subprocess.Popen(
                [sys.executable, *command],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                env=_environment(),
            )
        self.messages: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def send(self, command: str) -> None:
        """Write a command to its standard input."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(command + '\n')
            self._process.stdin.flush()
        except OSError:
            self.check()

    def check(self) -> None:
        """Raise a LiveError if the process has ended."""
        if self._process.poll() is not None:
            lines = self._log.read_text(encoding='utf-8', errors='replace').strip().splitlines()
            last = lines[-1] if lines else 'no message'
            raise LiveError(f'{self.name} ended with status {self._process.returncode}: {last}')

    def usage(self) -> Usage:
        """Return what it has used so far."""
        self.check()
        folder = Path('/proc', str(self._process.pid))
        # after the name, which may hold anything: utime and stime are fields 14 and 15
        fields = (folder / 'stat').read_text(encoding='ascii').rpartition(')')[2].split()
        ticks = int(fields[11]) + int(fields[12])
        pages = int((folder / 'statm').read_text(encoding='ascii').split()[1])
        return Usage(ticks / os.sysconf('SC_CLK_TCK'), pages * os.sysconf('SC_PAGE_SIZE') / 1e6)

    def close(self) -> None:
        """End it."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(_END_WITHIN_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None
            with suppress(BrokenPipeError):
                stream.close()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith('{'):
                self.messages.put(json.loads(line))


def node_command(
    name: str,
    namespace: str,
    parameters: Mapping[str, object],
    remappings: Mapping[str, str] | None = None,
) -> list[str]:
    """Return the arguments of the interpreter that run a node."""
    module = f'binocular_recon.nodes.{name}'
    command = ['-c', f'import sys; from {module} import main; sys.exit(main())']
    command += ['--ros-args', '-r', f'__ns:={namespace}']
    for topic, other in (remappings or {}).items():
        command += ['-r', f'{topic}:={other}']
    for parameter, value in parameters.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        command += ['-p', f'{parameter}:={text}']
    return command


def chain_commands(
    size: Size, preset: str, pairs: Path, parameters: Mapping[str, object]
) -> dict[str, list[str]]:
    """Return the command of each process: cameras, listener, and nodes by namespace and name."""
    values: dict[str, object] = {**parameters}
    chain: dict[str, object] = {'preset': preset, 'disparity_range': size.disparity_range}
    commands = {
        'cameras': ['-m', 'binocular_recon.nodes.live.producer', NAMESPACE, str(pairs)],
        'listener': ['-m', 'binocular_recon.nodes.live.listener'],
    }
    cameras = {topic: f'{NAMESPACE}/{topic}' for topic in _CAMERAS}
    space = f'{NAMESPACE}/composed'
    commands['composed/stereo_node'] = node_command(
        'stereo_node', space, {**values, **chain}, cameras
    )
    space = f'{NAMESPACE}/separate'
    commands['separate/rectify_node'] = node_command('rectify_node', space, values, cameras)
    for name, topics in (
        ('match_node', _RECTIFIED),
        ('wls_filter_node', [*_MEASURED, _RECTIFIED[0], *_RECTIFIED[1::2]]),
    ):
        own: dict[str, object] = {
            f'qos_overrides.{space}/{topic}.subscription.reliability': 'reliable'
            for topic in topics
        }
        own |= {**values, 'camera_info': 'camera_info_rect', 'preset': preset}
        if name == 'match_node':
            own['disparity_range'] = size.disparity_range
        commands[f'separate/{name}'] = node_command(name, space, own)
    return commands


@contextmanager
def running(commands: Mapping[str, Sequence[str]], folder: Path) -> Iterator[dict[str, Process]]:
    """Start processes by name, and end them, whatever happens."""
    with ExitStack() as stack:
        processes = {}
        for number, (name, command) in enumerate(commands.items()):
            processes[name] = Process(name, command, folder / f'{number}.log')
            stack.callback(processes[name].close)
        yield processes


def _environment() -> dict[str, str]:
    """Return the environment of the processes: DDS on this machine, as the launch file sets it."""
    profile = str(shared_file(_PROFILE))
    defaults = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    defaults |= dict.fromkeys(
        ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE'), profile
    )
    return {**defaults, **os.environ}
