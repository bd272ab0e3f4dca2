# SPDX-License-Identifier: Apache-2.0
"""What is wrong with an image, or with one image of a pair against the other one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

FloatImage = npt.NDArray[np.float32]

# Share of white pixels above which the exposure is too long.
SATURATED_SHARE = 0.25
# Grey levels between which all but 1 % of a covered lens lie.
_COVERED_SPAN, _COVERED_MEAN = 8.0, 24.0
# One image is less sharp, or has less contrast, by this factor; with less contrast noise looks
# sharp.
BLURRED, SLIGHTLY_BLURRED, _FAINT = 0.5, 0.65, 0.25
# Neighbours in an image of noise alone differ by more than this share of its contrast (1.13 in
# white noise), those in the other image by less than half of that.
_NOISE = 0.9
# Cells of an image, px, that are dark and even; one image has so many more of them, as a share,
# that something covers a part of it.
_CELL_PX, _COVERED_MORE = 16, 0.25
# Every so many rows and columns are compared to find two images that are one.
_EVERY = 8
# Rows next to each other differ by this much more than those two apart if fields were mixed.
_INTERLACED = 1.25


def image_fault(grey: FloatImage) -> str:
    """Return why an image, (H, W) float32 grey levels, cannot be matched; '' if it can."""
    missing, white = np.mean(np.isnan(grey)), np.mean(grey >= 255)
    if missing > 0.999:
        return 'has no data (NaN) in all its pixels'
    low, high = np.nanquantile(grey[::4, ::4], [0.005, 0.995])
    if np.nanmin(grey) == np.nanmax(grey):
        return (
            f'is uniform (grey level {np.nanmin(grey):.0f}); check the lens cap and the exposure'
        )
    if high - low < _COVERED_SPAN and high < _COVERED_MEAN:
        return (
            f'is dark: 99 % of its grey levels are {low:.1f} to {high:.1f} of 255; check the lens'
            ' cap and the exposure'
        )
    if white > SATURATED_SHARE:
        return f'is saturated in {100 * white:.0f} % of its pixels; shorten the exposure'
    return ''


def same_image(left: npt.NDArray[np.generic], right: npt.NDArray[np.generic]) -> str:
    """Say that one image came twice, as the left and as the right one."""
    left, right = left[::_EVERY, ::_EVERY], right[::_EVERY, ::_EVERY]
    # of uniform images `image_fault` tells more
    if left.size < 2 or (left == left.flat[0]).all() or not np.array_equal(left, right):
        return ''
    return (
        'left and right are the same image, so nothing can be measured; give each camera its own'
        ' topic or file'
    )


def interlaced(images: dict[str, FloatImage]) -> str:
    """Say that the odd rows of an image were taken at another time than the even ones."""
    for side, grey in images.items():
        near, far = (float(np.nanmean(np.abs(grey[k:] - grey[:-k]))) for k in (1, 2))
        if near > _INTERLACED * far:
            return (
                f'the {side} image is interlaced: rows next to each other differ by {near:.1f}'
                f' grey levels, those two apart by {far:.1f}; deinterlace it or use every second'
                ' row'
            )
    return ''


def partly_covered(images: dict[str, FloatImage]) -> str:
    """Say that a part of one image is dark and even, and not of the other one."""
    shares = {}
    for side, grey in images.items():
        rows, columns = (size // _CELL_PX * _CELL_PX for size in grey.shape)
        cells = grey[:rows, :columns].reshape(rows // _CELL_PX, _CELL_PX, -1, _CELL_PX)
        dark = (np.mean(cells, axis=(1, 3)) < _COVERED_MEAN) & (
            np.std(cells, axis=(1, 3)) < _COVERED_SPAN / 2
        )
        shares[side] = float(np.mean(dark)) if dark.size else 0.0
    low, high = sorted(shares, key=shares.__getitem__)
    bright = np.nanquantile(images[high][::4, ::4], 0.99) > 2 * _COVERED_MEAN
    if not bright or shares[high] - shares[low] < _COVERED_MORE:
        return ''
    return (
        f'the {high} image is dark and even in {shares[high]:.0%} of its area, the {low} one in'
        f' {shares[low]:.0%}: something covers a part of it; check the lens cap and what is in'
        ' front of the camera'
    )


def noise_alone(images: dict[str, FloatImage]) -> str:
    """Say that one image holds noise and nothing else."""
    steps = {side: _sharpness(image) for side, image in images.items()}
    low, high = sorted(steps, key=steps.__getitem__)
    if steps[high] < _NOISE or steps[low] > _NOISE / 2:
        return ''
    return (
        f'the {high} image is noise: neighbours differ by {steps[high]:.2f} times its contrast, in'
        f' the {low} one by {steps[low]:.2f}; check the lens cap, the gain and the exposure'
    )


def faint(images: dict[str, FloatImage]) -> str:
    """Say that one image has much less contrast."""
    return _less(images, _contrast, _FAINT, 'has less contrast', 'set its exposure')


def less_sharp(images: dict[str, FloatImage], least: float) -> str:
    """Say that one image is less sharp than the other one: less than ``least`` times."""
    text = _less(images, _sharpness, least, 'is less sharp', 'focus that camera, clean its lens')
    if text and faint(images):
        faint_side = min(images, key=lambda side: _contrast(images[side]))
        sharp_side = max(images, key=lambda side: _sharpness(images[side]))
        if faint_side == sharp_side:  # what looks sharp is noise
            return ''
    return text


def _contrast(image: FloatImage) -> float:
    return float(np.nanstd(image))


def _sharpness(image: FloatImage) -> float:
    """Return the step between neighbours as a share of the contrast."""
    steps = float(np.nanmean(np.abs(np.diff(image, axis=1))))
    return steps / max(_contrast(image), 1e-6)


def _less(
    images: dict[str, FloatImage],
    measure: Callable[[FloatImage], float],
    least: float,
    what: str,
    remedy: str,
) -> str:
    """Say that one image has much less of something than the other."""
    values = {side: measure(image) for side, image in images.items()}
    low, high = sorted(values, key=values.__getitem__)
    share = values[low] / max(values[high], 1e-9)
    if share >= least:
        return ''
    return f'the {low} image {what} than the {high} one, {share:.2f} times; {remedy}'
