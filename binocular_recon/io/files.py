# SPDX-License-Identifier: Apache-2.0
"""Files that are either complete or absent."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from binocular_recon.errors import FileError

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def make_folder(path: Path) -> None:
    """Make folder ``path`` with its parents, or raise a FileError that says what is in the way."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(
            f'folder {path} cannot be made: {_reason(error)}; choose another folder'
        ) from error


@contextlib.contextmanager
def complete_file(path: Path) -> Iterator[BinaryIO]:
    """Open a binary file that takes its name when it is complete.

    An interruption or a full disk leaves neither a part of the new file nor harms an old one of
    this name.

    Parameters
    ----------
    path : Path
        The file's name; its folder must exist.

    Yields
    ------
    file : BinaryIO
        Open for writing.

    Raises
    ------
    FileError
        If the file cannot be written.

    """
    part = path.with_name(f'.{path.name}.{os.getpid()}.part')
    try:
        if path.exists() and not path.is_file():  # a device or a pipe is not replaced by a file
            with path.open('wb') as file:
                yield file
            return
        with part.open('wb') as file:
            yield file
        part.replace(path)
    except OSError as error:
        raise FileError(f'{path} cannot be written: {_reason(error)}; {_remedy(error)}') from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


@contextlib.contextmanager
def complete_files(folder: Path) -> Iterator[Path]:
    """Give a folder whose files move to ``folder`` together, once all of them are complete.

    An interruption or a full disk leaves none of the new files and harms no old one.

    Parameters
    ----------
    folder : Path
        Where the files shall be; it must exist.

    Yields
    ------
    parts : Path
        Hidden folder to write them to, in `folder`.

    Raises
    ------
    FileError
        If a folder or file cannot be written.

    """
    parts = folder / f'.{os.getpid()}.part'
    make_folder(parts)
    try:
        yield parts
        for part in sorted(parts.iterdir()):
            part.replace(folder / part.name)
    except FileError:
        raise
    except OSError as error:
        raise FileError(
            f'{folder} cannot be filled: {_reason(error)}; {_remedy(error)}'
        ) from error
    finally:
        shutil.rmtree(parts, ignore_errors=True)


def flush(path: Path) -> None:
    """Make sure that a file, or the names in a folder, survive a power cut."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_json(path: Path, value: object) -> None:
    """Write ``value`` as indented JSON; raises a FileError if the file cannot be written."""
    with complete_file(path) as file:
        file.write(json.dumps(value, indent=2, allow_nan=False).encode() + b'\n')


def _reason(error: OSError) -> str:
    return error.strerror or str(error)


def _remedy(error: OSError) -> str:
    if error.errno in _FULL:
        return 'free some space or write to another disk'
    return 'choose a folder that exists and can be written'
