# SPDX-License-Identifier: Apache-2.0
"""Time every stage and the chain on several contents, next to its peers in the same run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Any

from binocular_recon.evaluation.speed import direct_solver as direct
from binocular_recon.evaluation.speed import probe, stages
from binocular_recon.evaluation.speed.content import Content, Size, synthetic
from binocular_recon.evaluation.speed.stages import Bench
from binocular_recon.evaluation.timing import interleaved

SIZES = (Size(640, 480, 64), Size(1280, 720, 128), Size(1920, 1200, 256))

# Title of each stage's table, and its contestants; on what the pair shows, only some depend.
STAGES: dict[str, Callable[[Bench], stages.Contestants]] = {
    'match': stages.matching,
    'exact WLS': stages.filtering,
    'chain': stages.chain,
    'rectify': stages.rectifying,
    'cloud': stages.triangulating,
}
BY_CONTENT = ('match', 'exact WLS', 'chain')

# Rounds of one stage at one size end after this time, so that a full run takes minutes.
_STAGE_LIMIT_S = 8.0


@dataclass(frozen=True)
class Timing:
    """One contestant of one stage on one content.

    Attributes
    ----------
    stage, content, name : str
        What was timed.
    real : bool
        `Content.real`.
    seconds : float
        Median.
    relative : float
        Divided by that of the stage's reference, its first contestant; NaN if that is missing.

    """

    stage: str
    content: str
    name: str
    real: bool
    seconds: float
    relative: float


@dataclass
class Results:
    """Everything that a benchmark measures.

    Attributes
    ----------
    timings : list of Timing
        By content, stage and contestant.
    iterations : dict of str to dict of str to int
        Of the filter's solver, by content and preset.
    direct : list of dict
        Per preset, at the smallest size (at most the smallest of `SIZES`: the time of a direct
        solver explodes): its time and the largest difference between our solution and its.
    memory : list of dict
        Per preset, at the largest size: `probe.peak_memory`.
    first_call : list of dict
        `probe.first_call` of one preset, at the smallest size.

    """

    timings: list[Timing] = field(default_factory=list)
    iterations: dict[str, dict[str, int]] = field(default_factory=dict)
    direct: list[dict[str, Any]] = field(default_factory=list)
    memory: list[dict[str, Any]] = field(default_factory=list)
    first_call: list[dict[str, Any]] = field(default_factory=list)


def benchmark(
    contents: Sequence[Content],
    sizes: Sequence[Size],
    presets: Sequence[str],
    repeat: int,
    progress: Callable[[int, str], None] = lambda *_: None,
) -> Results:
    """Run the whole benchmark.

    Parameters
    ----------
    contents : sequence of Content
        What is matched, filtered and reconstructed.
    sizes : sequence of Size
        Sizes of the other measurements, on synthetic pairs, ascending.
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
    for content, stage_names in _plan(contents, sizes):
        bench = Bench(content, presets)
        for stage in stage_names:
            progress(next(steps), f'{stage}, {content}')
            results.timings += time_stage(stage, bench, STAGES[stage](bench), repeat)
            if stage == 'exact WLS':
                results.iterations[str(content)] = bench.iterations
    small = min(sizes[0], SIZES[0], key=lambda size: size.width * size.height)
    for preset in presets:
        progress(next(steps), f'direct solver, {preset}')
        results.direct.append(direct.compare(Bench(synthetic(small), presets), preset))
    for preset in presets:
        progress(next(steps), f'memory of a match, {preset}')
        memory = probe.peak_memory(preset, *sizes[-1].numbers)
        results.memory.append({'preset': preset, 'size': str(sizes[-1]), **memory})
    first = 'default' if 'default' in presets else presets[0]
    progress(next(steps), f'first call, {first}')
    first_call = probe.first_call(first, *sizes[0].numbers)
    results.first_call.append({'preset': first, 'size': str(sizes[0]), **first_call})
    return results


def step_count(contents: Sequence[Content], sizes: Sequence[Size], presets: Sequence[str]) -> int:
    """Return the number of steps of `benchmark`."""
    return sum(len(names) for _, names in _plan(contents, sizes)) + 2 * len(presets) + 1


def _plan(
    contents: Sequence[Content], sizes: Sequence[Size]
) -> Iterator[tuple[Content, list[str]]]:
    """Yield the contents, and the stages that are timed on each."""
    for content in contents:
        yield content, list(BY_CONTENT)
    for size in sizes:
        yield synthetic(size), [stage for stage in STAGES if stage not in BY_CONTENT]


def time_stage(
    stage: str, bench: Bench, contestants: stages.Contestants, repeat: int
) -> list[Timing]:
    """Time the contestants of one stage by turns."""
    seconds = interleaved(contestants, repeat, limit_s=_STAGE_LIMIT_S)
    first = next(iter(seconds))
    reference = math.nan if first in bench.presets else seconds[first]
    return [
        Timing(stage, str(bench.content), name, bench.content.real, value, value / reference)
        for name, value in seconds.items()
    ]


def growth(timings: Sequence[Timing], contents: Sequence[Content]) -> dict[str, list[float]]:
    """Return each matcher's time per pixel and disparity on every content, nanoseconds."""
    work = {str(content): content.size.scores for content in contents}
    result: dict[str, list[float]] = {}
    for timing in timings:
        if timing.stage == 'match':
            result.setdefault(timing.name, []).append(1e9 * timing.seconds / work[timing.content])
    return result
