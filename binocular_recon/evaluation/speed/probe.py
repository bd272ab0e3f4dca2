# SPDX-License-Identifier: Apache-2.0
"""Measurements that need a process of their own: peak memory and the first call.

``python -m binocular_recon.evaluation.speed.probe memory|first-call PRESET WIDTH HEIGHT
DISPARITIES`` writes one JSON object to stdout.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from binocular_recon.errors import BinocularReconError
from binocular_recon.machine import peak_bytes

# On images of this size kernels are compiled before memory is measured.
_SMALL = (96, 64, 16)


class ProbeError(BinocularReconError):
    """A measurement in a process of its own failed."""


def peak_memory(preset: str, width: int, height: int, disparity_range: int) -> dict[str, Any]:
    """Return by how much a match raises the memory of a process, in a fresh one.

    Returns
    -------
    dict
        ``peak_mb``: above what the process had with images loaded and kernels compiled;
        ``bytes_per_score``: the same per pixel and disparity.

    Raises
    ------
    ProbeError
        If the process fails.

    """
    size = (width, height, disparity_range)
    # so that every array freed before is given back to the system and none is reused unseen
    return _in_process('memory', preset, *size, MALLOC_MMAP_THRESHOLD_='65536')


def first_call(preset: str, width: int, height: int, disparity_range: int) -> dict[str, Any]:
    """Return how long the chain's first call takes with a cold and a warm kernel cache.

    Returns
    -------
    dict
        ``cold`` and ``warm``, each with ``import_s``, ``first_s`` and ``second_s``.

    Raises
    ------
    ProbeError
        If a process fails.

    """
    with tempfile.TemporaryDirectory() as cache:
        size = (width, height, disparity_range)
        return {
            state: _in_process('first-call', preset, *size, NUMBA_CACHE_DIR=cache)
            for state in ('cold', 'warm')
        }


def _in_process(kind: str, preset: str, *size: int, **environment: str) -> dict[str, Any]:
    command = [sys.executable, '-m', __name__, kind, preset, *map(str, size)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, **environment}
    )
    if done.returncode:
        last = (done.stderr.strip() or 'no message').splitlines()[-1]
        raise ProbeError(f'measuring {kind} of preset {preset} failed: {last}')
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def _peak_bytes() -> int:
    peak = peak_bytes()
    if peak is None:
        raise ProbeError('/proc/self/status has no VmHWM; peak memory is measured on Linux only')
    return peak


def _measure_memory(preset: str, size: tuple[int, int, int]) -> dict[str, Any]:
    from binocular_recon.evaluation.speed.content import Size, synthetic
    from binocular_recon.evaluation.speed.stages import Bench
    from binocular_recon.stereo.matching import match

    small, large = (Bench(synthetic(Size(*one)), [preset]) for one in (_SMALL, size))
    match(*small.grey, small.config(preset).match)
    left, right = large.grey
    # what making the images needed at most is given back, but would hide as much of the match
    Path('/proc/self/clear_refs').write_text('5', encoding='ascii')
    before = _peak_bytes()
    match(left, right, large.config(preset).match)
    grown = _peak_bytes() - before
    width, height, disparity_range = size
    return {
        'peak_mb': grown / 1e6,
        'bytes_per_score': grown / (width * height * disparity_range),
    }


def _measure_first_call(preset: str, size: tuple[int, int, int]) -> dict[str, Any]:
    start = time.perf_counter()
    from binocular_recon.evaluation.speed.content import Size, synthetic
    from binocular_recon.evaluation.speed.stages import Bench
    from binocular_recon.stereo.pipeline import Chain

    imported = time.perf_counter()
    bench = Bench(synthetic(Size(*size)), [preset])
    chain = Chain(bench.rig, bench.config(preset))
    left, right = bench.recorded
    seconds = []
    for _ in range(2):
        begin = time.perf_counter()
        chain(left, right)
        seconds.append(time.perf_counter() - begin)
    return {'import_s': imported - start, 'first_s': seconds[0], 'second_s': seconds[1]}


def main() -> None:
    """Measure in this process what the arguments say."""
    kind, preset, *numbers = sys.argv[1:]
    width, height, disparity_range = map(int, numbers)
    measure = {'memory': _measure_memory, 'first-call': _measure_first_call}[kind]
    sys.stdout.write(json.dumps(measure(preset, (width, height, disparity_range))))


if __name__ == '__main__':
    main()
