# SPDX-License-Identifier: Apache-2.0
"""Kernels: what is compiled is up to date, and gives the bits of what was loaded."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType

import numba
import numpy as np
import pytest

from binocular_recon import _jit, _kernel_cache

NO_CACHES = shutil.ignore_patterns('__pycache__')
INNER = """
from binocular_recon._jit import kernel
@kernel
def inner(): return {}
"""
TWICE = """
from binocular_recon._jit import kernel
@kernel
def twice(value): return value + value
"""
OUTER = """
from binocular_recon._jit import kernel
from _inner_kernels import inner
@kernel
def outer(): return inner()
"""


def load(path: Path) -> ModuleType:
    """Import a file anew."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def test_a_kernel_is_compiled_again_if_one_that_it_calls_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inner, outer = tmp_path / '_inner_kernels.py', tmp_path / '_outer_kernels.py'
    outer.write_text(OUTER)
    for name in (inner.stem, outer.stem):
        monkeypatch.delitem(sys.modules, name, raising=False)
    found, hits = [], []
    for value in (1, 22, 22):
        inner.write_text(INNER.format(value))
        os.utime(inner, (value, value))
        _kernel_cache.kernels_stamp.cache_clear()
        load(inner)
        kernel = load(outer).outer
        found.append(kernel())
        hits.append(sum(kernel.stats.cache_hits.values()))
    assert found == [1, 22, 22]
    assert hits == [0, 0, 1]


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def fill(path: Path, byte: bytes) -> None:
    """Blocks of a file that never reached the disk are 0; the size is right."""
    content = path.read_bytes()
    middle = len(content) // 2
    path.write_bytes(content[:middle] + byte * 64 + content[middle + 64 :])


def replace_by_a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def with_digest(content: bytes) -> bytes:
    """Return what a process wrote that knew another content."""
    return content + hashlib.sha256(content).digest()


DAMAGES: dict[str, Callable[[Path], object]] = {
    'cut': cut,
    'empty': lambda path: path.write_bytes(b''),
    'garbage': lambda path: path.write_bytes(np.random.default_rng(0).bytes(4000)),
    'a block of zeros': lambda path: fill(path, b'\0'),
    'a block of ones': lambda path: fill(path, b'\xff'),
    'of another version': lambda path: path.write_bytes(with_digest(pickle.dumps('0.1'))),
    'of an unknown class': lambda path: path.write_bytes(with_digest(b'cmissing\nmissing\n.')),
    'gone': lambda path: path.unlink(),
    'a folder': replace_by_a_folder,
}


@pytest.mark.parametrize('damage', DAMAGES)
def test_a_damaged_cache_is_compiled_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str
) -> None:
    inner = tmp_path / '_inner_kernels.py'
    inner.write_text(INNER.format(5))
    monkeypatch.delitem(sys.modules, inner.stem, raising=False)
    monkeypatch.setattr('numba.core.config.CACHE_DIR', str(tmp_path / 'cache'))
    monkeypatch.setattr(_kernel_cache, '_problems', [])
    assert load(inner).inner() == 5
    (file,) = tmp_path.rglob('*.nbc')
    DAMAGES[damage](file)
    again = load(inner).inner
    assert again() == 5
    assert not again.stats.cache_hits
    once_more = load(inner).inner
    assert once_more() == 5
    if damage == 'a folder':  # nothing can be written in its place
        assert 'Is a directory; every start compiles them again' in _kernel_cache.cache_problem()
    else:
        assert once_more.stats.cache_hits
        assert not _kernel_cache.cache_problem()


