# SPDX-License-Identifier: Apache-2.0
"""Picks in the frames of one rig, and the points, grounds and rulers that belong to them."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from functools import cache
from typing import Protocol

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.errors import MeasurementError, shortened
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.picks import Pick
from binocular_recon.measurement.planes import Plane, fitted_ground, normal_of
from binocular_recon.measurement.ruler import Ruler
from binocular_recon.measurement.snapping import PICK_SIGMA_PX, locate
from binocular_recon.measurement.uncertain import Uncertain


class SiteFrame(Protocol):
    """The frame of a site, to which the frame of the rig is tied."""

    @property
    def level(self) -> bool:
        """Whether the third axis is up."""

    @property
    def names(self) -> tuple[str, str, str]:
        """Names of the axes."""

    def to_site(self, point: Uncertain, frame: MeasuredFrame) -> Uncertain:
        """Return a point (3,), m, of the rectified frame in the site's."""

    def up(self, frame: MeasuredFrame) -> Uncertain:
        """Return the unit vector against gravity in the rectified frame, (3,)."""


class MeasuringSession:
    """What measurements share.

    Parameters
    ----------
    frames : callable
        Returns the frame of a number.
    picks : iterable of Pick
        Picks by hand; names differ.
    pick_sigma_px : float
        One standard deviation of picks, on each axis.
    site : SiteFrame, optional
        The frame of the site, if the rig is tied to it.

    Attributes
    ----------
    picks : dict of str to Pick
    site : SiteFrame or None

    """

    def __init__(
        self,
        frames: Callable[[int], MeasuredFrame],
        picks: Iterable[Pick],
        pick_sigma_px: float = PICK_SIGMA_PX,
        site: SiteFrame | None = None,
    ) -> None:
        self.picks = {pick.name: pick for pick in picks}
        self.pick_sigma_px = pick_sigma_px
        self.site = site
        self.frame = cache(frames)
        self.point = cache(self._point)
        self.ground = cache(self._ground)
        self.ruler = cache(self._ruler)

    def with_picks(self, picks: Iterable[Pick]) -> MeasuringSession:
        """Return a session of other picks that shares frames, grounds and rulers with this one."""
        other = copy.copy(self)
        other.picks = {pick.name: pick for pick in picks}
        other.point = cache(other._point)  # of these picks  # noqa: SLF001
        return other

    def pick(self, name: str) -> Pick:
        """Return a pick by name; raises a MeasurementError if there is none."""
        if name not in self.picks:
            raise MeasurementError(
                f'there is no pick {shortened(name)}; the picks are {_few(self.picks)}'
            )
        return self.picks[name]

    def number(self, names: tuple[str, ...]) -> int:
        """Return the frame that picks share; raises a MeasurementError if they are of several."""
        numbers = {self.pick(name).frame for name in names}
        if len(numbers) > 1:
            raise MeasurementError(
                f'{", ".join(names)} are picked in the frames {sorted(numbers)}; this is measured'
                ' within one'
            )
        return numbers.pop()

    def up(self, number: int) -> tuple[Uncertain, Callable[[FloatArray], FloatArray]]:
        """Return what gives the vertical in a frame, and the function that makes it of that."""
        if self.site is not None and self.site.level:
            return self.site.up(self.frame(number)), lambda values: values / np.linalg.norm(values)
        return self.ground(number).support, normal_of

    def _point(self, name: str) -> Uncertain:
        pick = self.pick(name)
        return locate(self.frame(pick.frame), pick, self.pick_sigma_px)

    def _ground(self, number: int) -> Plane:
        return fitted_ground(self.frame(number))

    def _ruler(self, number: int) -> Ruler:
        return Ruler(self.frame(number), self.pick_sigma_px, self.ground(number))


def _few(names: Iterable[str]) -> str:
    shown = sorted(names)
    more = f' and {len(shown) - 10} more' if len(shown) > 10 else ''
    return f'{", ".join(shown[:10]) or "none"}{more}'
