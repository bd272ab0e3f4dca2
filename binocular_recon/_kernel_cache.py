# SPDX-License-Identifier: Apache-2.0
"""Numba's cache on disk, such that nothing about it stops a program.

Stale, damaged or unreadable entries are compiled again. Where nothing can be written, what was
compiled at the installation is used, and what is missing is compiled at each start.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

PACKAGE = Path(__file__).parent
_DIGEST_BYTES = hashlib.sha256().digest_size

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
    """Numba's cache of a function, except that an entry that does not load is compiled again."""

    _impl_class = _CacheImpl

    def __init__(self, function: Any) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        file = function.__code__.co_filename
        names = self._impl.filename_base, kernels_stamp(Path(file).parent)
        self._cache_file = _CacheFile(self._cache_path, *names)  # type: ignore[no-untyped-call]
        beside = _beside(file)
        if beside != self._cache_path:
            self._cache_file.installed = _CacheFile(beside, *names)  # type: ignore[no-untyped-call]

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
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


class _CacheFile(IndexDataCacheFile):
    """Numba's cache files, with a digest at the end: damaged machine code would end the process.

    Attributes
    ----------
    installed : _CacheFile, optional
        Where to look for what is not here.

    """

    installed: _CacheFile | None = None

    def load(self, key: Any) -> Any:
        found = super().load(key)  # type: ignore[no-untyped-call]
        return self.installed.load(key) if found is None and self.installed else found

    def _dump(self, value: Any) -> bytes:
        content: bytes = super()._dump(value)  # type: ignore[no-untyped-call]
        return content + hashlib.sha256(content).digest()

    def _load_index(self) -> Any:
        version = pickle.dumps(self._version, protocol=-1)
        try:
            content = Path(self._index_path).read_bytes()
        except OSError:
            return {}
        if not content.startswith(version):
            return {}
        try:
            stamp, names = _undamaged(content[len(version) :])
        except Exception:  # noqa: BLE001 - as above
            return {}
        return names if stamp == self._source_stamp else {}

    def _load_data(self, name: str) -> Any:
        try:
            return _undamaged(Path(self._data_path(name)).read_bytes())  # type: ignore[no-untyped-call]
        except Exception as error:
            raise OSError(f'{name} cannot be loaded') from error  # on which numba compiles again


def _undamaged(content: bytes) -> Any:
    """Return a value that `_CacheFile` has written; raises a ValueError if it is damaged."""
    content, digest = content[:-_DIGEST_BYTES], content[-_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        raise ValueError('damaged')
    return pickle.loads(content)  # noqa: S301 - numba's own format
