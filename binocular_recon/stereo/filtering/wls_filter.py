# SPDX-License-Identifier: Apache-2.0
"""Weighted least squares filter: from measured disparities to a dense map (eq. 11-15)."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon.camera import FloatArray
from binocular_recon.config import FilterConfig
from binocular_recon.errors import ImageError
from binocular_recon.images import ByteImage, FloatImage
from binocular_recon.stereo.confidence import SIGMA_UNIT_PX
from binocular_recon.stereo.filtering import _filter_kernels as kernels
from binocular_recon.stereo.filtering._equations import normal_equations
from binocular_recon.stereo.filtering._wls_solver import System
from binocular_recon.stereo.holes import assess_holes, unexplained_holes
from binocular_recon.stereo.validity import Validity

# Filtered disparities stay this far inside the limits: more than two float32 steps at 4096 px.
LIMIT_MARGIN_PX = 2.0**-10
# Lower limit of the standard deviation.
LEAST_SIGMA_PX = 0.05
# Variance of rounding to whole pixels.
WHOLE_PIXEL_VARIANCE = 1 / 12
# The bits that state why a pixel was not measured.
_REASONS = ~np.uint8(Validity.MEASURED | Validity.FILLED | Validity.EXTRAPOLATED)


@dataclass(frozen=True, eq=False)
class Filtered:
    """Dense disparity map with its uncertainty.

    Attributes
    ----------
    disparity_px : (H, W) float32
        Raw disparity of every pixel, strictly inside the limits.
    sigma_px : (H, W) float32
        One standard deviation of it.
    validity : (H, W) uint8
        `Validity`: measured, filled or extrapolated, and why not measured.
    iterations : int
        Iterations of the solver.
    error_estimate_px : float
        Estimated largest difference from the exact solution.

    """

    disparity_px: FloatImage
    sigma_px: FloatImage
    validity: ByteImage
    iterations: int
    error_estimate_px: float

    @cached_property
    def measured_share(self) -> float:
        """Share of the pixels that were measured, not filled."""
        return float(np.mean((self.validity & Validity.MEASURED) > 0))


class DisparityFilter:
    """Filter the frames of a stream: the solver's memory is reused from frame to frame.

    With ``wls_video`` the last solution is reused too, as the start of the next one. A frame of
    another size allocates new memory and discards the last solution. Frames may be filtered in
    several threads at once.

    Parameters
    ----------
    config : FilterConfig
        Options of the filter.

    Attributes
    ----------
    last : (H, W) float32, optional
        With ``wls_video`` the last solution, from which the next one starts.

    """

    def __init__(self, config: FilterConfig) -> None:
        self.config = config
        self._spare: deque[System] = deque(maxlen=1)
        self.last: FloatImage | None = None

    def __call__(
        self,
        disparity_px: FloatImage,
        confidence: FloatImage,
        guide: FloatImage,
        *,
        limits_px: tuple[float, float],
        reasons: ByteImage | None = None,
        initial: FloatImage | None = None,
    ) -> Filtered:
        """Filter one frame; see `filter_disparity`."""
        _check_sizes(disparity_px, confidence=confidence, guide=guide, initial=initial)
        measured = _measured(disparity_px, confidence, limits_px)
        unexplained = unexplained_holes(measured)
        equations = normal_equations(measured, confidence, guide, self.config, unexplained)
        system = self._system(*measured.shape)
        system.assemble(equations.weight, equations.link_east, equations.link_south)
        start = self._last_solution(measured.shape) if initial is None else initial
        if start is not None and not np.isfinite(start).all():
            start = None
        solution = system.solve(equations.data, self.config.wls_tolerance_px, start)
        low, high = limits_px
        holes, validity = assess_holes(measured, solution.values, unexplained)
        if reasons is not None:
            validity |= np.where(validity == Validity.MEASURED, 0, reasons & _REASONS)
        sigma = _sigma(measured, confidence, solution.values, holes)
        margin = min(LIMIT_MARGIN_PX, (high - low) / 2)
        filtered = np.clip(solution.values, np.float32(low + margin), np.float32(high - margin))
        self._spare.append(system)
        self.last = filtered if self.config.wls_video else None
        return Filtered(filtered, sigma, validity, solution.iterations, solution.error_estimate)

    def _system(self, rows: int, columns: int) -> System:
        """Return a solver that no other thread uses."""
        with suppress(IndexError):
            system = self._spare.pop()
            if system.shape == (rows, columns):
                return system
        return System(rows, columns)

    def _last_solution(self, shape: tuple[int, ...]) -> FloatImage | None:
        last = self.last
        return last if last is not None and last.shape == shape else None


def filter_disparity(
    disparity_px: FloatImage,
    confidence: FloatImage,
    guide: FloatImage,
    config: FilterConfig,
    *,
    limits_px: tuple[float, float],
    reasons: ByteImage | None = None,
    initial: FloatImage | None = None,
) -> Filtered:
    """Denoise a disparity map and fill its holes, preserving the edges of the guide.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Raw disparity x_left - x_right; NaN, infinite or outside ``limits_px`` = none.
    confidence : (H, W) float32
        Confidence of the match in [0, 1]; 0 or NaN = none.
    guide : (H, W) float32
        Left image, grey levels 0..255; not used if ``config.wls_guide`` is 'disparity'.
    config : FilterConfig
        Options of the filter.
    limits_px : (float, float)
        Smallest and largest disparity searched.
    reasons : (H, W) uint8, optional
        `Match.validity`: why pixels have no match; copied into the result.
    initial : (H, W) float32, optional
        An approximate solution, such as the previous frame's result, towards which the solver
        takes its first step. It saves iterations; the result is within the tolerance of the exact
        solution in any case. Ignored unless all finite.

    Returns
    -------
    Filtered
        Disparity and standard deviation of every pixel.

    Raises
    ------
    ImageError
        If the sizes differ or no pixel has a disparity.

    Notes
    -----
    Minimises eq. 11; its normal equations (C + lambda L_g) f = C b (eq. 13) are solved to
    ``config.wls_tolerance_px``. Departures from the paper, each with an option that turns it
    off: c is the confidence of the match; pixels without a match have the disparity of the
    background, with a small confidence; the gradient term of eq. 12 grows with steps of the
    disparity too, because objects often have the same grey level as the background.

    The variance of a pixel is that of its match plus the scatter of the data around the solution
    nearby. The scatter is at least 1/12 px^2 if all data are whole pixels, because a solution that
    follows rounded data does not show their error. A match near a step may belong to its other
    side, which adds to its variance. For pixels without a match see `holes.assess_holes`.

    """
    wls = DisparityFilter(config)
    return wls(
        disparity_px, confidence, guide, limits_px=limits_px, reasons=reasons, initial=initial
    )


def sigma_if_right(sigma_px: FloatArray) -> FloatArray:
    """Return the sigma of matches of which it is known that they are not wrong altogether, px.

    The variance of a match is v + `MISMATCHED` v^3, where the second term stands for mismatches;
    this is the root of v. What steps nearby add is not taken out.

    Parameters
    ----------
    sigma_px : (...) float64
        As `Filtered.sigma_px` has it, of measured pixels.

    """
    scale = np.sqrt(3 * float(kernels.MISMATCHED))
    # the real solution of the cubic equation, by hyperbolic functions
    variance = 2 / scale * np.sinh(np.arcsinh(1.5 * scale * sigma_px**2) / 3)
    return np.asarray(np.sqrt(variance), np.float64)


def _measured(
    disparity_px: FloatImage, confidence: FloatImage, limits_px: tuple[float, float]
) -> FloatImage:
    """Return the disparity; NaN where it is not valid."""
    low, high = (float(limit) for limit in limits_px)
    rows = len(disparity_px)
    measured, counts = np.empty(disparity_px.shape, np.float32), np.empty(rows, np.int64)
    images = disparity_px, confidence, (low, high), measured, counts
    over_strips(kernels.keep_measured, rows, *images)
    if not counts.any():
        raise ImageError(
            f'no pixel has a disparity within {low:g}..{high:g} px and a confidence above 0;'
            ' check the disparity range, and that the images are rectified, overlap, have texture'
            ' and are larger than the correlation window'
        )
    return measured


def _sigma(
    measured: FloatImage, confidence: FloatImage, filtered: FloatImage, holes: FloatImage
) -> FloatImage:
    """Return the standard deviation of every pixel, given the variance of unmatched ones."""
    sigma = np.empty_like(measured)
    terms = kernels.SigmaTerms(
        measured,
        filtered,
        np.asarray(confidence, np.float32),
        unit=SIGMA_UNIT_PX**2,
        least=LEAST_SIGMA_PX**2,
        rounding=WHOLE_PIXEL_VARIANCE if kernels.all_whole(measured) else 0.0,
        holes=holes,
    )
    over_strips(kernels.standard_deviation, len(measured), terms, sigma)
    return sigma


def _check_sizes(disparity_px: FloatImage, **others: FloatImage | None) -> None:
    if disparity_px.ndim != 2 or 0 in disparity_px.shape:
        raise ImageError(f'disparity must be (rows, columns), got shape {disparity_px.shape}')
    for name, image in others.items():
        if image is not None and image.shape != disparity_px.shape:
            raise ImageError(
                f'disparity is {disparity_px.shape} and {name} {image.shape} (rows, columns);'
                ' both must belong to the same image'
            )