def test_processes_that_compile_at_once_do_not_replace_what_the_other_keeps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two forms of a kernel, kept by processes that began with an empty cache."""
    path = tmp_path / '_twice_kernels.py'
    path.write_text(TWICE)
    monkeypatch.delitem(sys.modules, path.stem, raising=False)
    monkeypatch.setattr('numba.core.config.CACHE_DIR', str(tmp_path / 'cache'))
    one, other = load(path).twice, load(path).twice
    keep = _kernel_cache._CacheFile.save
    late: list[Callable[[], None]] = []
    # The second process compiles and keeps its form before the first one has kept its own.
    monkeypatch.setattr(
        _kernel_cache._CacheFile, 'save', lambda *args: late.append(partial(keep, *args))
    )
    assert one(21) == 42
    monkeypatch.setattr(_kernel_cache._CacheFile, 'save', keep)
    assert other(1.5) == 3
    late[0]()
    third = load(path).twice
    assert [third(21), third(1.5)] == [42, 3]
    assert isinstance(third(21), int)
    assert sum(third.stats.cache_hits.values()) == 2


def test_what_was_compiled_from_other_sources_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inner = tmp_path / '_inner_kernels.py'
    monkeypatch.delitem(sys.modules, inner.stem, raising=False)
    monkeypatch.setattr('numba.core.config.CACHE_DIR', str(tmp_path / 'cache'))
    kept = []
    for number, version in enumerate(['0.60.0', numba.__version__, numba.__version__]):
        inner.write_text(INNER.format(number))
        os.utime(inner, (number, number))  # or Python takes the last one that it compiled
        _kernel_cache.kernels_stamp.cache_clear()
        monkeypatch.setattr('numba.__version__', version)
        assert load(inner).inner() == number
        kept.append(sorted(path.name.split('.numba')[1] for path in tmp_path.rglob('*.nbc')))
    assert [len(names) for names in kept] == [1, 2, 2]
    assert kept[0][0] in kept[2], 'another version of numba keeps what it has compiled'
    assert kept[1] != kept[2]


PROBE = """
from binocular_recon._kernel_cache import cache_problem
from binocular_recon.stereo.holes._probe_kernels import inner
print(inner(), sum(inner.stats.cache_hits.values()))
print(cache_problem())
"""
# Without capabilities, root may not write to its own files either where their mode forbids it.
HARDENED = """
import ctypes
header = (ctypes.c_uint32 * 2)(0x20080522, 0)
assert ctypes.CDLL(None).capset(header, (ctypes.c_uint32 * 6)()) == 0
"""


@pytest.mark.skipif(sys.platform != 'linux', reason='needs capabilities')
@pytest.mark.long
def test_a_package_that_cannot_be_written_to_is_used_with_and_without_a_cache(
    tmp_path: Path,
) -> None:
    """As by a service with a read-only system and no home."""
    package = tmp_path / 'binocular_recon'
    shutil.copytree(_jit.__file__.rpartition('/')[0], package, ignore=NO_CACHES)
    (package / 'stereo' / 'holes' / '_probe_kernels.py').write_text(INNER.format(7))
    unset = {'NUMBA_CACHE_DIR', 'XDG_CACHE_HOME', 'PYTHONPATH'}
    variables = {name: text for name, text in os.environ.items() if name not in unset}

    def printed(script: str, *, writable: bool) -> list[str]:
        for path in (tmp_path, *tmp_path.rglob('*')):
            path.chmod((0o755 if path.is_dir() else 0o644) - (0 if writable else 0o200))
        done = subprocess.run(
            [sys.executable, '-c', script],
            cwd=tmp_path,
            env={**variables, 'HOME': str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout.splitlines()

    found, problem = printed(HARDENED + PROBE, writable=False)
    assert found == '7 0'
    assert 'cannot be kept in' in problem and 'warm-up fills the cache' in problem
    assert printed(PROBE, writable=True) == ['7 0', '']
    for file in package.rglob('*.py'):  # times change on the way into an image of a container
        os.utime(file, (1, 1))
    assert printed(HARDENED + PROBE, writable=False) == ['7 1', '']
    for path in (tmp_path, *tmp_path.rglob('*')):  # to be removed
        path.chmod(0o755)


CROSSING = """
from binocular_recon._jit import kernel
from binocular_recon.stereo.holes._probe_kernels import inner
@kernel
def outer(): return inner()
"""
RUN = """
from binocular_recon.calibration._crossing_kernels import outer
print(outer(), sum(outer.stats.cache_hits.values()))
"""


def copy_package(folder: Path) -> Path:
    """Copy the package without caches into a folder."""
    package = folder / 'binocular_recon'
    shutil.copytree(_jit.__file__.rpartition('/')[0], package, ignore=NO_CACHES)
    return package


def run_copy(folder: Path, code: str) -> list[str]:
    """Run code by a new process with the copied package and its cache; return what it prints."""
    done = subprocess.run(
        [sys.executable, '-c', code],
        cwd=folder,
        env={**os.environ, 'NUMBA_CACHE_DIR': str(folder / 'cache')},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


@pytest.mark.long
def test_a_kernel_is_compiled_again_if_one_of_another_folder_changes(tmp_path: Path) -> None:
    """In a copy of the package, by new processes that share one cache."""
    package = copy_package(tmp_path)
    (package / 'calibration' / '_crossing_kernels.py').write_text(CROSSING)
    inner = package / 'stereo' / 'holes' / '_probe_kernels.py'
    printed = []
    for value in (1, 22, 22):
        inner.write_text(INNER.format(value))
        os.utime(inner, (value, value))
        printed.append(run_copy(tmp_path, RUN))
    assert printed == [['1', '0'], ['22', '0'], ['22', '1']]


LINKS = """
import hashlib
import numpy as np
from binocular_recon.stereo.filtering._filter_kernels import gradients_to_links as links
rng = np.random.default_rng(0)
data, east, south = (rng.random((33, width), np.float32) for width in (200, 199, 200))
links(60 * data, east, south[:32], (10.0, 1.0, 1e-4, 0.0), 0, 32)
digest = hashlib.sha256(east.tobytes() + south.tobytes()).hexdigest()
print(digest, sum(links.stats.cache_hits.values()))
"""


@pytest.mark.long
def test_compiled_and_loaded_kernels_give_the_same_bits(tmp_path: Path) -> None:
    """Of a kernel that calls another with sums whose order the compiler may choose."""
    copy_package(tmp_path)
    compiled, loaded = run_copy(tmp_path, LINKS), run_copy(tmp_path, LINKS)
    assert [compiled[1], loaded[1]] == ['0', '1']
    assert compiled[0] == loaded[0]
