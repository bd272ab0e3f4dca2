# SPDX-License-Identifier: Apache-2.0
"""The formats of calibrations, and which of them files are."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from binocular_recon.errors import BinocularReconError, CalibrationError, FileError
from binocular_recon.io.calibrations.assembly import ImportedRig, assemble
from binocular_recon.io.calibrations.format import CalibrationFormat
from binocular_recon.io.calibrations.formats.colmap import ColmapFormat
from binocular_recon.io.calibrations.formats.euroc import EurocFormat
from binocular_recon.io.calibrations.formats.kalibr import KalibrFormat
from binocular_recon.io.calibrations.formats.matlab import MatlabFormat
from binocular_recon.io.calibrations.formats.metashape import MetashapeFormat
from binocular_recon.io.calibrations.formats.mrcal import MrcalFormat
from binocular_recon.io.calibrations.formats.opencv import OpenCVFormat
from binocular_recon.io.calibrations.formats.ros import RosFormat
from binocular_recon.io.calibrations.raw_rig import Choice
from binocular_recon.io.calibrations.source import SourceFile

# To add a format, derive from `CalibrationFormat` and list it here.
FORMATS: tuple[CalibrationFormat, ...] = (
    RosFormat(),
    OpenCVFormat(),
    KalibrFormat(),
    EurocFormat(),
    MrcalFormat(),
    ColmapFormat(),
    MatlabFormat(),
    MetashapeFormat(),
)

# Of a folder, files with these endings are looked at, and those of EuRoC's cameras.
_ENDINGS = (
    *('.yaml', '.yml', '.json', '.xml', '.txt', '.bin', '.mat', '.cameramodel', '.cahvor'),
    *('.ini', '.gz'),
)
_DEEPER = ('*/sensor.yaml', 'mav0/*/sensor.yaml')
_MOST_FILES = 500
_OURS = 'calibration.json'  # beside left.yaml, of this package


def read_calibration(
    paths: Iterable[str | Path], choice: Choice | None = None, *, rectified: bool = False
) -> ImportedRig:
    """Read the calibration of a rig in any format of `FORMATS`.

    Parameters
    ----------
    paths : iterable of path
        Its files, or folders that hold them.
    choice : Choice, optional
        What the files leave open.
    rectified : bool
        Whether the images are rectified; only P counts then.

    Raises
    ------
    FileError
        If a file cannot be read.
    CalibrationError
        If no format is found or more than one, or the calibration is not that of a rig.

    """
    given = [Path(path) for path in paths]
    files = [SourceFile(path) for one in given for path in _files(one)]
    claimed, left_over, errors = _claims(files)
    where = ', '.join(map(str, given))
    named = {path for path in given if not path.is_dir()}
    for error, file in errors:
        if file.path in named or not claimed:
            raise error
    if not claimed:
        raise CalibrationError(
            f'{where}: no calibration is found in {_found(files)}; {formats_text()} are read'
        )
    if len(claimed) > 1:
        several = '; '.join(
            f'{", ".join(file.name for file in found[:4])} ({name.NAME})'
            for name, found in claimed.items()
        )
        raise CalibrationError(
            f'{where} holds calibrations of several formats: {several}; give the files of one'
        )
    ((format_, found),) = claimed.items()
    for file in left_over:
        if file.path in named:
            raise CalibrationError(
                f'{file.path} is no part of a calibration of {format_.NAME} ({format_.FILES}), as'
                f' {found[0].name} is; give the files of one calibration only'
            )
    choice = choice or Choice()
    return assemble(format_.read(found, choice), choice, rectified=rectified)


def formats_text() -> str:
    """Return the formats and their files, for messages."""
    texts = [f'{one.NAME} ({one.FILES})' for one in FORMATS]
    return f'{", ".join(texts[:-1])} and {texts[-1]}'


def _files(path: Path) -> Sequence[Path]:
    if not path.is_dir():
        return [path]
    try:
        files = [one for pattern in _DEEPER for one in sorted(path.glob(pattern))]
        files += [one for one in sorted(path.iterdir()) if one.name.lower().endswith(_ENDINGS)]
    except OSError as error:
        raise FileError(
            f'{path} cannot be read: {error.strerror or error}; give a folder with a calibration'
        ) from error
    files = [one for one in files if not one.name.startswith('.') and one.name != _OURS]
    return [one for one in files if one.is_file()][:_MOST_FILES]


def _claims(
    files: Sequence[SourceFile],
) -> tuple[
    dict[CalibrationFormat, list[SourceFile]],
    list[SourceFile],
    list[tuple[BinocularReconError, SourceFile]],
]:
    """Return the files of each format, those of none, and those that could not be read."""
    claimed: dict[CalibrationFormat, list[SourceFile]] = {}
    left_over, errors = [], []
    for file in files:
        try:
            found = next((one for one in FORMATS if one.claims(file)), None)
        except BinocularReconError as error:
            if not file.head or file.name.lower().endswith(_ENDINGS):
                errors.append((error, file))
                continue
            found = None  # an image, a bag, ...: what is read matters more than where it fails
        if found is None:
            left_over.append(file)
        else:
            claimed.setdefault(found, []).append(file)
    return claimed, left_over, errors


def _found(files: Sequence[SourceFile]) -> str:
    if not files:
        return 'it: it has no file with an ending of these formats'
    texts = []
    for file in files[:3]:
        try:
            content = file.content
        except BinocularReconError:
            content = None
        if isinstance(content, dict) and content:
            keys = ', '.join(str(key)[:30] for key in list(content)[:6])
            texts.append(f'{file.name} (it has {keys})')
        else:
            texts.append(file.name + _beginning(file.head))
    return ', '.join(texts) + (', ...' if len(files) > 3 else '')


def _beginning(head: bytes) -> str:
    lines = head.decode('utf-8', 'replace').replace('\t', ' ').splitlines()
    first = next((line.strip() for line in lines if line.strip()), '')
    if not first.isprintable() or '\ufffd' in first:
        return ' (it is no text)'
    return f' (it begins with {first[:40]!r})' if first else ''
