# SPDX-License-Identifier: Apache-2.0
"""Which image pairs are reconstructed: what every kind of input has in common."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from binocular_recon.apps.earlier_run import fingerprint
from binocular_recon.camera import StereoRig
from binocular_recon.errors import BinocularReconError
from binocular_recon.images import Image
from binocular_recon.inputs.options import PairingOptions


class ImagePair(Protocol):
    """A pair of an input that is not decoded yet."""

    @property
    def stamp_ns(self) -> int | None:
        """Time of the left image, ns; None if it is not known."""

    @property
    def names(self) -> tuple[str, str] | None:
        """What the images are called in the summary; None if the time says it."""

    @property
    def rig(self) -> StereoRig:
        """Calibration at that instant; the same object until it changes."""

    def images(self) -> tuple[Image, Image]:
        """Return left and right; raises an ImageError if they cannot be decoded."""


class PairStream(Protocol):
    """The pairs of an open input, in their order."""

    expected: int

    @property
    def images_read(self) -> int:
        """Number of images so far."""

    @property
    def unpaired(self) -> int:
        """Number of them that have no partner."""

    @property
    def damage(self) -> list[str]:
        """Sentences about what could not be read so far."""

    def __iter__(self) -> Iterator[ImagePair]:
        """Yield the pairs."""


class OpenInput(NamedTuple):
    """An open input.

    Attributes
    ----------
    pairs : PairStream
    rectified : bool
        Whether its images are rectified already.
    facts : dict
        What the frames depend on besides the options of the chain, for the summary.
    versions : dict
        Of the packages that read it.
    remarks : list of str
        What is to be said before the first frame.
    error : type
        What to raise if a part of it could not be reconstructed.

    """

    pairs: PairStream
    rectified: bool
    facts: dict[str, Any]
    versions: dict[str, str]
    remarks: list[str]
    error: type[BinocularReconError]


@dataclass(frozen=True, kw_only=True)
class PairInput:
    """An input and which pairs of it are reconstructed.

    Attributes
    ----------
    rectified : bool, optional
        Whether the images are rectified; by default their name says it.
    calibration : Path, optional
        Calibration of the images, as `read_rig` reads it.
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

    rectified: bool | None = None
    calibration: Path | None = None
    alpha: float = -1.0
    tolerance_ns: int = 0
    pairing: PairingOptions = field(default_factory=PairingOptions)
    every: int = 1
    max_frames: int | None = None
    near_m: float | None = None
    far_m: float = math.inf

    def open(self) -> AbstractContextManager[OpenInput]:
        """Open the input; raises a BinocularReconError if it cannot be read."""
        raise NotImplementedError

    def facts(self) -> dict[str, Any]:
        """Return what the frames depend on besides the files themselves, for the summary."""
        facts: dict[str, Any] = dataclasses.asdict(self)
        facts['far_m'] = self.far_m if math.isfinite(self.far_m) else None
        if self.calibration is not None:
            facts['calibration'] = fingerprint(self.calibration, '**/*')
            facts['calibrated_in'] = str(self.calibration)
        return facts
