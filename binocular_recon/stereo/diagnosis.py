# SPDX-License-Identifier: Apache-2.0
"""Why few pixels of a pair can be matched, and whether its rows correspond."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from binocular_recon.config import MatchConfig
from binocular_recon.images import FloatImage
from binocular_recon.inputs.image_faults import (
    BLURRED,
    SLIGHTLY_BLURRED,
    faint,
    image_fault,
    interlaced,
    less_sharp,
    noise_alone,
    partly_covered,
    same_image,
)
from binocular_recon.stereo.matching import Match
from binocular_recon.stereo.row_check import (
    RowOffset,
    matched_features,
    measure_rows,
    rows_apart,
    seen_by_both,
)
from binocular_recon.stereo.search_range import EXCHANGED_SHARE, check_order, overview
from binocular_recon.stereo.validity import FEW_MATCHED

# A pair is examined in the first frame of a stream and then in every tenth.
EXAMINE_EVERY = 10


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

    def preceded(self, text: str) -> Findings:
        """Return a finding that explains all others in their place, these if it is empty."""
        return Findings(self.rows, (text,), text) if text else self

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
    if same := same_image(left, right):
        return Findings(rows, (same,))
    blurred = less_sharp(images, SLIGHTLY_BLURRED if rows.warning else BLURRED)
    # where one image is blurred, rows cannot be measured
    texts = (blurred or faint(images) or rows.warning, interlaced(images))
    return Findings(rows, tuple(filter(None, texts)))


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
    features = cache(lambda: matched_features(left, right))
    causes: tuple[Callable[[], str], ...] = (
        lambda: same_image(left, right),
        lambda: _turned(left, right, config, infinity_px or 0.0),
        lambda: rows_apart(features(), left.shape),
        lambda: interlaced(images),
        lambda: partly_covered(images),
        lambda: noise_alone(images),
        lambda: less_sharp(images, BLURRED),
        lambda: faint(images),
        lambda: seen_by_both(features()),
    )
    return next((cause for find in causes if (cause := find())), '')


_TURN_BACK = 'turn it back in the driver, and calibrate with it so'
# What is seen, what was done to which image, and the remedy.
_TURNS: tuple[tuple[str, Callable[[FloatImage], FloatImage], str], ...] = (
    (
        'the {} image is upside down (turned by 180 degrees)',
        lambda image: image[::-1, ::-1],
        _TURN_BACK,
    ),
    ('one of the images is flipped top to bottom', lambda image: image[::-1], _TURN_BACK),
    ('the {} image is mirrored left to right', lambda image: image[:, ::-1], _TURN_BACK),
    (
        'one of the images is a negative of the other one',
        lambda image: 255 - image,
        'set both cameras to the same polarity (thermal cameras: white hot or black hot)',
    ),
)


def _turned(left: FloatImage, right: FloatImage, config: MatchConfig, infinity_px: float) -> str:
    """Say that one image is turned, flipped or inverted against the other."""
    far = -abs(infinity_px) - 8  # the principal point is turned too
    given = overview(left, right, config, infinity_px).matched_share
    best, text = max(2 * given, EXCHANGED_SHARE), ''
    for what, turn, remedy in _TURNS:
        right_turned = overview(left, np.ascontiguousarray(turn(right)), config, far)
        left_turned = overview(np.ascontiguousarray(turn(left)), right, config, far)
        for side, seen in (('right', right_turned), ('left', left_turned)):
            if seen.matched_share > best:
                best = seen.matched_share
                text = (
                    f'{what.format(side)}: {given:.0%} of the pixels match as given and {best:.0%}'
                    f' the other way round; {remedy}'
                )
    return text
