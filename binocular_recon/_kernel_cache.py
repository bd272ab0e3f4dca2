# SPDX-License-Identifier: Apache-2.0
"""Numba's cache on disk, kept true: stale or damaged kernels are compiled again."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.caching import IndexDataCacheFile

PACKAGE = Path(__file__).parent


def watch_cache(compiled: Any, function: Callable[..., Any]) -> None:
    """Let the cache of a compiled function notice changes in every file that it may depend on.

    Numba looks at the function's own file only, but kernels of other files are compiled into it.
    Where JIT is disabled nothing is cached.
    """
    file = getattr(getattr(compiled, '_cache', None), '_cache_file', None)
    if file is not None:
        stamp = kernels_stamp(Path(function.__code__.co_filename).parent)
        file._source_stamp = (file._source_stamp, stamp)  # noqa: SLF001
        file.__class__ = _CacheFile


@cache
def kernels_stamp(folder: Path) -> tuple[tuple[float, int], ...]:
    """Return the times and sizes of all files whose kernels may call each other.

    These are all kernel files of this package, in whatever folder, and for a kernel that somebody
    else has written those beside it too.
    """
    files = {*PACKAGE.rglob('_*_kernels.py'), *PACKAGE.glob('_simd/*.py'), PACKAGE / '_jit.py'}
    files |= set(folder.glob('_*_kernels.py'))
    stats = [file.stat() for file in sorted(files)]
    return tuple((stat.st_mtime, stat.st_size) for stat in stats)


class _CacheFile(IndexDataCacheFile):
    """Numba's, but what cannot be loaded is dropped and compiled again.

    A pickle that was cut off, or that names a class of an earlier version, raises whatever it
    likes: all of it means that the file is of no use.
    """

    def _load_index(self) -> Any:
        try:
            return super()._load_index()  # type: ignore[no-untyped-call]
        except Exception:  # noqa: BLE001
            with suppress(OSError):  # read-only: compiled again each time
                self.flush()  # type: ignore[no-untyped-call]
            return {}

    def _load_data(self, name: str) -> Any:
        try:
            return super()._load_data(name)  # type: ignore[no-untyped-call]
        except Exception as error:
            raise OSError(f'{name} cannot be loaded') from error  # Numba compiles again
