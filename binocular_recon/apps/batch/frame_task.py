# SPDX-License-Identifier: Apache-2.0
"""One frame to compute, and what came of it: what processes and machines send to each other."""

from __future__ import annotations

import dataclasses
import threading
import time
import traceback
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from binocular_recon.apps.frame_formats import FRAME_FORMATS, FrameResult
from binocular_recon.apps.summary_entries import first_rig_entry, frame_entry
from binocular_recon.camera import StereoRig
from binocular_recon.config import ChainConfig
from binocular_recon.errors import BinocularReconError, ImageError, shortened
from binocular_recon.images import FloatImage, Image
from binocular_recon.io.files import naming_errors
from binocular_recon.machine import peak_bytes
from binocular_recon.stereo.diagnosis import NOTHING, Findings
from binocular_recon.stereo.pipeline import Chain, warm_up
from binocular_recon.stereo.validity import MOST_OUTSIDE


@dataclass(frozen=True, eq=False)
class Recipe:
    """How the frames of one calibration are made.

    Attributes
    ----------
    key : str
        Tells recipes apart, in other processes too.
    rig : StereoRig
        Calibration of the images that tasks hold.
    config : ChainConfig
    rectify : bool
        Whether the images are to be rectified.
    alpha : float
        Passed to `Rectifier`.
    formats : tuple of str
        Keys of `FRAME_FORMATS`.

    """

    key: str
    rig: StereoRig
    config: ChainConfig
    rectify: bool
    alpha: float
    formats: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class FrameTask:
    """A pair, and everything that its frame depends on.

    Attributes
    ----------
    recipe : Recipe
    rig : StereoRig
        Calibration of the pair as it was recorded.
    index : int
        Number of the frame in the names of its files.
    left, right : (H, W) or (H, W, C)
        The images; uint8, uint16 or float32.
    state : dict
        `Chain.state` before the frame.
    last_px : (H, W) float32, optional
        The solution from which the filter starts, if an earlier run made it.

    """

    recipe: Recipe
    rig: StereoRig
    index: int
    left: Image
    right: Image
    state: dict[str, Any]
    last_px: FloatImage | None = None


@dataclass(frozen=True, eq=False)
class FrameOutcome:
    """What came of a pair; the files of its frame lie in the folder that was given.

    Attributes
    ----------
    state : dict, optional
        `Chain.state` after the frame; None if it was not begun.
    reason : str
        Why there is no frame; else empty.
    entry, rig_entry : dict
        Of the summary: of the frame without its number, and of the first frame.
    findings : Findings
        What the pair by itself shows.
    unmatched : bool
        Whether no pixel was matched.
    outside : str
        Why the search range is much too small; else empty.
    calibrated : bool
        Whether sigmas hold the share of the calibration.
    peak_bytes : int, optional
        Largest memory of the process so far.

    """

    state: dict[str, Any] | None = None
    reason: str = ''
    entry: dict[str, Any] = dataclasses.field(default_factory=dict)
    rig_entry: dict[str, Any] = dataclasses.field(default_factory=dict)
    findings: Findings = NOTHING
    unmatched: bool = False
    outside: str = ''
    calibrated: bool = False
    peak_bytes: int | None = None


class FrameFailedError(BinocularReconError):
    """A frame could not be computed for a reason that does not lie in its images."""


# The chain of the last recipe, one for each thread: frames change its state.
_chains = threading.local()


def compute_frame(task: FrameTask, folder: Path) -> FrameOutcome:
    """Compute a frame and write its files to ``folder``.

    Raises
    ------
    FrameFailedError
        If it cannot be computed here and now: memory is short, or the program has a fault.
    FileError
        If the files cannot be written.

    """
    try:
        with naming_errors(folder):
            return _compute(task, folder)
    except BinocularReconError:
        raise
    except MemoryError as error:
        raise FrameFailedError(
            f'memory is short ({shortened(error)}); choose a smaller disparity_range, smaller'
            ' images or fewer processes'
        ) from error
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        raise FrameFailedError(
            f'{type(error).__name__}: {shortened(error)} ({Path(place.filename).name}, line'
            f' {place.lineno}), a fault of the program; please report it'
        ) from error


def _compute(task: FrameTask, folder: Path) -> FrameOutcome:
    chain = _chain(task.recipe)
    begun = time.perf_counter()
    chain.restore(task.state, task.last_px)
    try:
        made = chain(task.left, task.right)
    except ImageError as error:
        return FrameOutcome(chain.state(), str(error))
    seconds = time.perf_counter() - begun
    frame = FrameResult.of(made, task.rig, chain.rig)
    return write_frame(frame, seconds, folder, task.index, task.recipe.formats, chain.state())


def write_frame(
    frame: FrameResult,
    seconds: float,
    folder: Path,
    index: int,
    formats: Collection[str],
    state: dict[str, Any],
) -> FrameOutcome:
    """Write the files of a frame; return what else the run needs of it.

    Parameters
    ----------
    frame : FrameResult
        What a chain made.
    seconds : float
        Time that it took.
    folder : Path
    index : int
        Number in the names of the files.
    formats : collection of str
        Keys of `FRAME_FORMATS`.
    state : dict
        `Chain.state` after it.

    """
    made = frame.made
    assert made is not None  # by a chain
    for name in formats:
        FRAME_FORMATS[name].write_frame(folder, index, frame)
    searched = made.range.search
    entry = frame_entry(frame, searched, seconds)
    if made.range.warning:
        entry['warning'] = made.range.warning
    return FrameOutcome(
        state,
        entry=entry,
        rig_entry=first_rig_entry(frame, searched),
        findings=made.findings,
        unmatched=not made.matched.matched_share,
        outside=made.range.warning if made.range.outside_share > MOST_OUTSIDE else '',
        calibrated=made.cloud.calibrated,
        peak_bytes=peak_bytes(),
    )


@cache
def load_kernels(config: ChainConfig) -> None:
    """Compile, or load, the kernels of a chain once in this process."""
    warm_up(config)


def _chain(recipe: Recipe) -> Chain:
    if getattr(_chains, 'key', '') != recipe.key:
        load_kernels(recipe.config)
        _chains.chain = Chain(
            recipe.rig, recipe.config, rectify=recipe.rectify, alpha=recipe.alpha
        )
        _chains.key = recipe.key
    chain: Chain = _chains.chain
    return chain
