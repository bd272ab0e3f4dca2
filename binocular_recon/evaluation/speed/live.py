# SPDX-License-Identifier: Apache-2.0
"""Measure the running nodes, by turns with the offline chain on the same images and machine."""

from __future__ import annotations

import functools
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from binocular_recon.config import ChainConfig
from binocular_recon.evaluation.speed.content import Size
from binocular_recon.evaluation.speed.live_content import LiveContent, motorcycle
from binocular_recon.evaluation.speed.live_processes import (
    NAMESPACE,
    LiveError,
    Process,
    chain_commands,
    running,
)
from binocular_recon.stereo.pipeline import Chain

OFFLINE = 'chain alone'
# Clouds that must have come before a measurement begins, and how long they may take: the first
# start of the nodes compiles their kernels.
_SETTLED, _START_WITHIN_S = 3, 300.0
# A measurement lasts until so many clouds have come, at most so many times its length.
_LEAST_CLOUDS, _LONGEST = 5, 4
# Outputs that can be listened to, besides the clouds.
OUTPUTS = {
    'points2': 'PointCloud2',
    'depth': 'Image',
    'disparity': 'DisparityImage',
    'disparity_wls': 'DisparityImage',
    'disparity_color': 'Image',
    'left/image_rect': 'Image',
}


@dataclass(frozen=True)
class LiveOptions:
    """How to measure.

    Attributes
    ----------
    preset : str
        Preset of the nodes and of the offline chain.
    rate_hz : float
        Pairs a second that the cameras produce.
    seconds : float
        Length of one measurement of one contestant.
    rounds : int
        How often each takes its turn.
    outputs : sequence of str
        Topics that are listened to, `points2` among them.
    parameters : mapping
        Further parameters of all nodes.

    """

    preset: str = 'fast'
    rate_hz: float = 15.0
    seconds: float = 8.0
    rounds: int = 3
    outputs: Sequence[str] = ('points2',)
    parameters: Mapping[str, object] = field(default_factory=dict)


class Turn(NamedTuple):
    """One measurement of one contestant."""

    clouds: int
    seconds: float
    cpu_s: float
    latencies_s: list[float]
    memory_mb: float
    dropped: dict[str, float]


@dataclass(frozen=True)
class LiveResult:
    """What one contestant did at one size.

    Attributes
    ----------
    preset, size, name : str
        What was measured; `OFFLINE` is the chain alone.
    clouds_per_s : float
        Median of the rounds.
    relative : float
        To the offline chain, the median of the rounds' ratios.
    latency_s, latency_95_s : float
        From the stamp of a pair to the arrival of its cloud: median and 95 % quantile.
    cpu_s_per_cloud : float
        Processor time of all its processes.
    cpu_relative : float
        Processor time per cloud of the chain alone, relative to it; on a machine with other work
        this holds where ``relative`` does not.
    memory_mb : float
        Largest resident memory of its processes together, at the end of a round.
    dropped : dict
        Pairs per second that were not used, by node and reason.

    """

    preset: str
    size: str
    name: str
    clouds_per_s: float
    relative: float
    latency_s: float
    latency_95_s: float
    cpu_s_per_cloud: float
    cpu_relative: float
    memory_mb: float
    dropped: dict[str, float]


def measure(
    size: Size, options: LiveOptions, progress: Callable[[str], None] = lambda _: None
) -> list[LiveResult]:
    """Measure the offline chain, the composed node and the separate nodes at one size.

    Raises
    ------
    LiveError
        If a process ends, or no cloud comes.
    FileError
        If the images or the DDS profile are not installed.

    """
    content = motorcycle(size)
    turns: dict[str, list[Turn]] = {OFFLINE: [], 'composed': [], 'separate': []}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        content.save(folder / 'pairs.npz')
        with running(
            chain_commands(size, options.preset, folder / 'pairs.npz', options.parameters), folder
        ) as processes:
            offline = _Offline(content, options)
            for number in range(options.rounds):
                for contestant, found in turns.items():
                    progress(f'{contestant} at {size}, round {number + 1}')
                    if contestant == OFFLINE:
                        found.append(offline.measure(options.seconds))
                    else:
                        found.append(_live(contestant, processes, options))
    return [
        _summary((options.preset, str(size), name), found, turns[OFFLINE])
        for name, found in turns.items()
    ]


class _Offline:
    """The chain alone, in this process."""

    def __init__(self, content: LiveContent, options: LiveOptions) -> None:
        config = ChainConfig.preset(options.preset, disparity_range=content.size.disparity_range)
        self._pairs = list(zip(content.left, content.right, strict=True))
        self._chain = Chain(content.rig, config)
        self._chain(*self._pairs[0])

    def measure(self, seconds: float) -> Turn:
        begun_s, cpu_s, count = time.monotonic(), time.process_time(), 0
        while (spent_s := time.monotonic() - begun_s) < seconds or count < _LEAST_CLOUDS:
            self._chain(*self._pairs[count % len(self._pairs)])
            count += 1
        return Turn(count, spent_s, time.process_time() - cpu_s, [], 0.0, {})


