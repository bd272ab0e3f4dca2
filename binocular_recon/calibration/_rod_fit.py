# SPDX-License-Identifier: Apache-2.0
"""Fit a rod's sides and the borders of its bands to grey levels, below a pixel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon.calibration._rod_fit_kernels import (
    ABOVE,
    BELOW,
    BESIDE_PX,
    BLUR,
    BORDER_PARAMETERS,
    C2,
    CURVE,
    R0,
    R1,
    ROD_PARAMETERS,
    S1,
    S2,
    T0,
    accumulate_border,
    accumulate_rows,
)
from binocular_recon.camera import FloatArray

FloatImage = npt.NDArray[np.float32]

# Blur assumed before it is measured: a good lens and the pixel itself, px.
USUAL_BLUR_PX = 0.8
ROD_STEPS, BORDER_STEPS = 8, 8
# Rows this near to a border are left out of the fit of the sides, px (and the rod's lean).
GUARD_PX = 2.5
# Rows used beyond the outermost marks, as a share of a spacing.
BEYOND = 0.3
# Grey levels that a row may be off before it counts less, at least.
LEAST_RESIDUAL = 2.0


class RodFit(NamedTuple):
    """A rod's middle line and width in the picture.

    ``parameters`` as in ``_rod_fit_kernels``, for z = (y - y_middle) / y_scale.
    """

    parameters: FloatArray
    y_middle: float
    y_scale: float

    def place(self, y: float) -> tuple[FloatArray, FloatArray, float]:
        """Return the middle of the rod at row y, its direction upwards, half its width across."""
        p, z = self.parameters, (y - self.y_middle) / self.y_scale
        slope = (p[1] + 2 * z * p[C2]) / self.y_scale
        length = float(np.hypot(slope, 1))
        middle = np.array([p[0] + z * (p[1] + z * p[C2]), y])
        return middle, np.array([-slope, -1.0]) / length, float(p[R0] + z * p[R1]) / length


class BorderFit(NamedTuple):
    """One border: position, grey levels below and above it, curve, blur, quality.

    ``residual`` is the root mean square residual, grey levels; ``sigma_px`` one standard deviation
    along the rod as the residuals suggest; ``curve_weight`` the information on ``curve``.
    """

    point_px: FloatArray
    below: float
    above: float
    curve: float
    blur_px: float
    residual: float
    sigma_px: float
    curve_weight: float


def fit_rod(
    image: FloatImage, marks_px: FloatArray, width_px: float, blur_px: float
) -> RodFit | None:
    """Fit the middle line and the width of a rod to its two sides.

    Each row between the marks has its own background on either side and its own level; line, width
    and shading across are the rod's. Rows that do not fit (clutter, something in front) count less.

    Parameters
    ----------
    image : (H, W) float32
        Grey levels.
    marks_px : (M, 2) float64
        Rough positions of the marks, NaN = unknown; at least two.
    width_px : float
        Rough width across the rod, px.
    blur_px : float
        Standard deviation of the blur, px.

    Returns
    -------
    RodFit or None
        None if no row of the rod can be seen.

    """
    known = marks_px[np.isfinite(marks_px[:, 0])]
    order = np.argsort(-known[:, 1])
    known = known[order]
    low, high = known[-1, 1], known[0, 1]
    middle, scale = 0.5 * (low + high), max(0.5 * (high - low), 1.0)
    slope, x0 = np.polyfit((known[:, 1] - middle) / scale, known[:, 0], 1)
    lean = np.hypot(slope / scale, 1)
    start = np.zeros(ROD_PARAMETERS)
    start[:2], start[R0] = (x0, slope), 0.5 * width_px * lean
    rows, band = _rows(image, known, width_px * np.sqrt(lean**2 - 1), middle, scale)
    rod = start.copy()
    for step in range(ROD_STEPS):
        # a blurred model first: its edges reach farther
        blur = max(blur_px, 0.25 * width_px * 0.5**step)
        normal = np.zeros((ROD_PARAMETERS, ROD_PARAMETERS))
        gradient = np.zeros(ROD_PARAMETERS)
        accumulate_rows(image, rows, rod, blur, normal, gradient)
        if not np.isfinite(rows[:, 3]).any() or normal[0, 0] <= 0:
            return None
        stiff = _rod_prior(normal, rows[:, 3], line_only=step < 2)
        change = np.linalg.solve(
            normal + np.diag(stiff), gradient + stiff * (start - rod) * (stiff > 0)
        )
        change[:3] = np.clip(change[:3], -width_px / 3, width_px / 3)
        change[R0 : R1 + 1] = np.clip(change[R0 : R1 + 1], -0.1 * width_px, 0.1 * width_px)
        rod = rod + change
        _weigh_rows(rows, band)
    if not 0.5 < rod[R0] / start[R0] < 1.7:
        return None
    return RodFit(rod, middle, scale)


def _rows(
    image: FloatImage, known: FloatArray, lean_px: float, middle: float, scale: float
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Return the rows to fit, as accumulate_rows takes them, and whether each is in a light band."""
    beyond = BEYOND * float(np.median(np.abs(np.diff(known[:, 1]))))
    first = max(0, int(known[-1, 1] - beyond))
    last = min(len(image) - 1, int(known[0, 1] + beyond))
    y = np.arange(first, last + 1)
    away = np.abs(y[:, None] - known[None, :, 1]).min(1)
    y = y[away > GUARD_PX + 0.5 * lean_px]
    rows = np.zeros((len(y), 5))
    rows[:, 0], rows[:, 1], rows[:, 2] = y, (y - middle) / scale, 1.0
    below = (known[None, :, 1] > y[:, None]).sum(1)
    return rows, below


