# SPDX-License-Identifier: Apache-2.0
"""A rod in an image, and the fit of one edge between two of its bands, to subpixel accuracy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from binocular_recon.calibration.detection._rod_fit_kernels import (
    ABOVE,
    BELOW,
    BLUR,
    C2,
    CURVE,
    EDGE_PARAMETERS,
    LEFT,
    R0,
    R1,
    RIGHT,
    S1,
    S2,
    T0,
    accumulate_edge,
)
from binocular_recon.camera import FloatArray
from binocular_recon.images import FloatImage

# Blur assumed before it is measured: a good lens and the pixel itself, px.
USUAL_BLUR_PX = 0.8
EDGE_STEPS = 8
# Largest root mean square residual of an edge, as a share of its step.
MAX_RESIDUAL = 0.12


class RodFit(NamedTuple):
    """A rod's middle line and width in the image.

    ``parameters`` as in ``_rod_fit_kernels``, for z = (y - y_middle) / y_scale.
    """

    parameters: FloatArray
    y_middle: float
    y_scale: float

    def place(self, y: float) -> tuple[FloatArray, FloatArray, float]:
        """Return the middle of the rod at row y, its direction upwards, and half its width."""
        p, z = self.parameters, (y - self.y_middle) / self.y_scale
        slope = (p[1] + 2 * z * p[C2]) / self.y_scale
        length = float(np.hypot(slope, 1))
        middle = np.array([p[0] + z * (p[1] + z * p[C2]), y])
        return middle, np.array([-slope, -1.0]) / length, float(p[R0] + z * p[R1]) / length


class EdgeFit(NamedTuple):
    """One edge: position, grey levels below and above it, curve, blur, quality.

    ``residual``: root mean square residual, grey levels; ``sigma_px``: one standard deviation
    along the rod, from the residuals; ``curve_weight``: inverse variance of ``curve``.
    """

    point_px: FloatArray
    below: float
    above: float
    curve: float
    blur_px: float
    residual: float
    sigma_px: float
    curve_weight: float


def fit_edge(
    image: FloatImage,
    rod: RodFit,
    y: float,
    reach_px: tuple[float, float],
    blur_px: float | None,
    curve: float | None = None,
) -> EdgeFit | None:
    """Fit one edge between two bands.

    Parameters
    ----------
    image : (H, W) float32
        Grey levels.
    rod : RodFit
        The rod.
    y : float
        Row near which the edge crosses the rod's middle, px.
    reach_px : tuple of float
        How far below and above the edge to look along the rod, px.
    blur_px : float or None
        Standard deviation of the blur; None = fit it.
    curve : float or None
        Sine of the angle at which the camera looks down on the edge, which bends by this share
        of the rod's half width; None = fit it.

    Returns
    -------
    EdgeFit or None
        None if too little of the edge is in the image or the fit diverges.

    """
    middle, up, half = rod.place(y)
    share = min(0.9, max(0.4, (half - 0.6) / half)) if half > 0 else 0.0
    window = np.array([*middle, *up, half, share, *reach_px])
    shade = rod.parameters[[S1, S2]]
    edge = np.zeros(EDGE_PARAMETERS)
    edge[CURVE] = curve or 0.0
    edge[BLUR] = blur_px or USUAL_BLUR_PX
    n = EDGE_PARAMETERS
    diagonal = np.diag_indices(n)
    for step in range(EDGE_STEPS):
        normal, gradient = np.zeros((n, n)), np.zeros(n)
        square, count = accumulate_edge(image, window, shade, edge, normal, gradient)
        if count < 6:
            return None
        contrast = (edge[ABOVE] - edge[BELOW]) ** 2
        stiff = np.full(n, 1e-6)
        target = edge.copy()
        # the curve is known to about 0.3, the blur to about 0.3 px
        noise = max(square / count, 1.0)
        stiff[CURVE] = 1e12 if curve is not None or step < 2 else noise / 0.3**2
        stiff[BLUR] = 1e12 if blur_px is not None or step < 3 else noise / 0.3**2
        # the background on the left and right is between black and white
        stiff[LEFT] = stiff[RIGHT] = noise / 100.0**2
        target[LEFT] = target[RIGHT] = 0.5 * (edge[BELOW] + edge[ABOVE])
        target[CURVE] = curve or 0.0
        target[BLUR] = blur_px or USUAL_BLUR_PX
        normal[diagonal] += stiff
        change = np.linalg.solve(normal, gradient + stiff * (target - edge))
        change[T0] = min(max(change[T0], -1.0), 1.0)
        change[BLUR] = min(max(change[BLUR], -0.2), 0.2)
        edge = edge + change
        edge[BLUR] = max(edge[BLUR], 0.3)
        if abs(edge[T0]) > min(reach_px) or contrast > 1e8:
            return None
    variance = square / max(count - 3, 1)
    covariance = np.linalg.inv(normal)
    return EdgeFit(
        middle + edge[T0] * up,
        float(edge[BELOW]),
        float(edge[ABOVE]),
        float(edge[CURVE]),
        float(edge[BLUR]),
        float(np.sqrt(square / count)),
        float(np.sqrt(variance * covariance[T0, T0])),
        float(1 / (variance * covariance[CURVE, CURVE])),
    )


def curve_model(fits: list[EdgeFit]) -> FloatArray:
    """Return the edges' curve as a linear function (1, x, y) of the position in the image.

    The curve is the sine of the angle at which the camera looks down on the rod. For parallel rods
    it is nearly linear over the image.
    """
    points = np.array([fit.point_px for fit in fits])
    curves = np.array([fit.curve for fit in fits])
    weights = np.array([fit.curve_weight for fit in fits])
    middle, size = points.mean(0), np.maximum(np.ptp(points, axis=0).max(), 1.0)
    design = np.column_stack([np.ones(len(fits)), (points - middle) / size])
    model = np.zeros(3)
    for _ in range(5):
        off = curves - design @ model
        w = weights / (1 + weights * off**2 / 9)
        # a field of view is about 60 degrees; the prior keeps few or narrow rods from diverging
        normal = design.T @ (w[:, None] * design) + np.diag([1 / 0.5**2, 1 / 0.1**2, 1 / 0.5**2])
        model = np.linalg.solve(normal, design.T @ (w * curves))
    slope = model[1:] / size
    return np.array([model[0] - slope @ middle, *slope])
