# SPDX-License-Identifier: Apache-2.0
"""Write files that are either complete or absent.

What is not complete yet is a part: a hidden file or folder, locked by the process that writes it.
A part that nobody locks was left by one that was killed.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import re
import secrets
import shutil
import signal
import threading
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from binocular_recon.errors import ConfigError, FileError

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_PART = re.compile(r'\.(.+\.)?[0-9a-f]{8}\.part')
_NOW = fcntl.LOCK_EX | fcntl.LOCK_NB
# Locked by the process that writes to a folder; not the folder itself, which `locked` locks for
# moments.
_CLAIM = '.claim'


def make_folder(path: Path) -> None:
    """Make a folder with its parents; raises a FileError if it cannot be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(
            f'folder {path} cannot be made: {_reason(error)}; choose another folder'
        ) from error


def check_apart(output: Path, folder: Path) -> None:
    """Raise a ConfigError if the results of a folder would be written into it."""
    if output.resolve() == folder.resolve():
        raise ConfigError(f'{output} holds what the result is made of; choose another folder')


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
        If the folder cannot be made or written to, or another process writes to it.

    """

    def __init__(self, path: Path) -> None:
        make_folder(path)
        try:
            claim, handle = _held(lambda: path / _CLAIM, os.O_RDWR | os.O_CREAT)
        except BlockingIOError:
            raise FileError(
                f'another process writes to {path}; wait until it is done or choose another folder'
            ) from None
        except OSError as error:
            raise _failure(path, error) from error
        self.release = weakref.finalize(self, _let_go, claim, handle)
        remove_abandoned(path)


def _held(path: Callable[[], Path], flags: int, *, is_part: bool = False) -> tuple[Path, int]:
    """Open and lock a file or folder; return its path and the handle that holds the lock.

    Raises a BlockingIOError if another one holds it; another part is made if one was taken for
    abandoned before it was locked. Where the file system has no locks, nothing is locked.
    """
    while True:
        place = path()
        try:
            handle = os.open(place, flags | os.O_NOFOLLOW, 0o666)
        except FileNotFoundError:
            if flags & os.O_CREAT:
                raise
            continue  # the part was removed before it was opened
        try:
            fcntl.flock(handle, _NOW)
            if os.path.samestat(os.fstat(handle), place.stat()):
                return place, handle
        except FileNotFoundError:  # the one before, or who took it for abandoned, removed it
            pass
        except BlockingIOError:
            if not is_part:
                os.close(handle)
                raise
        except OSError:  # a network file system without locks
            return place, handle
        os.close(handle)


def _let_go(path: Path, handle: int) -> None:
    """Remove what `_held` returned, if that is possible, and unlock it."""
    with contextlib.ExitStack() as end:
        end.callback(os.close, handle)
        _remove(path)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)


def remove_abandoned(folder: Path) -> None:
    """Remove the parts that nobody writes any more."""
    for part in folder.iterdir():
        if _PART.fullmatch(part.name):
            with contextlib.suppress(OSError), contextlib.ExitStack() as end:
                handle = os.open(part, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
                end.callback(os.close, handle)
                fcntl.flock(handle, _NOW)
                _remove(part)


def _new_part(folder: Path, name: str = '') -> Path:
    return folder / f'.{name}{"." if name else ""}{secrets.token_hex(4)}.part'


@contextlib.contextmanager
def part_folder(folder: Path) -> Iterator[Path]:
    """Make a folder in a folder to write files to; what is left in it at the end is removed."""

    def make() -> Path:
        part = _new_part(folder)
        part.mkdir()
        return part

    part, handle = _held(make, os.O_RDONLY, is_part=True)
    try:
        yield part
    finally:
        _let_go(part, handle)


@contextlib.contextmanager
def complete_file(path: Path) -> Iterator[BinaryIO]:
    """Open a binary file that appears under its name when it is complete.

    After an interruption or on a full disk, no part of the new file remains, and an old file of
    this name is unchanged. After a power cut the file is complete or the old one. Its folder must
    exist. Raises a FileError if the file cannot be written.
    """
    try:
        if path.exists() and not path.is_file():  # a device or a pipe is not replaced by a file
            with path.open('wb') as file:
                yield file
            return
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL
        part, handle = _held(lambda: _new_part(path.parent, path.name), flags, is_part=True)
        try:
            with open(handle, 'wb', closefd=False) as file:
                yield file
            os.fsync(handle)
            part.replace(path)
        finally:
            _let_go(part, handle)
    except FileError:
        raise
    except OSError as error:
        raise FileError(f'{path} cannot be written: {_reason(error)}; {_remedy(error)}') from error


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
    with naming_errors(folder), part_folder(folder) as parts:
        yield parts
        move_files(parts, folder, completed)


def move_files(
    parts: Path,
    folder: Path,
    completed: Callable[[], object] = lambda: None,
    name: Callable[[str], str] = lambda name: name,
) -> None:
    """Move complete files to ``folder``, under the names that ``name`` returns of theirs.

    As `complete_files` does at its end.
    """
    complete = sorted(parts.iterdir())
    for part in complete:
        flush(part)
    with signals_deferred():
        for part in complete:
            part.replace(folder / name(part.name))
        flush(folder)
        completed()


@contextlib.contextmanager
def signals_deferred() -> Iterator[None]:
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
def naming_errors(folder: Path) -> Iterator[None]:
    """Let errors of the system come out as a FileError that names ``folder`` and the remedy."""
    try:
        yield
    except FileError:
        raise
    except OSError as error:
        raise _failure(folder, error) from error


def flush(path: Path) -> None:
    """Flush a file, or the entries of a folder, to the disk, so that they survive a power cut."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8, what is none written out; raises as `complete_file`."""
    with complete_file(path) as file:
        file.write(text.encode(errors='backslashreplace'))


def write_json(path: Path, value: object) -> None:
    """Write ``value`` as indented JSON; raises a FileError if the file cannot be written."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + '\n')


def _failure(folder: Path, error: OSError) -> FileError:
    return FileError(f'{folder} cannot be written to: {_reason(error)}; {_remedy(error)}')


def _reason(error: OSError) -> str:
    return error.strerror or str(error)


def _remedy(error: OSError) -> str:
    if error.errno in _FULL:
        return 'free some space or write to another disk'
    return 'choose a folder that exists and can be written'
