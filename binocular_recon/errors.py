# SPDX-License-Identifier: Apache-2.0
"""Errors that the package raises on purpose, and foreign text in their messages.

Every message states the problem, the value, the limit and the remedy. The command line prints it
and returns exit status 1 (2 for a `ConfigError`); a node logs it and drops the frame. Names from
bags, messages and files are written out where a terminal would obey them.
"""

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


class BinocularReconError(Exception):
    """Base of every error that the package raises on purpose."""

    def __str__(self) -> str:
        """Return the message without control characters."""
        return plain_text(super().__str__())


class ConfigError(BinocularReconError, ValueError):
    """An option has an unknown name or a value outside its range."""


class ImageError(BinocularReconError, ValueError):
    """An image has the wrong size, encoding or content."""


class CalibrationError(BinocularReconError, ValueError):
    """A calibration is missing, contradicts itself or cannot be estimated."""


class BagError(BinocularReconError):
    """A bag cannot be read or does not hold what is needed."""


class MeasurementError(BinocularReconError, ValueError):
    """A point cannot be located, or points do not make what is to be measured."""


class FileError(BinocularReconError, OSError):
    """A file cannot be read or written."""


class DependencyError(BinocularReconError):
    """A package is missing that only some users need."""


class ClusterError(BinocularReconError):
    """A cluster of machines cannot be reached or used."""
