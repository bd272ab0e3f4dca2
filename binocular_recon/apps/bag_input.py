# SPDX-License-Identifier: Apache-2.0
"""Which pairs of which bag are reconstructed."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from binocular_recon.apps.earlier_run import fingerprint
from binocular_recon.inputs.options import PairingOptions
from binocular_recon.io.bags.stereo_topics import StereoTopics


@dataclass(frozen=True)
class BagInput:
    """A bag and the pairs of it that are reconstructed.

    Attributes
    ----------
    bag : Path
    namespace : str, optional
        Namespace of the rig.
    images, infos : (str, str), optional
        Topics of left and right if they do not have the usual names.
    rectified : bool, optional
        Whether ``images`` are rectified; by default as `is_rectified` says.
    calibration : Path, optional
        Calibration that replaces the recorded camera infos, as `read_rig` reads it.
    alpha : float
        Passed to `Rectifier`.
    tolerance_ns : int
        Largest difference between the stamps of a pair.
    pairing : PairingOptions
        What tells that images belong together.
    every : int
        Reconstruct every Nth pair.
    max_frames : int, optional
        Stop after this many frames.
    near_m, far_m : float, optional
        Depths that are searched, instead of a range in pixels.

    """

    bag: Path
    namespace: str | None = None
    images: tuple[str, str] | None = None
    infos: tuple[str, str] | None = None
    rectified: bool | None = None
    calibration: Path | None = None
    alpha: float = -1.0
    tolerance_ns: int = 0
    pairing: PairingOptions = field(default_factory=PairingOptions)
    every: int = 1
    max_frames: int | None = None
    near_m: float | None = None
    far_m: float = math.inf

    def facts(self, topics: StereoTopics) -> dict[str, Any]:
        """Return what the frames depend on besides the options of the chain, for the summary."""
        facts = {**dataclasses.asdict(self), **topics._asdict(), 'bag': str(self.bag)}
        facts['far_m'] = self.far_m if math.isfinite(self.far_m) else None
        facts['files'] = fingerprint(self.bag)
        if self.calibration is not None:
            facts['calibration'] = fingerprint(self.calibration)
        return facts
