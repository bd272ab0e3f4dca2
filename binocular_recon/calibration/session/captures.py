# SPDX-License-Identifier: Apache-2.0
"""Images of rod boards on disk: ``left_NAME.png`` and ``right_NAME.png``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2

from binocular_recon._jit import thread_count
from binocular_recon.calibration.detection.detect import detect_rods
from binocular_recon.calibration.screening import Rejected
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.mark_types import MarkType
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.errors import BinocularReconError, CalibrationError, FileError
from binocular_recon.inputs.common_size import CommonSize
from binocular_recon.io.image_files import read_image_file

SUFFIXES = ('.png', '.tif', '.tiff', '.jpg', '.jpeg', '.bmp', '.pgm', '.ppm')


@dataclass(frozen=True)
class BoardFiles:
    """The two images of one board; None where there is not exactly one, as ``problem`` says."""

    name: str
    left: Path | None
    right: Path | None
    problem: str = ''


@dataclass(frozen=True, eq=False)
class BoardReading:
    """What came out of one board's images.

    Attributes
    ----------
    files : BoardFiles
        Where it came from.
    capture : Capture or None
        The marks; None if the board cannot be used.
    sizes : CommonSize or None
        Sizes of both images.
    reason : str
        Why there is no capture, or which marks are missing.
    mark_type : MarkType or None
        The type of marks that an image shows instead of that of ``rods.yaml``.

    """

    files: BoardFiles
    capture: Capture | None
    sizes: CommonSize | None
    reason: str
    mark_type: MarkType | None = None


@dataclass(frozen=True, eq=False)
class CaptureSet:
    """All usable boards of a folder.

    Attributes
    ----------
    captures : tuple of Capture
        Marks of each board.
    sizes : CommonSize
        Sizes of all left and all right images.
    rejected : tuple of Rejected
        Boards whose images cannot be used and why.

    """

    captures: tuple[Capture, ...]
    sizes: CommonSize
    rejected: tuple[Rejected, ...]

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of the left images, px."""
        return self.sizes.left


def find_boards(folder: Path) -> list[BoardFiles]:
    """List the boards of a folder by name.

    Raises
    ------
    FileError
        If the folder does not exist or holds no such images.

    """
    if not folder.is_dir():
        raise FileError(f'{folder} is not a folder; give the folder with the images of the boards')
    boards = list_boards(folder)
    if not boards:
        raise FileError(
            f'{folder} holds no images of boards; they must be named left_NAME.png and'
            ' right_NAME.png with the same NAME'
        )
    return boards


def list_boards(folder: Path) -> list[BoardFiles]:
    """List the boards of a folder that exists by name; there may be none."""
    found: dict[str, dict[str, list[Path]]] = {}
    for path in sorted(folder.iterdir()):
        side, _, name = path.stem.partition('_')
        if side in ('left', 'right') and name and path.suffix.lower() in SUFFIXES:
            found.setdefault(name, {'left': [], 'right': []})[side].append(path)
    return [_board_files(name, sides) for name, sides in sorted(found.items())]


def _board_files(name: str, sides: dict[str, list[Path]]) -> BoardFiles:
    problems = [f'there is no {side} image' for side, paths in sides.items() if not paths]
    problems += [
        f'there are {len(paths)} {side} images ({", ".join(path.name for path in paths)});'
        ' keep one'
        for side, paths in sides.items()
        if len(paths) > 1
    ]
    left, right = (paths[0] if len(paths) == 1 else None for paths in sides.values())
    return BoardFiles(name, left, right, '; '.join(problems))


def read_board(files: BoardFiles, board: RodBoard) -> BoardReading:
    """Detect the rods in both images of a board; problems are returned, not raised."""
    pair, found = [], []
    if files.left is None or files.right is None:
        return BoardReading(files, None, None, files.problem)
    for path in (files.left, files.right):
        try:
            image = read_image_file(path)
            pair.append(detect_rods(image[..., :3] if image.ndim == 3 else image, board))
        except BinocularReconError as error:
            return BoardReading(files, None, None, str(error))
        except (cv2.error, ValueError) as error:
            # whatever is in one image, the other boards are read
            reason = f'{path} cannot be searched for rods: {error}'
            return BoardReading(files, None, None, reason)
        found.append((image.shape[1], image.shape[0]))
    sizes = CommonSize(*found)
    left, right = pair
    missing = '; '.join(
        f'{side}: {message}'
        for side, detection in (('left', left), ('right', right))
        for message in detection.messages
    )
    if not (left.found.any() and right.found.any()):
        mark_type = left.mark_type or right.mark_type
        return BoardReading(files, None, sizes, missing, mark_type)
    capture = Capture(files.name, left.marks_px, right.marks_px)
    return BoardReading(files, capture, sizes, missing)


def read_captures(
    folder: Path, board: RodBoard, on_board: Callable[[BoardReading], None] | None = None
) -> CaptureSet:
    """Detect the rods in all images of a folder.

    Parameters
    ----------
    folder : Path
        Holds ``left_NAME.png`` and ``right_NAME.png``.
    board : RodBoard
        The rods.
    on_board : callable, optional
        Told each board as it is finished.

    Raises
    ------
    FileError
        If the folder holds no images of boards.
    CalibrationError
        If no board could be found in any pair of images.

    """
    return capture_set(read_boards(find_boards(folder), board, on_board), folder)


def read_boards(
    boards: Sequence[BoardFiles],
    board: RodBoard,
    on_board: Callable[[BoardReading], None] | None = None,
) -> list[BoardReading]:
    """Detect the rods in the images of boards; what ``on_board`` raises ends it early."""
    readings = []
    with ThreadPoolExecutor(thread_count()) as pool:
        try:
            for reading in pool.map(lambda files: read_board(files, board), boards):
                readings.append(reading)
                if on_board is not None:
                    on_board(reading)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return readings


def capture_set(readings: Sequence[BoardReading], folder: Path) -> CaptureSet:
    """Separate the boards of a folder that were found from those that were not.

    Raises
    ------
    CalibrationError
        If no board could be found in any pair of images, or most show another type of marks than
        ``rods.yaml`` states.

    """
    _check_mark_type(readings, folder)
    counts = Counter(reading.sizes for reading in readings if reading.capture and reading.sizes)
    if not counts:
        reasons = '; '.join(f'{reading.files.name}: {reading.reason}' for reading in readings[:3])
        searched = all(reading.sizes is not None for reading in readings)
        what = 'no rods were found in any' if searched else 'nothing can be used'
        raise CalibrationError(f'{what} of the {len(readings)} boards of {folder} ({reasons})')
    sizes = counts.most_common(1)[0][0]
    captures, rejected = [], []
    for reading in readings:
        if reading.sizes not in (None, sizes):
            reason = f'its images are {reading.sizes}, but most images are {sizes}'
            rejected.append(Rejected(reading.files.name, reason))
        elif reading.capture is None:
            rejected.append(Rejected(reading.files.name, reading.reason))
        else:
            captures.append(reading.capture)
    return CaptureSet(tuple(captures), sizes, tuple(rejected))


def _check_mark_type(readings: Sequence[BoardReading], folder: Path) -> None:
    """Raise a CalibrationError if more boards show another type of marks than were read.

    A board of which little is in view fits either type. With the wrong one it is read with wrong
    heights, and only the other boards tell.
    """
    read = sum(reading.capture is not None for reading in readings)
    shown = Counter(reading.mark_type for reading in readings if reading.mark_type is not None)
    for mark_type, count in shown.most_common(1):
        if count > read:
            raise CalibrationError(
                f'on {count} of {len(readings)} boards of {folder} {mark_type.remedy}'
            )
