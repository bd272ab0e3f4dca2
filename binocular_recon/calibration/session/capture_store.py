# SPDX-License-Identifier: Apache-2.0
"""The captured boards of a calibration in progress: on disk before anything is acknowledged."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path

from binocular_recon.calibration.session.captures import (
    BoardFiles,
    BoardReading,
    CaptureSet,
    capture_set,
    list_boards,
    read_boards,
)
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.errors import CalibrationError, FileError
from binocular_recon.images import Image
from binocular_recon.inputs.common_size import CommonSize
from binocular_recon.io.files import flush, make_folder
from binocular_recon.io.image_files import write_image_file

# Where boards go that were dropped: nobody has to put up rods twice because of a slip.
DROPPED = 'dropped'


class CaptureStore:
    """Boards as ``left_NAME.png`` and ``right_NAME.png``, numbered, in one folder.

    ``calibrate`` reads the same folder. A new store on a folder goes on where the last one was. A
    number belongs to one board for good, whether it is dropped or not. Any thread may call.

    Parameters
    ----------
    folder : Path
        Made with its parents where it does not exist.
    board : RodBoard
        The rods in the images.
    stopped : callable, optional
        Asked after each board that is read; where it answers True, reading ends with a
        CalibrationError.

    Raises
    ------
    FileError
        If the folder cannot be made.

    """

    def __init__(
        self, folder: Path, board: RodBoard, stopped: Callable[[], bool] | None = None
    ) -> None:
        make_folder(folder)
        self.folder = folder
        self._board = board
        self._stopped = stopped
        self._readings: dict[str, BoardReading] = {}
        self._reading = threading.Lock()

    @property
    def names(self) -> list[str]:
        """Boards on disk, in the order of capture.

        Those that a power cut left with one image do not count: nobody was told of them.
        """
        complete = (files.name for files in list_boards(self.folder) if not files.problem)
        return sorted(complete, key=_order)

    def add(self, left: Image, right: Image) -> str:
        """Write a board's images and return its name; a power cut after that loses nothing.

        Raises
        ------
        FileError
            If the images cannot be written.

        """
        ever = [*self._images(), *self.folder.glob(f'{DROPPED}/*/*_*.*')]
        name = f'{max([0, *(_order(_name(path))[0] for path in ever)]) + 1:03d}'
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

    def keep(self, capture: Capture, sizes: CommonSize) -> None:
        """Take over the marks of a board just added, so that they need not be found again."""
        name = capture.name
        files = BoardFiles(name, self._path('left', name), self._path('right', name))
        with self._reading:
            self._readings[name] = BoardReading(files, capture, sizes, '')

    def captures(self) -> CaptureSet:
        """Return the marks of all boards; a second caller waits for what the first one reads.

        Raises
        ------
        CalibrationError
            If there is no board, no rods were found in any, or reading was stopped.

        """
        if not self.names:
            raise CalibrationError('no board has been captured yet; put up the rods and capture')
        return capture_set(self._read(), self.folder)

    def usable(self) -> CaptureSet | None:
        """Return the same, None where there is no board or no rods were found in any."""
        readings = self._read()
        if not any(reading.capture for reading in readings):
            return None
        return capture_set(readings, self.folder)

    def drop(self, names: list[str]) -> Path:
        """Move boards out of the way and return where: a folder of their own under ``dropped/``.

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
            for path in self._images():
                if _name(path) in names:
                    shutil.move(path, target / path.name)
            for folder in (target, target.parent, self.folder):
                flush(folder)
        except OSError as error:
            raise FileError(f'boards cannot be moved to {target}: {error.strerror}') from error
        with self._reading:
            for name in names:
                self._readings.pop(name, None)
        return target

    def drop_all(self) -> Path | None:
        """Drop every board, incomplete ones too; return where they are, None if there were none.

        Errors as of `drop`.
        """
        names = [files.name for files in list_boards(self.folder)]
        return self.drop(names) if names else None

    def _read(self) -> list[BoardReading]:
        with self._reading:
            boards = list_boards(self.folder)
            known = {reading.files for reading in self._readings.values()}
            unread = [files for files in boards if files not in known]
            for reading in read_boards(unread, self._board, self._proceed):
                self._readings[reading.files.name] = reading
            return [self._readings[files.name] for files in boards]

    def _proceed(self, _reading: BoardReading) -> None:
        if self._stopped is not None and self._stopped():
            raise CalibrationError('reading the boards was stopped')

    def _path(self, side: str, name: str) -> Path:
        return self.folder / f'{side}_{name}.png'

    def _images(self) -> list[Path]:
        return [*self.folder.glob('left_*.*'), *self.folder.glob('right_*.*')]


def _name(path: Path) -> str:
    return path.stem.partition('_')[2]


def _order(name: str) -> tuple[int, str]:
    return (int(name) if name.isdecimal() else 0), name
