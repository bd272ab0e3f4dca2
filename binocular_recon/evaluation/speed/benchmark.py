# SPDX-License-Identifier: Apache-2.0
"""Time every stage and the chain at several sizes, next to its peers in the same run."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Any

from binocular_recon.evaluation.speed import direct_solver as direct
from binocular_recon.evaluation.speed import probe, stages
from binocular_recon.evaluation.speed.stages import Bench, Size
from binocular_recon.evaluation.timing import interleaved

SIZES = (Size(640, 480, 64), Size(1280, 720, 128), Size(1920, 1200, 256))

# Title of each stage's table, and its contestants.
STAGES: dict[str, Callable[[Bench], stages.Contestants]] = {
    'match': stages.matching,
    'exact WLS': stages.filtering,
    'rectify': stages.rectifying,
    'cloud': stages.triangulating,
    'chain': stages.chain,
}

# Rounds of one stage at one size end after this time, so that a full run takes minutes.
_STAGE_LIMIT_S = 8.0


@dataclass(frozen=True)
class Timing:
    """One contestant of one stage at one size.

    Attributes
    ----------
    stage, size, name : str
        What was timed.
    seconds : float
        Median.
    relative : float
        Divided by that of the stage's reference, its first contestant; NaN if that is missing.

    """

    stage: str
    size: str
    name: str
    seconds: float
    relative: float


@dataclass
class Results:
    """Everything that a benchmark measures.

    Attributes
    ----------
    timings : list of Timing
        By stage, size and contestant.
    direct : list of dict
        Per preset, at the smallest size (at most the smallest of `SIZES`: the time of a direct
        solver explodes): its time and the largest difference between our solution and its.
    memory : list of dict
        Per preset, at the largest size: `probe.peak_memory`.
    first_call : list of dict
        `probe.first_call` of one preset, at the smallest size.

    """

    timings: list[Timing] = field(default_factory=list)
    direct: list[dict[str, Any]] = field(default_factory=list)
    memory: list[dict[str, Any]] = field(default_factory=list)
    first_call: list[dict[str, Any]] = field(default_factory=list)


def benchmark(
    sizes: Sequence[Size],
    presets: Sequence[str],
    repeat: int,
    progress: Callable[[int, str], None] = lambda *_: None,
) -> Results:
    """Run the whole benchmark.

    Parameters
    ----------
    sizes : sequence of Size
        Sizes, ascending.
    presets : sequence of str
        Our presets.
    repeat : int
        Timed rounds of each stage; fewer where they take long.
    progress : function
        Called with the number of finished steps (of `step_count`) and what is measured next.

    Raises
    ------
    ProbeError
        If a measurement in a process of its own fails.

    """
    results, steps = Results(), count()
    for size in sizes:
        bench = Bench(size, presets)
        for stage, contestants in STAGES.items():
            progress(next(steps), f'{stage} at {size}')
            results.timings += time_stage(stage, bench, contestants(bench), repeat)
    small = min(sizes[0], SIZES[0], key=lambda size: size.width * size.height)
    for preset in presets:
        progress(next(steps), f'direct solver, {preset}')
        results.direct.append(direct.compare(Bench(small, presets), preset))
    for preset in presets:
        progress(next(steps), f'memory of a match, {preset}')
        memory = probe.peak_memory(preset, *sizes[-1].numbers)
        results.memory.append({'preset': preset, 'size': str(sizes[-1]), **memory})
    first = 'default' if 'default' in presets else presets[0]
    progress(next(steps), f'first call, {first}')
    first_call = probe.first_call(first, *sizes[0].numbers)
    results.first_call.append({'preset': first, 'size': str(sizes[0]), **first_call})
    return results


def step_count(sizes: Sequence[Size], presets: Sequence[str]) -> int:
    """Return the number of steps of `benchmark`."""
    return len(sizes) * len(STAGES) + 2 * len(presets) + 1


def time_stage(
    stage: str, bench: Bench, contestants: stages.Contestants, repeat: int
) -> list[Timing]:
    """Time the contestants of one stage by turns."""
    seconds = interleaved(contestants, repeat, limit_s=_STAGE_LIMIT_S)
    first = next(iter(seconds))
    reference = math.nan if first in bench.presets else seconds[first]
    return [
        Timing(stage, str(bench.size), name, value, value / reference)
        for name, value in seconds.items()
    ]


def growth(timings: Sequence[Timing], sizes: Sequence[Size]) -> dict[str, list[float]]:
    """Return each matcher's time per pixel and disparity at every size, nanoseconds."""
    work = {str(size): size.scores for size in sizes}
    result: dict[str, list[float]] = {}
    for timing in timings:
        if timing.stage == 'match':
            result.setdefault(timing.name, []).append(1e9 * timing.seconds / work[timing.size])
    return result
