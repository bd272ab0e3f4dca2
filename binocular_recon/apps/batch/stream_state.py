# SPDX-License-Identifier: Apache-2.0
"""What frames take over from those before them, kept apart from where they are computed.

Frames that are computed at the same time are those of one chain that makes them one after the
other, to the bit:

- Their number is known when their images are. Black and white of 16-bit and floating-point images
  depend on the images before: these are rectified here and looked at before they are handed out.
- Whether a pair is examined depends on how many of the pairs before had enough matches. A pair
  for which that is open is examined where it is computed; when it is back, it is known whether
  that counts, or what the last examination found.
- With ``wls_video`` a frame starts from the solution of the one before; these are computed by one
  process in their order.
"""

from __future__ import annotations

import uuid
from dataclasses import replace
from typing import Any

import numpy as np

from binocular_recon.apps.batch.frame_task import FrameOutcome, FrameTask, Recipe
from binocular_recon.apps.pair_input import PairInput
from binocular_recon.camera import StereoRig
from binocular_recon.config import ChainConfig
from binocular_recon.images import FloatImage, Image
from binocular_recon.inputs.levels import LevelTracker
from binocular_recon.stereo.diagnosis import EXAMINE_EVERY, NOTHING, Findings, PairCheck
from binocular_recon.stereo.rectification import Rectifier, check_size
from binocular_recon.stereo.search_range import range_of_depths


class StreamState:
    """The state of a chain whose frames are computed elsewhere.

    Parameters
    ----------
    rig : StereoRig
        Calibration of the images.
    config : ChainConfig
    source : PairInput
        Says how images are rectified and which depths are searched.
    formats : tuple of str
        Files of the frames.
    rectify : bool
        False if the images are rectified already.

    Attributes
    ----------
    rig : StereoRig
        The rectified rig.

    """

    def __init__(
        self,
        rig: StereoRig,
        config: ChainConfig,
        source: PairInput,
        formats: tuple[str, ...],
        *,
        rectify: bool,
    ) -> None:
        self._raw = rig
        self._rectifier = Rectifier(rig, source.alpha) if rectify else None
        self.rig = self._rectifier.rig if self._rectifier else rig
        if source.near_m is not None:
            search = range_of_depths(source.near_m, source.far_m, self.rig)
            config = replace(config, match=search.applied_to(config.match))
        self._levels = LevelTracker(config.images)
        self._check = PairCheck().state()
        self._frames, self._starts_from_last = 0, False
        self._last_px: FloatImage | None = None
        key = uuid.uuid4().hex
        self._rectified = Recipe(key, self.rig, config, False, source.alpha, formats)
        self._given = self._rectified
        if rectify:
            self._given = Recipe(f'{key} raw', rig, config, True, source.alpha, formats)

    def restore(self, state: dict[str, Any], last_px: FloatImage | None) -> None:
        """Go on from the ``state`` of an earlier run; ``last_px`` as for `Chain.restore`."""
        self._frames, self._check = state['frames'], state['check']
        self._levels.restore(state['levels'])
        self._starts_from_last, self._last_px = state['starts_from_last'], last_px

    def task(self, left: Image, right: Image, index: int, in_flight: int) -> FrameTask:
        """Return the task of a pair, and count it.

        Parameters
        ----------
        left, right : (H, W) or (H, W, C)
            The images.
        index : int
            Number of the frame, if all before it are made.
        in_flight : int
            How many pairs before it are not back yet.

        Raises
        ------
        ImageError
            If the images do not have the calibrated size.

        """
        check_size(left, self._raw.left.size, 'left')
        check_size(right, self._raw.right.size, 'right')
        recipe = self._given
        levels = self._levels.state()
        of_stream = {left.dtype, right.dtype} != {np.dtype(np.uint8)}
        if of_stream and not recipe.config.images.white_level:
            if self._rectifier:
                left, right = self._rectifier(left, right)
                recipe = self._rectified
            self._levels.update(left, right)
        state = {
            'frames': self._frames,
            'levels': levels,
            'check': {name: _examine(kind, in_flight) for name, kind in self._check.items()},
            'starts_from_last': self._last_px is not None,
        }
        task = FrameTask(recipe, self._raw, index, left, right, state, self._last_px)
        self._frames, self._last_px = self._frames + 1, None
        return task

    def now(self) -> dict[str, Any]:
        """Return what `concluded` will complete: the numbers and levels after the last task."""
        return {'frames': self._frames, 'levels': self._levels.state()}

    def concluded(
        self, task: FrameTask | None, after: dict[str, Any], outcome: FrameOutcome
    ) -> tuple[Findings, dict[str, Any]]:
        """Take note of what came of a pair; pairs come back in their order.

        Parameters
        ----------
        task : FrameTask, optional
            None if the images could not be read.
        after : dict
            What `now` returned after its task was made.
        outcome : FrameOutcome

        Returns
        -------
        findings : Findings
            What is wrong with the pair, or with the last one that was examined.
        state : dict
            `Chain.state` after the pair.

        """
        findings = outcome.findings
        if task and outcome.state:
            self._starts_from_last = outcome.state['starts_from_last']
            for name, kind in self._check.items():
                found = outcome.state['check'][name]
                if found['count'] == task.state['check'][name]['count']:
                    continue
                if kind['count'] % EXAMINE_EVERY == 0:
                    kind['last'] = found['last']
                kind['count'] += 1
                if not outcome.unmatched:
                    findings = Findings.restored(kind['last'])
        check = {name: dict(kind) for name, kind in self._check.items()}
        return findings, {**after, 'check': check, 'starts_from_last': self._starts_from_last}


def _examine(kind: dict[str, Any], in_flight: int) -> dict[str, Any]:
    """Return the count with which a pair is examined if it may be due."""
    counts = range(kind['count'], kind['count'] + in_flight + 1)
    due = any(count % EXAMINE_EVERY == 0 for count in counts)
    return {'count': 0 if due else 1, 'last': NOTHING.state()}
