# SPDX-License-Identifier: Apache-2.0
"""Black and white of images: found from the data where the type does not say it.

An 8-bit image has white at 255. A 16-bit one may hold 10, 12 or 14 bits, or counts of a thermal
camera that fill a small part of the range; floating-point ones hold 0 to 1, 0 to 255 or degrees.
"""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon.inputs.options import ImageConfig

# Largest value and white of 16-bit images, by the bits that they hold, and of floating-point ones.
# White of 10 to 14 bits is that of 8-bit values shifted, whose steps remain whole grey levels.
_WHITE_16: tuple[tuple[float, float], ...] = (
    (255, 255),
    (1023, 1020),
    (4095, 4080),
    (16383, 16320),
    (65535, 65535),
)
_WHITE_FLOAT: tuple[tuple[float, float], ...] = ((1, 1), *_WHITE_16)
_LARGEST = {white: largest for largest, white in _WHITE_FLOAT}
# Floating-point images overshoot where they were interpolated: up to this multiple of white.
_OVERSHOOT = 1.5
# Brighter or darker pixels than these are ignored: hot ones and single damaged ones. More of them
# are if the others lie in less than half of the range.
_IGNORED_SHARE, _IGNORED_LEAST, _MORE_IGNORED = 2e-5, 4, 2e-4
# At most so many samples of an image are looked at.
_SAMPLES = 60_000
# Levels that lie in less than this share of the range, farther from 0 than they are apart, are
# counts with an offset, if white is at least this; black and white then lie this share of the
# span beyond the levels.
_OFFSET_SHARE, _OFFSET_WHITE_16, _OFFSET_WHITE_FLOAT, _MARGIN = 1 / 8, 16320.0, 255.0, 0.25
# A floating-point image has negative levels, not overshoot, from this share of the highest on; of
# images from 0 to 1 from this share of white on.
_NEGATIVE, _NEGATIVE_OF_1 = -0.1, -0.25
# Levels of a stream shrink when so many frames in a row need less than this share of them.
SHRINK_AFTER, SHRINK_SHARE = 10, 0.5


class Levels(NamedTuple):
    """Values of black and white in an image."""

    black: float = 0.0
    white: float = 255.0


EIGHT_BIT = Levels()


class _Span(NamedTuple):
    """The lowest and the highest level of images."""

    low: float
    high: float

    def state(self) -> tuple[float, float] | None:
        """Return the levels, or None without data, as JSON can hold it."""
        return (self.low, self.high) if self.low <= self.high else None

    @classmethod
    def restored(cls, state: tuple[float, float] | None) -> _Span:
        """Return the span of a `state`."""
        return _NO_DATA if state is None else cls(*state)


_NO_DATA = _Span(np.inf, -np.inf)


def find_levels(*images: npt.NDArray[Any]) -> Levels:
    """Return black and white of images of one type, from their values.

    Parameters
    ----------
    *images : (H, W) or (H, W, C), uint8, uint16 or float
        0 counts as no data in 16-bit images, NaN in floating-point ones.

    """
    return _levels(_joint_span(images), images[0].dtype)


