# SPDX-License-Identifier: Apache-2.0
"""Matchers by name: the option ``matcher`` chooses one of them.

To add a matcher, write a function of the type `Matcher` and call `register_matcher` with a name
before the options are made; the chain, the nodes and the commands then accept the name.
"""

from __future__ import annotations

from collections.abc import Callable

from binocular_recon.config import MATCHER_NAMES, MatchConfig
from binocular_recon.errors import ConfigError, ImageError
from binocular_recon.images import FloatImage
from binocular_recon.stereo.matching._preparation import check_pair
from binocular_recon.stereo.matching.matcher import Match, match_ncc

# Takes the left and the right image, (H, W) float32, grey levels 0..255, NaN = no data, rectified
# and of equal size, and the options of matching. Returns disparities within
# ``MatchConfig.limits_px``, their confidences and their validity; see `Match`.
Matcher = Callable[[FloatImage, FloatImage, MatchConfig], Match]

# The built-in ones are those in `config.MATCHER_NAMES`.
_MATCHERS: dict[str, Matcher] = {'ncc': match_ncc}


def register_matcher(name: str, matcher: Matcher) -> None:
    """Add a matcher, which the option ``matcher`` then accepts by its name.

    Parameters
    ----------
    name : str
        Value of the option.
    matcher : callable
        Called with the left and the right image and a `MatchConfig`; returns a `Match`.

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
    _MATCHERS[name] = matcher
    MATCHER_NAMES.append(name)


def match(left: FloatImage, right: FloatImage, config: MatchConfig) -> Match:
    """Match a rectified pair by the matcher that ``config.matcher`` names.

    Parameters
    ----------
    left, right : (H, W) float32
        Grey levels 0..255, any precision; NaN = no data.
    config : MatchConfig
        Options of matching.

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
    matched = _MATCHERS[config.matcher](left, right, config)
    for name in ('disparity_px', 'confidence', 'validity'):
        shape = getattr(matched, name).shape
        if shape != left.shape:
            raise ImageError(
                f'matcher {config.matcher!r} returned {name} of shape {shape} for images of'
                f' {left.shape} (rows, columns); it must return one value per pixel'
            )
    return matched
