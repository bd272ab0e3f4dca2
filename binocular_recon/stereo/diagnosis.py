# SPDX-License-Identifier: Apache-2.0
"""Why few pixels of a pair can be matched, and whether its rows correspond."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np

from binocular_recon.config import MatchConfig
from binocular_recon.images import FloatImage
from binocular_recon.stereo.matching import Match
from binocular_recon.stereo.row_check import MOST_ROWS_PX, RowOffset, measure_rows
from binocular_recon.stereo.search_range import EXCHANGED_SHARE, check_order, overview
from binocular_recon.stereo.validity import FEW_MATCHED

# A pair is examined in the first frame of a stream and then in every tenth.
EXAMINE_EVERY = 10
# Share of white pixels above which the exposure is too long.
SATURATED_SHARE = 0.25
# Grey levels between which all but 1 % of a covered lens lie.
_COVERED_SPAN, _COVERED_MEAN = 8.0, 24.0
# One image is less sharp, or has less contrast, by this factor.
_BLURRED, _SLIGHTLY_BLURRED, _FAINT = 0.5, 0.65, 0.25
# Rows next to each other differ by this much more than those two apart if fields were mixed.
_INTERLACED = 1.25
# Of the matches of features, this share and this many agree about how far rows are off.
_AGREE_SHARE, _AGREE_LEAST, _AGREE_PX, _FEATURES = 0.4, 20, 1.5, 1500


class Findings(NamedTuple):
    """What is wrong with a pair.

    Attributes
    ----------
    rows : RowOffset
        By how much the rows of matches differ.
    warnings : tuple of str
        What makes the result worse although enough pixels were matched.
    cause : str
        Why few pixels could be matched, as far as the images show it; else empty.

    """

    rows: RowOffset = RowOffset()
    warnings: tuple[str, ...] = ()
    cause: str = ''

    def state(self) -> dict[str, Any]:
        """Return these findings as JSON can hold them."""
        rows = [None if math.isnan(value) else value for value in self.rows]
        return {'rows': rows, 'warnings': self.warnings, 'cause': self.cause}

    @classmethod
    def restored(cls, state: dict[str, Any]) -> Findings:
        """Return the findings of a `state`."""
        median_px, spread_px, points = (
            math.nan if value is None else value for value in state['rows']
        )
        rows = RowOffset(median_px, spread_px, int(points))
        return cls(rows, tuple(state['warnings']), state['cause'])


NOTHING = Findings()
# Pairs by whether few of their pixels are matched.
_KINDS = {'enough matched': False, 'few matched': True}


class PairCheck:
    """Examine the pairs of a stream: the first one and every tenth; may be used from threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        # apart for pairs of which few pixels are matched, and others
        self._counts = dict.fromkeys(_KINDS.values(), 0)
        self._last = dict.fromkeys(_KINDS.values(), NOTHING)

    def update(
        self,
        left: FloatImage,
        right: FloatImage,
        matched: Match,
        config: MatchConfig,
        infinity_px: float | None = None,
        faults: tuple[str, str] | None = None,
    ) -> Findings:
        """Return what is wrong with this pair, or with the last one that was examined.

        A pair without matches is always examined.

        Parameters
        ----------
        left, right, config, infinity_px
            As for `overview`.
        matched : Match
            Their match.
        faults : (str, str), optional
            `image_fault` of both, if that is known.

        Raises
        ------
        ImageError
            If few pixels are matched and the images match only when they are exchanged.

        """
        few, unmatched = matched.matched_share < FEW_MATCHED, not matched.matched_share
        with self._lock:
            due = self._counts[few] % EXAMINE_EVERY == 0
            self._counts[few] += 1
            if due:
                self._last[few] = NOTHING
        cause, found = '', NOTHING
        if few:
            faults = faults or (image_fault(left), image_fault(right))
            sides = zip(('left', 'right'), faults, strict=True)
            cause = next((f'the {side} image {fault}' for side, fault in sides if fault), '')
            if not cause:
                check_order(left, right, config, infinity_px)
        if few and (due or unmatched):
            found = Findings(cause=cause or explain_few(left, right, config, infinity_px))
        elif due:
            found = _examined(left, right, matched)
        if due:
            self._last[few] = found
        return found if unmatched else self._last[few]

    def state(self) -> dict[str, Any]:
        """Return what the findings of later pairs depend on, as JSON can hold it."""
        with self._lock:
            return {
                name: {'count': self._counts[few], 'last': self._last[few].state()}
                for name, few in _KINDS.items()
            }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a `state`."""
        with self._lock:
            self._counts = {few: state[name]['count'] for name, few in _KINDS.items()}
            self._last = {
                few: Findings.restored(state[name]['last']) for name, few in _KINDS.items()
            }


def _examined(left: FloatImage, right: FloatImage, matched: Match) -> Findings:
    """Return what is wrong with a pair of which enough pixels are matched."""
    rows = measure_rows(left, right, matched.disparity_px)
    images = {'left': left, 'right': right}
    blurred = _less_sharp(images, _SLIGHTLY_BLURRED if rows.warning else _BLURRED)
    # where one image is blurred, rows cannot be measured
    texts = (blurred or rows.warning, _interlaced(images))
    return Findings(rows, tuple(filter(None, texts)))


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


def explain_few(
    left: FloatImage, right: FloatImage, config: MatchConfig, infinity_px: float | None = None
) -> str:
    """Return why few pixels of a pair without an `image_fault` match; '' if nothing shows it.

    Parameters
    ----------
    left, right, config, infinity_px
        As for `overview`.

    """
    images = {'left': left, 'right': right}
    causes: tuple[Callable[[], str], ...] = (
        lambda: _turned(left, right, config, infinity_px or 0.0),
        lambda: _rows_apart(left, right),
        lambda: _interlaced(images),
        lambda: _less_sharp(images, _BLURRED),
        lambda: _less(
            images, lambda i: float(np.nanstd(i)), _FAINT, 'has less contrast', 'set its exposure'
        ),
    )
    return next((cause for find in causes if (cause := find())), '')


# What is seen, and what to do to which image.
_TURNS: tuple[tuple[str, Callable[[FloatImage], FloatImage]], ...] = (
    ('the {} image is upside down (turned by 180 degrees)', lambda image: image[::-1, ::-1]),
    ('one of the images is flipped top to bottom', lambda image: image[::-1]),
    ('the {} image is mirrored left to right', lambda image: image[:, ::-1]),
)


def _turned(left: FloatImage, right: FloatImage, config: MatchConfig, infinity_px: float) -> str:
    """Say that one image is turned or flipped against the other."""
    far = -abs(infinity_px) - 8  # the principal point is turned too
    given = overview(left, right, config, infinity_px).matched_share
    best, text = max(2 * given, EXCHANGED_SHARE), ''
    for what, turn in _TURNS:
        right_turned = overview(left, np.ascontiguousarray(turn(right)), config, far)
        left_turned = overview(np.ascontiguousarray(turn(left)), right, config, far)
        for side, seen in (('right', right_turned), ('left', left_turned)):
            if seen.matched_share > best:
                best = seen.matched_share
                text = (
                    f'{what.format(side)}: {given:.0%} of the pixels match as given and {best:.0%}'
                    ' the other way round; turn it back in the driver, and calibrate with it so'
                )
    return text


def _rows_apart(left: FloatImage, right: FloatImage) -> str:
    """Say that rows are off by more than matching bridges, from features anywhere."""
    detector = cv2.ORB_create(nfeatures=_FEATURES)
    (left_points, left_descriptors), (right_points, right_descriptors) = (
        detector.detectAndCompute(_bytes(image), None) for image in (left, right)
    )
    if left_descriptors is None or right_descriptors is None:
        return ''
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(
        left_descriptors, right_descriptors
    )
    steps = np.array(
        [right_points[p.trainIdx].pt[1] - left_points[p.queryIdx].pt[1] for p in pairs]
    )
    if steps.size < _AGREE_LEAST:
        return ''
    steps.sort()
    # the offset that most matches share
    counts = np.searchsorted(steps, steps + _AGREE_PX) - np.arange(steps.size)
    first = int(counts.argmax())
    agreeing = steps[first : first + counts[first]]
    off_px = float(np.median(agreeing))
    if len(agreeing) < max(_AGREE_LEAST, _AGREE_SHARE * steps.size) or abs(off_px) < MOST_ROWS_PX:
        return ''
    return (
        f'rows of left and right differ by about {abs(off_px):.1f} px: the right image is'
        f' {"lower" if off_px > 0 else "higher"} ({len(agreeing)} of {steps.size} features);'
        ' rectify, or calibrate again'
    )


def _bytes(image: FloatImage) -> FloatImage:
    known = np.nan_to_num(image, nan=float(np.nanmean(image)))
    return np.asarray(cv2.normalize(known, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U))


def _interlaced(images: dict[str, FloatImage]) -> str:
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


def _less_sharp(images: dict[str, FloatImage], least: float) -> str:
    return _less(images, _sharpness, least, 'is less sharp', 'focus that camera, clean its lens')


def _sharpness(image: FloatImage) -> float:
    """Return the step between neighbours as a share of the contrast."""
    steps = float(np.nanmean(np.abs(np.diff(image, axis=1))))
    return steps / max(float(np.nanstd(image)), 1e-6)


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
