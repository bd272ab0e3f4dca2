# SPDX-License-Identifier: Apache-2.0
"""Write files that are either complete or absent."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import re
import shutil
import signal
import threading
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from binocular_recon.errors import FileError

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
# What a process that was killed leaves of files that were not complete.
_PART = re.compile(r'\.(.+\.)?\d+\.part')


def make_folder(path: Path) -> None:
    """Make a folder with its parents; raises a FileError if it cannot be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(
            f'folder {path} cannot be made: {_reason(error)}; choose another folder'
        ) from error


class ClaimedFolder:
    """A folder that one process writes to; what killed ones left half written is removed.

    The claim ends with the process however that ends, by `release`, or with this object.

    Parameters
    ----------
    path : Path
        Made with its parents if it does not exist.

    Raises
    ------
    FileError
        If the folder cannot be made, or another process writes to it.

    """

    def __init__(self, path: Path) -> None:
        make_folder(path)
        handle = os.open(path, os.O_RDONLY)
        self.release = weakref.finalize(self, os.close, handle)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FileError(
                f'another process writes to {path}; wait until it is done or choose another folder'
            ) from None
        except OSError:  # a network file system without locks
            return
        for part in path.iterdir():
            if _PART.fullmatch(part.name):
                _remove(part)


def _remove(part: Path) -> None:
    """Remove a file or a folder, if that is possible."""
    if part.is_dir():
        shutil.rmtree(part, ignore_errors=True)
    with contextlib.suppress(OSError):
        part.unlink(missing_ok=True)


@contextlib.contextmanager
def complete_file(path: Path) -> Iterator[BinaryIO]:
    """Open a binary file that appears under its name when it is complete.

    After an interruption or on a full disk, no part of the new file remains, and an old file of
    this name is unchanged. After a power cut the file is complete or the old one.

    Parameters
    ----------
    path : Path
        Path of the file; its folder must exist.

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
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        raise FileError(f'{path} cannot be written: {_reason(error)}; {_remedy(error)}') from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


@contextlib.contextmanager
def complete_files(folder: Path, completed: Callable[[], object] = lambda: None) -> Iterator[Path]:
    """Open a temporary folder whose files move to ``folder`` once all of them are complete.

    After an interruption or on a full disk, none of the new files remains, and old files are
    unchanged. After a power cut each file is complete, and before ``completed`` all are on disk.

    Parameters
    ----------
    folder : Path
        Final folder of the files; it must exist.
    completed : callable
        Called when all files are in place, before SIGINT or SIGTERM can be noticed.

    Yields
    ------
    parts : Path
        Hidden folder in ``folder`` to write the files to.

    Raises
    ------
    FileError
        If a folder or file cannot be written.

    """
    parts = folder / f'.{os.getpid()}.part'
    _remove(parts)  # in a container every process may have the number of one that was killed
    make_folder(parts)
    try:
        yield parts
        complete = sorted(parts.iterdir())
        for part in complete:
            flush(part)
        with _signals_deferred():
            for part in complete:
                part.replace(folder / part.name)
            flush(folder)
            completed()
    except FileError:
        raise
    except OSError as error:
        raise FileError(
            f'{folder} cannot be written to: {_reason(error)}; {_remedy(error)}'
        ) from error
    finally:
        shutil.rmtree(parts, ignore_errors=True)


@contextlib.contextmanager
def _signals_deferred() -> Iterator[None]:
    """Let SIGINT and SIGTERM wait until the end of the block.

    Python delivers them to the main thread only.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    noticed: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: noticed.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if noticed:
        signal.raise_signal(noticed[0])


@contextlib.contextmanager
def locked(folder: Path, *, shared: bool = False) -> Iterator[None]:
    """Wait for the lock of a folder and hold it; nothing where its file system has no locks.

    Other processes and threads that lock the folder wait meanwhile, those that share it only for
    one that does not. The lock of a process that dies is free.
    """
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:  # it is not a folder, or one that cannot be opened
        yield
        return
    try:
        with contextlib.suppress(OSError):  # a network file system without locks
            fcntl.flock(handle, fcntl.LOCK_SH if shared else fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def flush(path: Path) -> None:
    """Flush a file, or the entries of a folder, to the disk, so that they survive a power cut."""
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
