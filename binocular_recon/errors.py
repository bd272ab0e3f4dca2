# SPDX-License-Identifier: Apache-2.0
"""Errors that the package raises on purpose.

Every message states the problem, the value, the limit and the remedy. The command line prints it
and returns exit status 1 (2 for a `ConfigError`); a node logs it and drops the frame. Names from
bags, messages and files are written out where a terminal would obey them.
"""

from binocular_recon.plain_text import plain_text


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


class FileError(BinocularReconError, OSError):
    """A file cannot be read or written."""
