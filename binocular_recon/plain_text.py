# SPDX-License-Identifier: Apache-2.0
"""Foreign text as it may be shown: short, on one line, without commands to a terminal."""

from __future__ import annotations

# Longest foreign value in a message, characters.
_LONGEST = 120


def plain_text(text: str) -> str:
    r"""Return a text whose control characters are written out, as in ``\x1b[2J``.

    Names in bags, messages and files may hold escape sequences, which a terminal would obey.
    """
    return ''.join(
        one if one.isprintable() else repr(one)[1:-1] if one not in '\n\t' else one for one in text
    )


def shortened(value: object) -> str:
    """Return a foreign value, or the text of another library's error, for a message."""
    text = str(value) if isinstance(value, Exception) else repr(value)
    text = plain_text(' '.join(text.split()))
    return text if len(text) <= _LONGEST else f'{text[: _LONGEST - 4]} ...'
