# SPDX-License-Identifier: Apache-2.0
"""Numba's cache on disk, such that nothing about it stops a program.

Stale, damaged or unreadable entries are compiled again. Where nothing can be written, what was
compiled at the installation is used, and what is missing is compiled at each start.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import pickle
import secrets
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.environment import _rebuild_env
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

PACKAGE = Path(__file__).parent
_DIGEST_BYTES = hashlib.sha256().digest_size
_NAME_DIGITS = 16  # of digests, hexadecimal: 64 bits

_problems: list[str] = []
_kept: list[str] = []


def cache_problem() -> str:
    """Return why what was compiled could not be kept; '' if it could or nothing was compiled."""
    return _problems[0] if _problems else ''


def compiled_count() -> int:
    """Return how many kernels this process has compiled, rather than loaded, and kept."""
    return len(_kept)


def enable_cache(compiled: Any, function: Callable[..., Any]) -> None:
    """Give a compiled function its cache; with JIT disabled nothing is compiled."""
    if hasattr(compiled, 'enable_caching'):
        compiled._cache = _Cache(function)  # noqa: SLF001


@cache
def kernels_stamp(folder: Path) -> str:
    """Return a digest of all files that may be compiled into a kernel in ``folder``.

    These are all kernel files of this package and, for a kernel of another package, the kernel
    files in the same folder: numba inlines kernels of other files. Not their times: copies into
    an image of a container have others.
    """
    files = {*PACKAGE.rglob('_*_kernels.py'), *PACKAGE.glob('_simd/*.py'), PACKAGE / '_jit.py'}
    files |= set(folder.glob('_*_kernels.py'))
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


class _Nowhere:
    """Numba's locator where no folder can be written to: the folder beside the source."""

    def __init__(self, function: Any, file: str) -> None:
        self.line = function.__code__.co_firstlineno
        self.folder = _beside(file)

    @classmethod
    def from_function(cls, function: Any, file: str) -> _Nowhere:
        return cls(function, file)

    def get_cache_path(self) -> str:
        return self.folder

    def get_disambiguator(self) -> str:
        return str(self.line)

    def get_source_stamp(self) -> str:
        return ''  # ours replaces it

    def ensure_cache_path(self) -> None:
        """Let saving say why it fails."""


def _beside(file: str) -> str:
    return str(Path(file).parent / '__pycache__')


class _CacheImpl(CompileResultCacheImpl):
    _locator_classes = [*CompileResultCacheImpl._locator_classes, _Nowhere]  # noqa: RUF012, SLF001


class _Cache(FunctionCache):
    """Numba's cache of a function, except that an entry that does not load is compiled again.

    Loading needs only the runtime that kernels are linked to. Numba first makes ready for
    compilation, half a second of imports; it does so again when it compiles.
    """

    _impl_class = _CacheImpl

    def __init__(self, function: Any) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        file = function.__code__.co_filename
        names = self._impl.filename_base, kernels_stamp(Path(file).parent)
        files = _CacheFile(self._cache_path, *names)
        beside = _beside(file)
        if beside != self._cache_path:
            files.installed = _CacheFile(beside, *names)
        self._cache_file = files  # type: ignore[assignment]

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            rtsys.initialize(target_context)
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception:  # noqa: BLE001 - a class of an earlier version may raise anything
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
            _kept.append(str(sig))
        except OSError as error:
            _problems.append(
                f'compiled kernels cannot be kept in {self._cache_path}: {error.strerror}; every'
                ' start compiles them again until NUMBA_CACHE_DIR names a folder that can be'
                ' written, or binocular-recon warm-up fills the cache at the installation'
            )


class _CacheFile:
    """Files of the compiled forms of a function, one for each key: types of arguments, processor.

    Their names tell all that must be equal for a file to be valid, so there is no index, which
    processes that compile at the same time would have to share. At the end of each file stands a
    digest of it: damaged machine code would end the process.

    Attributes
    ----------
    installed : _CacheFile, optional
        Where to look for what is not here.

    """

    installed: _CacheFile | None = None

    def __init__(self, folder: str, name: str, stamp: str) -> None:
        self.folder, self.name = Path(folder), name
        self.valid = f'numba{numba.__version__}.{stamp[:_NAME_DIGITS]}'

    def load(self, key: Any) -> Any:
        """Return what was compiled for a key; None if it is not here or does not load."""
        try:
            return _undamaged(self.path(key).read_bytes())
        except Exception:  # noqa: BLE001 - a class of an earlier version may raise anything
            return self.installed.load(key) if self.installed else None

    def save(self, key: Any, data: Any) -> None:
        """Keep what was compiled for a key; raises an OSError if it cannot be written."""
        content: bytes = dumps(data)  # type: ignore[no-untyped-call]
        path = self.path(key)
        part = path.with_name(f'{path.name}.{secrets.token_hex(4)}.part')
        try:
            part.write_bytes(content + hashlib.sha256(content).digest())
            part.replace(path)
        except OSError:
            part.unlink(missing_ok=True)
            raise
        self.remove_outdated()

    def path(self, key: Any) -> Path:
        """Return the file of a key."""
        digest = hashlib.sha256(repr(key).encode()).hexdigest()[:_NAME_DIGITS]
        return self.folder / f'{self.name}.{self.valid}.{digest}.nbc'

    def remove_outdated(self) -> None:
        """Remove what was compiled from other sources; other versions of numba keep theirs."""
        module = self.name.partition('.')[0]
        version, _, stamp = self.valid.rpartition('.')
        for path in self.folder.glob(f'{module}.*.{version}.*.nbc'):
            if path.suffixes[-3] != f'.{stamp}':
                with contextlib.suppress(OSError):
                    path.unlink()


def _undamaged(content: bytes) -> Any:
    """Return a value that `_CacheFile` has written; raises a ValueError if it is damaged."""
    content, digest = content[:-_DIGEST_BYTES], content[-_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        raise ValueError('damaged')
    return _Unpickler(io.BytesIO(content)).load()


class _Unpickler(pickle.Unpickler):
    """Pickle, except that globals of a kernel cause no imports."""

    def find_class(self, module: str, name: str) -> Any:
        found = super().find_class(module, name)
        return _environment if found is _rebuild_env else found


def _environment(module: str, *others: Any) -> Any:
    """Return what a kernel finds of its module, or of one of numba's that was compiled into it.

    Only code that calls Python would look there; our kernels do not. Of a module that nobody has
    imported, it stays empty: numba's for arrays would import scipy.linalg.
    """
    return _rebuild_env(module if module in sys.modules else 'numba', *others)  # type: ignore[no-untyped-call]
