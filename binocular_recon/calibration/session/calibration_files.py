# SPDX-License-Identifier: Apache-2.0
"""The folder of a calibration: written as a whole, the one before is kept.

``left.yaml``, ``right.yaml``, ``calibration.json`` and ``report.html``; those of the calibration
before are in ``previous/``.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from binocular_recon.calibration.report.report import render_report
from binocular_recon.calibration.result import CalibrationResult
from binocular_recon.calibration.session.board_images import draw_boards
from binocular_recon.camera import StereoRig
from binocular_recon.errors import FileError
from binocular_recon.io.calibration_yaml import PENDING, locked, write_rig
from binocular_recon.io.files import (
    flush,
    make_folder,
    part_folder,
    remove_abandoned,
    write_json,
    write_text,
)

FILES = ('left.yaml', 'right.yaml', 'calibration.json', 'report.html')
PREVIOUS = 'previous'


def save_calibration(
    result: CalibrationResult,
    folder: Path,
    names: tuple[str, str] = ('left', 'right'),
    captures: Path | None = None,
) -> tuple[Path, ...]:
    """Write a calibration; the one in the folder moves to ``previous/``.

    An interruption at any point leaves either the old calibration or, after `finish_saving`, the
    new one; never a mixture.

    Parameters
    ----------
    result : CalibrationResult
        What `solve` returned.
    folder : Path
        Made with its parents where it does not exist.
    names : (str, str)
        Names of the left and the right camera, which their drivers compare.
    captures : Path, optional
        Folder of the boards' images, for the report.

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    FileError
        If the files cannot be written.

    """

    def write(partial: Path) -> None:
        write_rig(partial, result.rig, names)
        write_json(partial / 'calibration.json', {'date': result.date, **result.to_mapping()})
        images = draw_boards(result, captures) if captures else ()
        write_text(partial / 'report.html', render_report(result, images, result.date))

    _replace(folder, write)
    return tuple(folder / name for name in FILES)


def save_rig(rig: StereoRig, folder: Path) -> tuple[Path, ...]:
    """Write a rig that was calibrated elsewhere, as `save_calibration` does: the camera files.

    Raises
    ------
    FileError
        If the files cannot be written.

    """
    _replace(folder, lambda partial: write_rig(partial, rig))
    return folder / 'left.yaml', folder / 'right.yaml'


def _replace(folder: Path, write: Callable[[Path], None]) -> None:
    """Replace the calibration of a folder by the files that ``write`` writes to another one."""
    make_folder(folder)
    try:
        with part_folder(folder) as part:
            write(part)
            for path in part.iterdir():
                flush(path)
            flush(part)
            with locked(folder):
                _finish(folder)
                part.rename(folder / PENDING)  # from now on it is the calibration
                _finish(folder)
            remove_abandoned(folder)
    except OSError as error:
        raise _failure(folder, error) from error


def finish_saving(folder: Path) -> None:
    """Put a calibration in place whose saving was interrupted; does nothing if none was.

    `read_rig` reads what was saved last without it.

    Raises
    ------
    FileError
        If the files cannot be moved.

    """
    if (folder / PENDING).is_dir():
        try:
            with locked(folder):
                _finish(folder)
        except OSError as error:
            raise _failure(folder, error) from error


def _finish(folder: Path) -> None:
    complete, previous = folder / PENDING, folder / PREVIOUS
    if not complete.is_dir():
        return
    if (complete / FILES[0]).exists():  # so none has taken its place yet
        for name in FILES:
            if (folder / name).exists() and not (complete / name).exists():
                previous.mkdir(exist_ok=True)
                (folder / name).replace(previous / name)
    for name in FILES:
        # a file that has taken its place before the interruption is no longer here
        if (complete / name).exists():
            if (folder / name).exists():
                previous.mkdir(exist_ok=True)
                (folder / name).replace(previous / name)
            (complete / name).replace(folder / name)
    complete.rmdir()
    flush(folder)


def _failure(folder: Path, error: OSError) -> FileError:
    return FileError(
        f'the calibration cannot be saved in {folder}: {error.strerror or error}; the one before'
        ' is unharmed; free some space or choose another folder'
    )
