# SPDX-License-Identifier: Apache-2.0
"""Kernels that complete and smooth a disparity map."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import kernel
from binocular_recon._simd import LANES, at_most, larger, load, splat, store

Array = npt.NDArray[Any]

REACH = 2  # samples on each side of the pixel ...
SPACING = 3  # ... every so many pixels: neighbours repeat the same error
BORDER = REACH * SPACING
FEW = np.float32(5)  # samples that a plane needs
FLAT = np.float32(1e-2)  # least spread of the samples: a plane needs two directions


@kernel
def fill_strip(disparity: Array, filled: Array, start: int, stop: int) -> None:
    """Give each run of NaN the smaller disparity of its two ends: the background's."""
    width = disparity.shape[1]
    for y in range(start, stop):
        x = 0
        before = np.float32(np.nan)
        while x < width:
            if not np.isnan(disparity[y, x]):
                before = disparity[y, x]
                filled[y, x] = before
                x += 1
                continue
            end = x
            while end < width and np.isnan(disparity[y, end]):
                end += 1
            after = disparity[y, end] if end < width else before
            if np.isnan(before):
                before = after
            filled[y, x:end] = min(before, after)
            x = end


@kernel
def plane_strip(
    disparity: Array, reach_px: float, plane: Array, residual: Array, start: int, stop: int
) -> None:
    """Fit a plane to the samples around each pixel that differ by ``reach_px`` at most.

    ``disparity`` (H + 2 BORDER, W + 2 BORDER + LANES) has a border of NaN; ``plane`` and
    ``residual`` (H, W + LANES) get the plane's value and the mean square of what remains,
    where samples are few that of anything within ``reach_px``.
    """
    width = disparity.shape[1] - 2 * BORDER - LANES
    limit = splat(np.float32(reach_px))
    zero, one = splat(np.float32(0)), splat(np.float32(1))
    for y in range(start, stop):
        centre = disparity[y + BORDER]
        for x in range(0, width, LANES):
            here = load(centre, x + BORDER)
            n = sx = sy = sxx = sxy = syy = sv = sxv = syv = svv = zero
            for j in range(-REACH, REACH + 1):
                row = disparity[y + BORDER + j * SPACING]
                v = splat(np.float32(j))
                for i in range(-REACH, REACH + 1):
                    u = splat(np.float32(i))
                    step = load(row, x + BORDER + i * SPACING) - here
                    distance = larger(step, zero - step)
                    weight = at_most(distance, limit, one, zero)
                    step = at_most(distance, limit, step, zero)
                    n, sx, sy = n + weight, sx + u * weight, sy + v * weight
                    sxx, sxy, syy = (
                        sxx + u * u * weight,
                        sxy + u * v * weight,
                        syy + v * v * weight,
                    )
                    sv, sxv, syv, svv = (
                        sv + step,
                        sxv + u * step,
                        syv + v * step,
                        svv + step * step,
                    )
            count = larger(n, one)
            mx, my, mv = sx / count, sy / count, sv / count
            cxx, cxy, cyy = sxx / count - mx * mx, sxy / count - mx * my, syy / count - my * my
            cxv, cyv = sxv / count - mx * mv, syv / count - my * mv
            spread = cxx * cyy - cxy * cxy
            safe = larger(spread, splat(FLAT))
            slope_x = (cxv * cyy - cyv * cxy) / safe
            slope_y = (cyv * cxx - cxv * cxy) / safe
            left = svv / count - mv * mv - slope_x * cxv - slope_y * cyv
            fitted = here + mv - slope_x * mx - slope_y * my
            fitted = at_most(splat(FEW), n, at_most(splat(FLAT), spread, fitted, here), here)
            store(plane[y], x, fitted)
            left = at_most(splat(FEW), n, larger(left, zero), limit * limit / splat(np.float32(3)))
            store(residual[y], x, left)