def _live(contestant: str, processes: Mapping[str, Process], options: LiveOptions) -> Turn:
    """Measure nodes: the others have no subscribers meanwhile and do nothing."""
    space = f'{NAMESPACE}/{contestant}'
    clouds = f'{space}/points2'
    nodes = {name: one for name, one in processes.items() if name.startswith(contestant)}
    cameras, listener = processes['cameras'], processes['listener']
    topics = ' '.join(f'{space}/{topic} {OUTPUTS[topic]}' for topic in options.outputs)
    listener.send(f'listen {topics}')
    cameras.send(f'rate {options.rate_hz}')
    messages = functools.partial(_messages, processes, listener)
    seen, begun_s = 0, time.monotonic()
    for message in messages():
        seen += message.get('topic') == clouds
        if seen >= _SETTLED:
            break
        if time.monotonic() - begun_s > _START_WITHIN_S:
            raise LiveError(f'no cloud of the {contestant} nodes within {_START_WITHIN_S:g} s')
    before = {name: node.usage() for name, node in nodes.items()}
    begun_s = time.monotonic()
    latencies_s: list[float] = []
    reports: list[Any] = []
    for message in messages():
        if message.get('topic') == clouds:
            latencies_s.append((message['arrived_ns'] - message['stamp_ns']) / 1e9)
        elif str(message.get('node', '')).startswith(space):
            reports.append((time.monotonic(), message))
        seconds = time.monotonic() - begun_s
        enough = len(latencies_s) >= _LEAST_CLOUDS or seconds > _LONGEST * options.seconds
        if seconds >= options.seconds and enough:
            break
    after = {name: node.usage() for name, node in nodes.items()}
    cameras.send('rate 0')
    listener.send('listen')
    return Turn(
        len(latencies_s),
        seconds,
        sum(after[name].cpu_s - before[name].cpu_s for name in nodes),
        latencies_s,
        sum(one.memory_mb for one in after.values()),
        _dropped_per_s(reports, space),
    )


def _messages(processes: Mapping[str, Process], listener: Process) -> Iterator[dict[str, Any]]:
    """Yield what the listener writes, and {} while it writes nothing; check the processes."""
    while not listener.messages.empty():
        listener.messages.get()
    checked_s = time.monotonic()
    while True:
        if listener.messages.empty():
            time.sleep(0.005)
            yield {}
        else:
            yield listener.messages.get()
        if time.monotonic() - checked_s > 1:
            checked_s = time.monotonic()
            for process in processes.values():
                process.check()


def _dropped_per_s(reports: Sequence[tuple[float, Any]], space: str) -> dict[str, float]:
    """Return drops by node and reason, per second between the first and the last report."""
    found: dict[str, float] = {}
    for node in {message['node'] for _, message in reports}:
        own = [(at_s, message['values']) for at_s, message in reports if message['node'] == node]
        (first_s, first), (last_s, last) = own[0], own[-1]
        for key, value in last.items():
            if key.startswith('dropped: ') and last_s > first_s:
                count = int(value) - int(first.get(key, 0))
                name = f'{node.removeprefix(space + "/")}: {key.removeprefix("dropped: ")}'
                found[name] = count / (last_s - first_s)
    return found


def _summary(
    names: tuple[str, str, str], turns: Sequence[Turn], offline: Sequence[Turn]
) -> LiveResult:
    rates = [turn.clouds / turn.seconds for turn in turns]
    relative = [rate / (o.clouds / o.seconds) for rate, o in zip(rates, offline, strict=True)]
    latencies_s = [one for turn in turns for one in turn.latencies_s] or [np.nan]
    cpu_s = _cpu_s_per_cloud(turns)
    reasons = sorted({reason for turn in turns for reason in turn.dropped})
    return LiveResult(
        *names,
        float(np.median(rates)),
        float(np.median(relative)),
        float(np.median(latencies_s)),
        float(np.quantile(latencies_s, 0.95)),
        float(np.median(cpu_s)),
        float(np.median(np.divide(_cpu_s_per_cloud(offline), cpu_s))),
        max(turn.memory_mb for turn in turns),
        {one: float(np.mean([turn.dropped.get(one, 0.0) for turn in turns])) for one in reasons},
    )


def _cpu_s_per_cloud(turns: Sequence[Turn]) -> list[float]:
    return [turn.cpu_s / max(1, turn.clouds) for turn in turns]
