# SPDX-License-Identifier: Apache-2.0
"""The captured boards of a calibration in progress: on disk before anything is acknowledged."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

from binocular_recon.calibration.rods import Capture, RodBoard
from binocular_recon.errors import CalibrationError, FileError
from binocular_recon.images import Image
from binocular_recon.io.captures import (
    BoardReading,
    CaptureSet,
    capture_set,
    find_boards,
    read_board,
)
from binocular_recon.io.files import flush, make_folder
from binocular_recon.io.image_files import write_image_file

# Where boards go that were dropped: nobody has to put up rods twice because of a slip.
DROPPED = 'dropped'


class CaptureStore:
    """Boards as ``left_NAME.png`` and ``right_NAME.png``, numbered, in one folder.

    ``calibrate`` reads the same folder. A new store on a folder goes on where the last one was.

    Parameters
    ----------
    folder : Path
        Made with its parents where it does not exist.
    board : RodBoard
        The rods in the pictures.

    Raises
    ------
    FileError
        If the folder cannot be made.

    """

    def __init__(self, folder: Path, board: RodBoard) -> None:
        make_folder(folder)
        self.folder = folder
        self._board = board
        self._readings: dict[str, BoardReading] = {}

    @property
    def names(self) -> list[str]:
        """Boards on disk, in the order of capture."""
        return sorted({path.stem.partition('_')[2] for path in self._pictures()}, key=_order)

    def add(self, left: Image, right: Image) -> str:
        """Write a board's pictures and return its name; a power cut after that loses nothing.

        Raises
        ------
        FileError
            If the pictures cannot be written.

        """
        name = f'{max([0, *(_order(name)[0] for name in self.names)]) + 1:03d}'
        try:
            for side, image in (('right', right), ('left', left)):
                path = self._path(side, name)
                write_image_file(path, image)
                flush(path)
            flush(self.folder)
        except OSError as error:
            for side in ('left', 'right'):
                self._path(side, name).unlink(missing_ok=True)
            raise FileError(f'board {name} was not captured: {error}') from error
        return name

    def keep(self, capture: Capture, size: tuple[int, int]) -> None:
        """Take over the marks of a board just added, so that they need not be found again."""
        files = next(files for files in find_boards(self.folder) if files.name == capture.name)
        self._readings[capture.name] = BoardReading(files, capture, size, '')

    def captures(self) -> CaptureSet:
        """Return the marks of all boards.

        Raises
        ------
        CalibrationError
            If there is no board, or no rods were found in any.

        """
        if not self.names:
            raise CalibrationError('no board has been captured yet; put up the rods and capture')
        boards = {files.name: files for files in find_boards(self.folder)}
        readings = {
            name: self._readings.get(name) or read_board(files, self._board)
            for name, files in boards.items()
        }
        self._readings = readings
        return capture_set(list(readings.values()), self.folder)

    def drop(self, names: list[str]) -> None:
        """Move boards out of the way, into a folder of their own under ``dropped/``.

        Raises
        ------
        FileError
            If they cannot be moved.

        """
        target = self.folder / DROPPED / time.strftime('%Y%m%d-%H%M%S')
        while target.exists():
            target = target.with_name(f'{target.name}-more')
        make_folder(target)
        try:
            for path in self._pictures():
                if path.stem.partition('_')[2] in names:
                    shutil.move(path, target / path.name)
        except OSError as error:
            raise FileError(f'boards cannot be moved to {target}: {error.strerror}') from error
        for name in names:
            self._readings.pop(name, None)

    def _path(self, side: str, name: str) -> Path:
        return self.folder / f'{side}_{name}.png'

    def _pictures(self) -> list[Path]:
        return [*self.folder.glob('left_*.*'), *self.folder.glob('right_*.*')]


def _order(name: str) -> tuple[int, str]:
    return (int(name) if name.isdigit() else 0), name
