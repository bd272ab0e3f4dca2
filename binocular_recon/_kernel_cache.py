# SPDX-License-Identifier: Apache-2.0
"""Keep numba's cache on disk valid: stale or damaged kernels are compiled again."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.caching import IndexDataCacheFile

PACKAGE = Path(__file__).parent


def watch_cache(compiled: Any, function: Callable[..., Any]) -> None:
    """Make the cache of a compiled function depend on every file that may be compiled into it.

    Numba checks the function's own file only, but kernels of other files are inlined into it.
    With JIT disabled nothing is cached.
    """
    file = getattr(getattr(compiled, '_cache', None), '_cache_file', None)
    if file is not None:
        stamp = kernels_stamp(Path(function.__code__.co_filename).parent)
        file._source_stamp = (file._source_stamp, stamp)  # noqa: SLF001
        file.__class__ = _CacheFile


@cache
def kernels_stamp(folder: Path) -> tuple[tuple[float, int], ...]:
    """Return the times and sizes of all files that may be compiled into a kernel in ``folder``.

    These are all kernel files of this package and, for a kernel of another package, the kernel
    files in the same folder.
    """
    files = {*PACKAGE.rglob('_*_kernels.py'), *PACKAGE.glob('_simd/*.py'), PACKAGE / '_jit.py'}
    files |= set(folder.glob('_*_kernels.py'))
    stats = [file.stat() for file in sorted(files)]
    return tuple((stat.st_mtime, stat.st_size) for stat in stats)


class _CacheFile(IndexDataCacheFile):
    """Numba's cache file, except that an entry that cannot be loaded is compiled again.

    A truncated pickle, or one that names a class of an earlier version, may raise any exception.
    """

    def _load_index(self) -> Any:
        try:
            return super()._load_index()  # type: ignore[no-untyped-call]
        except Exception:  # noqa: BLE001
            with suppress(OSError):  # a read-only cache: compiled again each time
                self.flush()  # type: ignore[no-untyped-call]
            return {}

    def _load_data(self, name: str) -> Any:
        try:
            return super()._load_data(name)  # type: ignore[no-untyped-call]
        except Exception as error:
            raise OSError(f'{name} cannot be loaded') from error  # on which numba compiles again
