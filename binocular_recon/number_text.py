# SPDX-License-Identifier: Apache-2.0
"""Numbers and days as people read them in messages, reports and tables."""

from __future__ import annotations

import math
from datetime import datetime
from decimal import Decimal

# Not from strftime, which takes the language of the machine.
_MONTHS = (
    'January', 'February', 'March', 'April', 'May', 'June', 'July', 'August', 'September',
    'October', 'November', 'December',
)  # fmt: skip


def day_text(date: str) -> str:
    """Return the day of a date (ISO 8601): ``28 November 2026``; another text as it is."""
    try:
        day = datetime.fromisoformat(date)
    except ValueError:
        return date
    return f'{day.day} {_MONTHS[day.month - 1]} {day.year}'


def fixed(value: float | None, decimals: int = 1) -> str:
    """Return a number with ``decimals`` places, for the columns of a table.

    Parameters
    ----------
    value : float or None
        None and NaN, no number, become ``-``; infinity becomes ``none``.
    decimals : int
        Digits behind the point.

    """
    if value is None or math.isnan(value):
        return '-'
    return f'{value:.{decimals}f}' if math.isfinite(value) else 'none'


def significant(value: float | None, digits: int = 3) -> str:
    """Return a number with ``digits`` significant digits, trailing zeros included.

    A whole number keeps all its digits: 12345 does not become 12300. No number and infinity are
    as for `fixed`.
    """
    if value is None or not math.isfinite(value) or value == 0:
        return fixed(value, 0)
    # the exponent after rounding: 9.996 has as many places as 10.0
    exponent = int(f'{value:.{digits - 1}e}'.partition('e')[2])
    return fixed(value, max(0, digits - 1 - exponent))


def plain(value: float, digits: int = 6) -> str:
    """Return a round number with no more digits than it needs, and at most ``digits``."""
    if not math.isfinite(value):
        return fixed(value)
    text = f'{Decimal(f"{value:.{digits}g}"):f}'  # without an exponent
    return '0' if text == '-0' else text


def counted(count: int, one: str, more: str = '') -> str:
    """Return a number of things: ``1 frame``, ``2 frames``.

    Parameters
    ----------
    count : int
    one, more : str
        What stands behind the number if it is 1, and else; without ``more`` an s is added to
        ``one``. With a verb where it follows: ``'frame is', 'frames are'``.

    """
    return f'{count} {one if count == 1 else more or one + "s"}'


def reach(far_m: float) -> str:
    """Return the depth up to which something goes, metres, or ``infinity``."""
    return f'{far_m:.1f} m' if math.isfinite(far_m) else 'infinity'
