# SPDX-License-Identifier: Apache-2.0
"""Validity of a disparity: measured, filled or extrapolated, and why it was not measured."""

from __future__ import annotations

from enum import IntFlag

from binocular_recon.stereo import _validity_kernels as bits

# Shares of measured pixels below which a result is refused, and below which a warning is given.
LEAST_MATCHED, FEW_MATCHED = 0.1, 0.3
# With a larger share of the matches outside of a given search range a result is refused too.
MOST_OUTSIDE = 0.05
REMEDY = (
    'check that left and right are not exchanged, that rows correspond (calibration), exposure,'
    ' focus and the search range'
)


def few_matched_warning(matched_share: float, cause: str = '') -> str:
    """Return the warning for a result of which few pixels were matched, '' if enough were.

    ``cause`` says why, as far as it is known.
    """
    if matched_share >= FEW_MATCHED:
        return ''
    return f'only {matched_share:.0%} of the pixels could be matched; {cause or REMEDY}'


class Validity(IntFlag):
    """Bits of a validity image, (H, W) uint8, similar to the validity mask of CNES Pandora.

    A pixel with a disparity has one of the first three bits; one that is not measured also has the
    bit of the reason. 0: no disparity, and no reason known.
    """

    MEASURED = int(bits.MEASURED)
    """Matched in both images; every check passed."""
    FILLED = int(bits.FILLED)
    """Not measured; between measured pixels."""
    EXTRAPOLATED = int(bits.EXTRAPOLATED)
    """Not measured; beyond the last measured pixel: not seen by the right camera, or sky."""
    LOW_TEXTURE = int(bits.LOW_TEXTURE)
    """Too little texture for a score."""
    CONFLICT = int(bits.CONFLICT)
    """The left-right check failed, or the best correlation is not positive."""
    AMBIGUOUS = int(bits.AMBIGUOUS)
    """Another disparity is as good, or too few neighbours agree."""
    AT_LIMIT = int(bits.AT_LIMIT)
    """The best disparity is the first or the last of the search range."""
    NO_DATA = int(bits.NO_DATA)
    """One of the images has no data there."""
