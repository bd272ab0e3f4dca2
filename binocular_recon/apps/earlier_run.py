# SPDX-License-Identifier: Apache-2.0
"""An earlier run in an output folder: whether this one may continue it.

A run is continued only by the same one: the same recording, options and versions, because its
files are then those of a run that was never interrupted. All of that is in ``summary.json``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from binocular_recon.apps.summary_entries import RIG_ENTRY, SUMMARY, read_summary
from binocular_recon.errors import FileError
from binocular_recon.io.text_files import open_file
from binocular_recon.number_text import counted

# What of a summary says how the frames are made.
MADE_FROM = ('source', 'preset', 'options', 'formats', 'versions')
# What else a run goes on from.
_STATE = ('left_out', 'finished', 'unpaired', 'images_read', 'damage', *RIG_ENTRY)
# Where a recording lies does not matter.
_ANYWHERE = {f'source.{name}' for name in ('bag', 'left', 'right', 'video', 'calibrated_in')}
# Of each end of a file of a recording so much is compared, bytes.
_END = 1 << 16


def earlier_run(
    folder: Path, made_from: dict[str, Any], endings: list[str]
) -> dict[str, Any] | None:
    """Return the summary of the run that this one continues, None if it starts anew.

    Parameters
    ----------
    folder : Path
        Output folder.
    made_from : dict
        The `MADE_FROM` of this run.
    endings : list of str
        What follows the number of a frame in the names of its files.

    Raises
    ------
    FileError
        If the run in the folder was interrupted and this one is another, or its summary is
        damaged.

    """
    if not (folder / SUMMARY).exists():
        return None
    summary = read_summary(folder, 'choose another folder, or start over (--no-resume)')
    if summary.get('finished') is not False and 'progress' not in summary:
        return None  # of another version, or of another program
    frames = summary['frames']
    reason = _difference(summary, made_from) or _missing(folder, frames, endings)
    if not reason:
        return summary
    if summary.get('finished') or not frames:
        return None
    raise FileError(
        f'{folder} holds {counted(len(frames), "finished frame")} of an interrupted run that'
        f' cannot be continued: {reason}; choose another folder, or start over (--no-resume)'
    )


def state_digest(summary: dict[str, Any]) -> str:
    """Return a digest of what a run goes on from, so that nothing in it needs to be doubted.

    The times that frames took, which differ from run to run, need only be times.
    """
    frames = [
        {**one, 'seconds': isinstance(one.get('seconds'), float)} for one in summary['frames']
    ]
    progress = {name: value for name, value in summary['progress'].items() if name != 'digest'}
    state = [frames, progress, {name: summary.get(name) for name in _STATE}]
    return hashlib.sha256(json.dumps(state, sort_keys=True).encode()).hexdigest()


def fingerprint(path: Path, inside: str = '*') -> dict[str, str]:
    """Return size and a digest of both ends of each file of a recording or calibration, by name.

    Reading all of a recording would take as long as reconstructing some of it. Of a folder the
    files are those that the pattern ``inside`` fits.
    """
    if not path.is_dir():
        return {path.name: _digest(path)}
    files = sorted(one for one in path.glob(inside) if one.is_file())
    return {one.relative_to(path).as_posix(): _digest(one) for one in files}


def joint_fingerprint(files: list[Path]) -> str:
    """Return the number of files and one digest of their names, sizes and both ends of each."""
    joint = hashlib.sha256()
    for path in files:
        joint.update(f'{path.name}: {_digest(path)}\n'.encode(errors='surrogateescape'))
    return f'{counted(len(files), "file")}, {joint.hexdigest()[:16]}'


def _digest(path: Path) -> str:
    try:
        with open_file(path) as file:
            size = file.seek(0, 2)
            file.seek(0)
            content = file.read(_END)
            file.seek(max(0, size - _END))
            content += file.read(_END)
    except OSError as error:
        raise FileError(
            f'{path} cannot be read: {error.strerror}; check its permissions'
        ) from error
    return f'{size} bytes, {hashlib.sha256(content).hexdigest()[:16]}'


def _difference(summary: dict[str, Any], made_from: dict[str, Any]) -> str:
    """Return what an earlier run was made with and this one is not; '' if all is the same."""
    if 'progress' not in summary:
        return f'its {SUMMARY} does not say where it ended'
    if summary['progress'].get('digest') != state_digest(summary):
        return f'its {SUMMARY} was changed'
    before = dict(_flat({name: summary.get(name) for name in MADE_FROM}))
    now = dict(_flat(json.loads(json.dumps(made_from))))
    for name in [*now, *before]:
        if before.get(name) != now.get(name) and name not in _ANYWHERE:
            shown = name.rpartition('.')[2] if name.startswith('options.') else name
            return f'its {shown} is {before.get(name)}, now it is {now.get(name)}'
    return ''


def _flat(values: dict[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield every value of nested dicts, by the names that lead to it."""
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f'{prefix}{name}.')
        else:
            yield f'{prefix}{name}', value


def _missing(folder: Path, frames: list[dict[str, Any]], endings: list[str]) -> str:
    for frame in frames:
        for ending in endings:
            path = folder / f'{frame["index"]:06d}{ending}'
            if not path.exists():
                return f'{path.name} is missing'
    return ''