class LevelTracker:
    """Black and white of a stream of images, which do not change from frame to frame.

    They are found in the first frame and grow when a frame has levels outside; they shrink only
    when several frames in a row need much less. May be used from several threads.

    Parameters
    ----------
    config : ImageConfig, optional
        May fix black and white.

    """

    def __init__(self, config: ImageConfig | None = None) -> None:
        self.config = config or ImageConfig()
        self._lock = threading.Lock()
        self._streams: dict[str, _Stream] = {}

    def update(self, *images: npt.NDArray[Any]) -> tuple[Levels, ...]:
        """Return black and white of each image of a frame; one for all that have one type."""
        kinds = {image.dtype.name: image.dtype for image in images}
        found = {name: self._of(kind, images) for name, kind in kinds.items()}
        return tuple(found[image.dtype.name] for image in images)

    def state(self) -> dict[str, Any]:
        """Return what the levels of later frames depend on, as JSON can hold it."""
        with self._lock:
            return {name: stream.state() for name, stream in self._streams.items()}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a `state`."""
        with self._lock:
            self._streams = {
                name: _Stream(np.dtype(name), values) for name, values in state.items()
            }

    def _of(self, kind: np.dtype[Any], images: tuple[npt.NDArray[Any], ...]) -> Levels:
        if kind == np.uint8:
            return EIGHT_BIT
        if self.config.white_level:
            return Levels(self.config.black_level, self.config.white_level)
        span = _joint_span([image for image in images if image.dtype == kind])
        with self._lock:
            return self._streams.setdefault(kind.name, _Stream(kind)).update(span)


class _Stream:
    """Levels of the images of one type."""

    def __init__(self, kind: np.dtype[Any], state: dict[str, Any] | None = None) -> None:
        self._kind = kind
        self._levels: Levels | None = None
        self._span = _NO_DATA
        self._smaller: list[_Span] = []
        if state is not None:
            self._levels = Levels(*state['levels'])
            self._span = _Span.restored(state['span'])
            self._smaller = [_Span.restored(span) for span in state['smaller']]

    def state(self) -> dict[str, Any]:
        return {
            'levels': self._levels,
            'span': self._span.state(),
            'smaller': [span.state() for span in self._smaller],
        }

    def update(self, span: _Span) -> Levels:
        now, needed = self._levels, _levels(span, self._kind)
        if now is None or not self._holds(now, span):
            self._span = _union(self._span, span)
            self._levels = _levels(self._span, self._kind)
            self._smaller = []
        elif needed.white - needed.black >= SHRINK_SHARE * (now.white - now.black):
            self._smaller = []
        else:
            self._smaller.append(span)
            if len(self._smaller) >= SHRINK_AFTER:
                self._span = _NO_DATA
                for one in self._smaller:
                    self._span = _union(self._span, one)
                self._levels = _levels(self._span, self._kind)
                self._smaller = []
        assert self._levels is not None
        return self._levels

    def _holds(self, levels: Levels, span: _Span) -> bool:
        if not span.low <= span.high:  # no data
            return True
        if levels.black:
            return levels.black <= span.low and span.high <= levels.white
        largest = _LARGEST.get(levels.white, levels.white) * _slack(self._kind)
        return span.high <= largest and not _negative(span, levels.white)


def _union(one: _Span, other: _Span) -> _Span:
    return _Span(min(one.low, other.low), max(one.high, other.high))


def _slack(kind: np.dtype[Any]) -> float:
    return _OVERSHOOT if kind.kind == 'f' else 1.0


def _negative(span: _Span, white: float) -> bool:
    return span.low < (_NEGATIVE_OF_1 if white <= 1 else _NEGATIVE * span.high)


def _joint_span(images: Any) -> _Span:
    """Return the lowest and the highest level of all images; inf and -inf without data."""
    joint = _NO_DATA
    for image in images:
        colours = image[..., :3] if image.ndim == 3 else image  # alpha has its own white
        step = max(1, int(np.sqrt(colours.size / _SAMPLES)))
        values = colours[::step, ::step].ravel()
        values = values[np.isfinite(values)] if values.dtype.kind == 'f' else values[values > 0]
        if values.size == 0:
            continue
        spans = [_span(values, share) for share in (_IGNORED_SHARE, _MORE_IGNORED)]
        most, usual = (span.high - span.low for span in spans)
        joint = _union(joint, spans[usual < most / 2])
    return joint


def _span(values: npt.NDArray[Any], ignored_share: float) -> _Span:
    ignored = int(ignored_share * values.size) + _IGNORED_LEAST
    ignored = min(ignored, (values.size - 1) // 100)
    ends = np.partition(values, (ignored, values.size - 1 - ignored))
    return _Span(float(ends[ignored]), float(ends[-1 - ignored]))


def _levels(span: _Span, kind: np.dtype[Any]) -> Levels:
    if kind == np.uint8:
        return EIGHT_BIT
    whites, least = _WHITE_16, _OFFSET_WHITE_16
    if kind.kind == 'f':
        whites, least = _WHITE_FLOAT, _OFFSET_WHITE_FLOAT
    low, high = span
    if not low <= high:
        return Levels(0.0, float(whites[-1 if kind.kind == 'u' else 0][1]))
    slack = _slack(kind)
    white = next((float(one) for largest, one in whites if high <= largest * slack), high)
    spread = high - low
    offset = low > spread and spread < _OFFSET_SHARE * white and white >= least
    if spread > 0 and (offset or _negative(span, white)):
        margin = _MARGIN * spread
        return Levels(low - margin, high + margin)
    return Levels(0.0, white)
