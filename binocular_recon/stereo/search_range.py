# SPDX-License-Identifier: Apache-2.0
"""The search range: found from the images, or checked if it is given.

With a range that is too small, depth is wrong and not only missing, because surfaces outside the
range are filled from their surroundings. The pair is therefore matched at low resolution over all
disparities that the image allows, which takes a few per cent of the time of the match itself.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from binocular_recon.camera import StereoRig
from binocular_recon.config import MatchConfig
from binocular_recon.errors import ConfigError, ImageError
from binocular_recon.images import FloatImage
from binocular_recon.number_text import reach
from binocular_recon.stereo.matching import match
from binocular_recon.stereo.matching.half_resolution import halve

# Limits of the options.
FARTHEST_START, MOST_DISPARITIES = 2048, 4096
# Images are halved until they are at most this wide.
COARSE_WIDTH_PX = 480
# Searched at low resolution beyond infinity and in front of it, as shares of the image width.
BEHIND, IN_FRONT = 0.25, 0.75
# The farthest and the nearest matches, as shares of all pixels, are ignored because they may be
# wrong; fewer of the nearest, because a thin object has few pixels.
FAR_SHARE, NEAR_SHARE = 0.005, 0.0005
# The range is widened by this share of it on either side: low resolution misses small objects.
MARGIN = 0.2
# With fewer matches at low resolution, as a share of the image, no range can be found.
LEAST_MATCHED = 0.03
# A range is too small if this share of the matches at low resolution is outside.
OUTSIDE_SHARE = 0.005
# Left and right are exchanged if this share of the pixels matches the other way round, and fewer
# than half as many match as given.
EXCHANGED_SHARE = 0.3
# Connected regions of fewer pixels are dropped at low resolution.
_SPECKLES = 60


class SearchRange(NamedTuple):
    """Disparities to search.

    Attributes
    ----------
    min_disparity : int
        The smallest disparity, px.
    disparity_range : int
        Number of disparities.

    """

    min_disparity: int
    disparity_range: int

    @property
    def last(self) -> int:
        """The largest disparity searched, px."""
        return self.min_disparity + self.disparity_range - 1

    def depths_m(self, rig: StereoRig) -> tuple[float, float]:
        """Return the nearest and the farthest depth of these disparities, m."""
        near, far = (
            rig.focal_px * rig.baseline_m / shift if shift > 0 else math.inf
            for shift in (limit - rig.disparity_offset_px for limit in (self.last, self[0]))
        )
        return near, far

    def describe(self, rig: StereoRig) -> str:
        """Say which disparities are searched, and which depths they are."""
        near, far = self.depths_m(rig)
        depths = f'depths of {near:.2f} m to {reach(far)}' if math.isfinite(near) else 'no depth'
        return f'{self.min_disparity} to {self.last} px, {depths}'

    def applied_to(self, config: MatchConfig) -> MatchConfig:
        """Return ``config`` with this range."""
        return dataclasses.replace(config, **self._asdict())


class RangeChoice(NamedTuple):
    """The range to search in a pair.

    Attributes
    ----------
    search : SearchRange
    warning : str
        Why a given range is too small, and the range to set; else empty.
    outside_share : float
        Share of the matches at low resolution that are outside a range with a warning.

    """

    search: SearchRange
    warning: str = ''
    outside_share: float = 0.0


def range_of_depths(near_m: float, far_m: float, rig: StereoRig) -> SearchRange:
    """Return the disparities of all surfaces between two depths.

    Parameters
    ----------
    near_m, far_m : float
        Depths, m; ``far_m`` may be infinite.
    rig : StereoRig
        Rectified rig.

    Raises
    ------
    ConfigError
        If the depths are not in order, or have more disparities than can be searched.

    """
    if not 0 < near_m < far_m:
        raise ConfigError(f'near must be above 0 and below far, got {near_m:g} m and {far_m:g} m')
    reach = rig.focal_px * rig.baseline_m
    first = math.floor(rig.disparity_offset_px + reach / far_m) - 1
    last = math.ceil(rig.disparity_offset_px + reach / near_m) + 1
    if last - first + 1 > MOST_DISPARITIES or abs(first) > FARTHEST_START:
        raise ConfigError(
            f'{near_m:g} to {far_m:g} m are disparities of {first} to {last} px with this rig;'
            f' at most {MOST_DISPARITIES} can be searched, so raise near'
        )
    return SearchRange(first, last - first + 1)


class Overview(NamedTuple):
    """Disparities of a pair at low resolution, in pixels of full resolution.

    Attributes
    ----------
    disparities_px : (N,) float32
        All matches, in rising order.
    pixels : int
        Pixels of the image at low resolution, matched or not.
    step_px : int
        Pixels of full resolution per pixel.

    """

    disparities_px: FloatImage
    pixels: int
    step_px: int

    @property
    def matched_share(self) -> float:
        """Share of the pixels that have a match."""
        return self.disparities_px.size / self.pixels

    def outside(self, first: float, last: float) -> tuple[float, float]:
        """Return the shares of the matches below ``first`` and above ``last`` px."""
        slack = self.step_px
        below = int(np.searchsorted(self.disparities_px, first - slack))
        above = self.disparities_px.size - int(np.searchsorted(self.disparities_px, last + slack))
        count = max(1, self.disparities_px.size)
        return below / count, above / count

    def limits_px(self) -> tuple[float, float]:
        """Return the farthest and the nearest reliable disparity, px."""
        count = self.disparities_px.size
        low = min(count - 1, int(FAR_SHARE * self.pixels))
        high = max(0, count - 1 - int(NEAR_SHARE * self.pixels))
        return float(self.disparities_px[low]), float(self.disparities_px[max(low, high)])


def overview(
    left: FloatImage, right: FloatImage, config: MatchConfig, infinity_px: float | None = None
) -> Overview:
    """Match a pair at low resolution over all disparities that its width allows.

    Parameters
    ----------
    left, right : (H, W) float32
        Rectified grey images; NaN = no data.
    config : MatchConfig
        Only its texture threshold is used.
    infinity_px : float, optional
        Disparity of a point at infinity, ``cx_left - cx_right`` of the rectified cameras: the
        smallest possible. If unknown, a quarter of the width below zero is searched too.

    """
    step = 1
    while left.shape[1] > COARSE_WIDTH_PX and min(left.shape) > 2 * config.correlation_window_size:
        left, right, step = halve(left), halve(right), 2 * step
    width = left.shape[1]
    first = -int(BEHIND * width) if infinity_px is None else math.floor(infinity_px / step) - 1
    last = max(first, 0) + int(IN_FRONT * width)
    coarse = MatchConfig(
        min_disparity=max(first, -FARTHEST_START),
        disparity_range=max(2, min(last - first + 1, MOST_DISPARITIES)),
        texture_threshold=config.texture_threshold,
        half_resolution=False,
        speckle_size=_SPECKLES,
    )
    disparity = match(left, right, coarse).disparity_px
    found = np.sort(disparity[np.isfinite(disparity)]) * np.float32(step)
    return Overview(found, disparity.size, step)


def find_range(seen: Overview, width: int, infinity_px: float | None = None) -> SearchRange:
    """Return the range to search in images ``width`` px wide, from an overview of the pair.

    With too few matches at low resolution, it is half of the width from infinity on.
    """
    far = 0.0 if infinity_px is None else infinity_px
    if seen.matched_share < LEAST_MATCHED:
        return _limited(math.floor(far), math.ceil(far + width / 2))
    low, high = seen.limits_px()
    margin = MARGIN * (high - low) + 2 * seen.step_px
    # always from infinity on: sky and distant background often have no match
    low = min(low - margin, 0.0) if infinity_px is None else infinity_px - 1
    return _limited(math.floor(low), math.ceil(high + margin))


def choose_range(
    left: FloatImage,
    right: FloatImage,
    config: MatchConfig,
    infinity_px: float | None = None,
    *,
    check: bool = True,
) -> RangeChoice:
    """Choose the range to search in a pair; a given range is only checked.

    Parameters
    ----------
    left, right, infinity_px
        As for `overview`.
    config : MatchConfig
        The range, or ``disparity_range`` 0 to find it.
    check : bool
        Whether to check a given range.

    """
    given = SearchRange(config.min_disparity, config.disparity_range)
    if not (config.finds_range or check):
        return RangeChoice(given)
    seen = overview(left, right, config, infinity_px)
    if not config.finds_range:
        return RangeChoice(given, *_fault(seen, config, left.shape[1], infinity_px))
    found = find_range(seen, left.shape[1], infinity_px)
    if config.min_disparity:  # set explicitly
        found = _limited(config.min_disparity, max(found.last, config.min_disparity + 15))
    return RangeChoice(found)


def _fault(
    seen: Overview, config: MatchConfig, width: int, infinity_px: float | None = None
) -> tuple[str, float]:
    """Return why a range is too small ('' if it is not), and the share of matches outside."""
    first, last = config.limits_px
    below, above = seen.outside(first, last)
    if seen.matched_share < LEAST_MATCHED or max(below, above) < OUTSIDE_SHARE:
        return '', 0.0
    better = find_range(seen, width, infinity_px)
    low, high = min(better.min_disparity, int(first)), max(better.last, int(last))
    sides = [
        f'{share:.1%} of the matches are {side}'
        for share, side in ((above, f'above {last:g} px (nearer)'), (below, f'below {first:g} px'))
        if share >= OUTSIDE_SHARE
    ]
    text = (
        f'the search range {first:g}..{last:g} px is too small: {" and ".join(sides)}; set'
        f' min_disparity {low} and disparity_range {high - low + 1}, or disparity_range 0 to find'
        ' the range automatically'
    )
    return text, below + above


def check_order(
    left: FloatImage, right: FloatImage, config: MatchConfig, infinity_px: float | None = None
) -> None:
    """Raise an ImageError if the images match only when they are exchanged.

    Parameters
    ----------
    left, right, config, infinity_px
        As for `overview`; of images of which few pixels could be matched.

    """
    given = overview(left, right, config, infinity_px or 0.0).matched_share
    exchanged = overview(right, left, config, -(infinity_px or 0.0)).matched_share
    if exchanged > max(2 * given, EXCHANGED_SHARE):
        raise ImageError(
            f'left and right are exchanged: {given:.0%} of the pixels match as given, and'
            f" {exchanged:.0%} the other way round; exchange the images (or the cameras' topics)"
        )


def _limited(low: int, high: int) -> SearchRange:
    low = max(-FARTHEST_START, min(low, FARTHEST_START))
    return SearchRange(low, max(16, min(high - low + 1, MOST_DISPARITIES)))
