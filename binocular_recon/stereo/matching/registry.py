# SPDX-License-Identifier: Apache-2.0
"""Matchers by name: the option ``matcher`` chooses one of them.

To add a matcher, write a function of the type `Matcher` and call `register_matcher` with a name
before the options are made; the chain, the nodes and the commands then accept the name.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from binocular_recon.config import MATCHER_NAMES, MatchConfig
from binocular_recon.errors import ConfigError, ImageError
from binocular_recon.images import FloatImage, Image
from binocular_recon.stereo.matching._preparation import check_pair
from binocular_recon.stereo.matching.matcher import Match, match_ncc

# Takes the left and the right image, (H, W) float32, grey levels 0..255, NaN = no data, rectified
# and of equal size, and the options of matching; with colour they are (H, W, 3), BGR. Returns
# disparities within ``MatchConfig.limits_px``, their confidences and their validity; see `Match`.
Matcher = Callable[[FloatImage, FloatImage, MatchConfig], Match]

# Returns the left and the right image of a pair as (H, W, 3) BGR, levels 0..255.
Colours = Callable[[], tuple[Image, Image]]


def _match_onnx(left: FloatImage, right: FloatImage, config: MatchConfig) -> Match:
    from binocular_recon.stereo.foreign.onnx_matcher import match_onnx

    return match_onnx(left, right, config)


class _Entry(NamedTuple):
    matcher: Matcher
    colour: bool = False


# The built-in ones are those in `config.MATCHER_NAMES`.
_MATCHERS = {'ncc': _Entry(match_ncc), 'onnx': _Entry(_match_onnx, colour=True)}


def register_matcher(name: str, matcher: Matcher, *, colour: bool = False) -> None:
    """Add a matcher, which the option ``matcher`` then accepts by its name.

    Parameters
    ----------
    name : str
        Value of the option.
    matcher : callable
        Called with the left and the right image and a `MatchConfig`; returns a `Match`.
    colour : bool
        It takes the images as (H, W, 3) BGR, not as (H, W) grey.

    Raises
    ------
    ConfigError
        If the name is registered already.

    """
    if name in _MATCHERS:
        raise ConfigError(
            f'matcher {name!r} is registered already; choose a name that is not one of'
            f' {", ".join(_MATCHERS)}'
        )
    _MATCHERS[name] = _Entry(matcher, colour)
    MATCHER_NAMES.append(name)


def match(
    left: FloatImage, right: FloatImage, config: MatchConfig, colours: Colours | None = None
) -> Match:
    """Match a rectified pair by the matcher that ``config.matcher`` names.

    Parameters
    ----------
    left, right : (H, W) float32
        Grey levels 0..255, any precision; NaN = no data.
    config : MatchConfig
        Options of matching.
    colours : callable, optional
        Returns both images as (H, W, 3) uint8 BGR; called if the matcher takes colour. Without
        it, such a matcher gets the grey levels in three channels.

    Returns
    -------
    Match
        Disparity and confidence of each pixel that could be matched.

    Raises
    ------
    ConfigError
        If the matcher is not registered in this process, or ``disparity_range`` is 0.
    ImageError
        If the images differ in size or are not grey levels 0..255, or if a registered matcher
        returns images of another size.

    """
    left, right = check_pair(left, right)
    _ = config.limits_px  # raises if the range is yet to be found
    if config.matcher not in _MATCHERS:  # the options come from another process
        raise ConfigError(
            f'matcher must be one of {", ".join(_MATCHERS)}, got {config.matcher!r}; call'
            ' register_matcher in every process'
        )
    entry = _MATCHERS[config.matcher]
    pair = _coloured(left, right, colours) if entry.colour else (left, right)
    matched = entry.matcher(*pair, config)
    for name in ('disparity_px', 'confidence', 'validity'):
        shape = getattr(matched, name).shape
        if shape != left.shape:
            raise ImageError(
                f'matcher {config.matcher!r} returned {name} of shape {shape} for images of'
                f' {left.shape} (rows, columns); it must return one value per pixel'
            )
    return matched


def _coloured(
    left: FloatImage, right: FloatImage, colours: Colours | None
) -> tuple[FloatImage, FloatImage]:
    """Return a pair as (H, W, 3) float32, NaN where the grey images have no data."""
    coloured = []
    for grey, colour in zip((left, right), colours() if colours else (left, right), strict=True):
        bgr = np.array(colour if colour.ndim == 3 else np.stack([colour] * 3, axis=-1), np.float32)
        bgr[np.isnan(grey)] = np.nan
        coloured.append(bgr)
    return coloured[0], coloured[1]
