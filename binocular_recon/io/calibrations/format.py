# SPDX-License-Identifier: Apache-2.0
"""What every format of calibrations does."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from binocular_recon.io.calibrations.raw_rig import Choice, RawRig
from binocular_recon.io.calibrations.source import SourceFile


class CalibrationFormat(ABC):
    """One format.

    Attributes
    ----------
    NAME : str
        What messages call it.
    FILES : str
        Which files it consists of, for messages.

    """

    NAME: ClassVar[str]
    FILES: ClassVar[str]

    @abstractmethod
    def claims(self, file: SourceFile) -> bool:
        """Return whether a file is one of this format, whole or not.

        Errors of `SourceFile.content` may pass.
        """

    @abstractmethod
    def read(self, files: Sequence[SourceFile], choice: Choice) -> RawRig:
        """Read the cameras of the files that it claims.

        Raises
        ------
        BinocularReconError
            If a file cannot be read or a value is not that of a camera; the message names file
            and camera.

        """