def _rod_prior(normal: FloatArray, levels: FloatArray, *, line_only: bool) -> FloatArray:
    """Return how stiffly each parameter is held at its start."""
    size = np.nanmedian(levels**2) * len(levels)
    stiff = np.full(ROD_PARAMETERS, 1e-9 * normal[0, 0])
    stiff[C2] = 0.01 * normal[0, 0]
    stiff[R0], stiff[R1] = 0.02 * normal[R0, R0], 0.05 * normal[R0, R0]
    stiff[S1] = stiff[S2] = 0.003 * size
    if line_only:
        stiff[[C2, R1, S1, S2]] = 1e9 * (size + normal[0, 0])
    return stiff


def _weigh_rows(rows: FloatArray, band: npt.NDArray[np.int64]) -> None:
    """Let rows count less whose residual is large or whose level is not that of their band."""
    level, residual = rows[:, 3], rows[:, 4]
    seen = np.isfinite(residual)
    typical = max(LEAST_RESIDUAL, float(np.median(residual[seen])))
    weight = 1 / (1 + (residual / typical) ** 2) ** 2
    for light in (0, 1):
        same = seen & (band % 2 == light)
        if same.any():
            median = np.median(level[same])
            spread = np.median(np.abs(level[same] - median)) + LEAST_RESIDUAL
            weight[same] /= (1 + ((level[same] - median) / (3 * spread)) ** 2) ** 2
    rows[:, 2] = np.where(seen, weight, 0.0)


def fit_border(
    image: FloatImage,
    rod: RodFit,
    y: float,
    reach_px: tuple[float, float],
    blur_px: float | None,
    curve: float | None = None,
) -> BorderFit | None:
    """Fit one border between two bands.

    Parameters
    ----------
    image : (H, W) float32
        Grey levels.
    rod : RodFit
        The rod.
    y : float
        Row near which the border crosses the rod's middle, px.
    reach_px : tuple of float
        How far below and above the border to look along the rod, px.
    blur_px : float or None
        Standard deviation of the blur; None = fit it.
    curve : float or None
        Sine of the angle under which the camera looks down on the border (it bends by this share
        of the rod's half width); None = fit it.

    Returns
    -------
    BorderFit or None
        None if too little of the border is in the picture or the fit runs away.

    """
    middle, up, half = rod.place(y)
    share = min(0.85, max(0.3, (half - 0.9) / half)) if half > 0 else 0.0
    frame = np.array([*middle, *up, half, share, *reach_px])
    shade = rod.parameters[[S1, S2]]
    border = np.zeros(BORDER_PARAMETERS)
    border[CURVE] = curve or 0.0
    border[BLUR] = blur_px or USUAL_BLUR_PX
    n = BORDER_PARAMETERS
    for step in range(BORDER_STEPS):
        normal, gradient = np.zeros((n, n)), np.zeros(n)
        square, count = accumulate_border(image, frame, shade, border, normal, gradient)
        if count < 6:
            return None
        contrast = (border[ABOVE] - border[BELOW]) ** 2
        stiff = np.full(n, 1e-6)
        target = border.copy()
        # the curve is known to about 0.3, the blur to about 0.3 px
        noise = max(square / count, 1.0)
        stiff[CURVE] = 1e12 if curve is not None or step < 2 else noise / 0.3**2
        stiff[BLUR] = 1e12 if blur_px is not None or step < 3 else noise / 0.3**2
        target[CURVE] = curve or 0.0
        target[BLUR] = blur_px or USUAL_BLUR_PX
        change = np.linalg.solve(
            normal + np.diag(stiff), gradient + stiff * (target - border)
        )
        change[T0] = np.clip(change[T0], -1.0, 1.0)
        change[BLUR] = np.clip(change[BLUR], -0.2, 0.2)
        border = border + change
        border[BLUR] = max(border[BLUR], 0.3)
        if abs(border[T0]) > min(reach_px) or contrast > 1e8:
            return None
    variance = square / max(count - 3, 1)
    covariance = np.linalg.inv(normal + np.diag(stiff))
    return BorderFit(
        middle + border[T0] * up,
        float(border[BELOW]),
        float(border[ABOVE]),
        float(border[CURVE]),
        float(border[BLUR]),
        float(np.sqrt(square / count)),
        float(np.sqrt(variance * covariance[T0, T0])),
        float(1 / (variance * covariance[CURVE, CURVE])),
    )


__all__ = ['BESIDE_PX', 'BorderFit', 'RodFit', 'fit_border', 'fit_rod']
