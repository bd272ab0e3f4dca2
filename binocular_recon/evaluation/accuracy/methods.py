# SPDX-License-Identifier: Apache-2.0
"""What is compared: our presets and OpenCV's matchers, behind one interface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from binocular_recon.config import ChainConfig
from binocular_recon.errors import BinocularReconError
from binocular_recon.evaluation import peers
from binocular_recon.evaluation.accuracy.scenes import TruthScene
from binocular_recon.images import FloatImage, Image, Mask, to_bgr8, to_grey
from binocular_recon.options import OptionValue
from binocular_recon.stereo.confidence import sigma_from_confidence
from binocular_recon.stereo.filtering.wls_filter import DisparityFilter
from binocular_recon.stereo.matching import match
from binocular_recon.stereo.pipeline import estimate_disparity
from binocular_recon.stereo.validity import Validity


class PeerError(BinocularReconError):
    """Another program gave no disparity map of a pair."""


@dataclass(frozen=True, eq=False)
class MethodResult:
    """A disparity map and, where the method offers one, its standard deviation.

    Attributes
    ----------
    disparity_px : (H, W) float32
        Raw disparity; NaN = unfilled.
    sigma_px : (H, W) float32 or None
        One standard deviation.
    measured : (H, W) bool or None
        Pixels that were measured, not filled; None if the method does not tell.

    """

    disparity_px: FloatImage
    sigma_px: FloatImage | None = None
    measured: Mask | None = None


@dataclass(frozen=True)
class Method:
    """A way from an image pair to a disparity map.

    Attributes
    ----------
    name : str
        Name in tables.
    prepare : function
        Takes left image, right image and number of disparities; returns the function that is
        timed, which makes the `MethodResult`.
    ours : bool
        True for a preset, False for a peer.

    """

    name: str
    prepare: Callable[[Image, Image, int], Callable[[], MethodResult]]
    ours: bool = False

    def estimate(self, scene: TruthScene) -> MethodResult:
        """Return the estimate for a scene."""
        return self.prepare(scene.left, scene.right, scene.max_disparity_px)()


def preset_method(preset: str, **overrides: OptionValue) -> Method:
    """Return the chain from images to dense disparity with a preset's options.

    Raises
    ------
    ConfigError
        If the preset or an option is unknown or out of range.

    """
    ChainConfig.preset(preset, **overrides)

    def prepare(left: Image, right: Image, disparity_range: int) -> Callable[[], MethodResult]:
        config = _config(preset, overrides, disparity_range)
        wls = DisparityFilter(config.filter)

        def run() -> MethodResult:
            filtered = estimate_disparity(left, right, config, wls, check_range=False).filtered
            measured = (filtered.validity & Validity.MEASURED) > 0
            return MethodResult(filtered.disparity_px, filtered.sigma_px, measured)

        return run

    return Method(preset, prepare, ours=True)


def match_method(preset: str, **overrides: OptionValue) -> Method:
    """Return a preset's matching alone, before the filter."""
    ChainConfig.preset(preset, **overrides)

    def prepare(left: Image, right: Image, disparity_range: int) -> Callable[[], MethodResult]:
        config = _config(preset, overrides, disparity_range)

        def run() -> MethodResult:
            greys = to_grey(left), to_grey(right)
            matched = match(*greys, config.match, lambda: (to_bgr8(left), to_bgr8(right)))
            return MethodResult(matched.disparity_px, sigma_from_confidence(matched.confidence))

        return run

    return Method(f'{preset}, match only', prepare, ours=True)


def opencv_method(matcher: peers.OpenCvMatcher) -> Method:
    """Return one of OpenCV's matchers; the padding that it needs is made beforehand."""

    def prepare(left: Image, right: Image, disparity_range: int) -> Callable[[], MethodResult]:
        columns = -(-disparity_range // 16) * 16
        padded_left, padded_right = (peers.padded(image, columns) for image in (left, right))
        compute = matcher.prepare(columns)

        def run() -> MethodResult:
            disparity = compute(
                peers.to_bytes(padded_left),
                peers.to_bytes(padded_right),
                peers.to_guide(padded_left),
            )
            return MethodResult(peers.from_fixed_point(disparity, columns))

        return run

    return Method(matcher.name, prepare)


def _config(preset: str, overrides: dict[str, OptionValue], disparity_range: int) -> ChainConfig:
    search: dict[str, OptionValue] = {'min_disparity': 0, 'disparity_range': disparity_range}
    return ChainConfig.preset(preset, **{**search, **overrides})
