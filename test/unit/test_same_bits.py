# SPDX-License-Identifier: Apache-2.0
"""The chain gives the same bits, whatever was loaded or compiled and however many threads."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.caching import _CacheLocator

from binocular_recon._kernel_cache import PACKAGE
from test.unit.test_jit import run_copy

CHAIN = """
import hashlib, sys
import numpy as np
import binocular_recon.io.messages.transforms
from binocular_recon import Chain, ChainConfig
from binocular_recon._jit import limit_threads
from binocular_recon._kernel_cache import compiled_count
from binocular_recon.camera import Camera, StereoRig
limit_threads({threads})
K = np.array([[200.0, 0, 80], [0, 200, 60], [0, 0, 1]])
left_P, right_P = (np.c_[K, [shift, 0, 0]] for shift in (0, -50))
D = np.array([-0.05, 0.01, 0, 0, 0])
rig = StereoRig(*(Camera(160, 120, K, D, np.eye(3), P) for P in (left_P, right_P)))
wide = np.random.default_rng(0).uniform(60, 200, (120, 240))
wide = sum(np.roll(wide, (i, j), (0, 1)) for i in range(3) for j in range(3)) / 9
wide[40:70, 100:130] = 128  # nothing to match
pair = [np.ascontiguousarray(wide[:, x : x + 160]).astype(np.uint8) for x in (40, 50)]
result = Chain(rig, ChainConfig.preset('default', disparity_range=32))(*pair)
one = result.filtered
arrays = result.cloud.points_xyz, result.cloud.sigma_z_m, one.disparity_px, one.validity
assert np.isfinite(arrays[2]).mean() > 0.9
digest = hashlib.sha256(b''.join(array.tobytes() for array in arrays)).hexdigest()
print(digest, compiled_count(), 'scipy.linalg' in sys.modules or 'scipy.spatial' in sys.modules)
"""
# In which sums are, whose order the compiler chooses.
SUMMING = ['_filter_kernels', '_gradient_kernels', '_lattice_kernels']


@pytest.mark.long
def test_the_chain_gives_the_same_bits_whatever_is_loaded_and_however_many_threads(
    tmp_path: Path,
) -> None:
    """In a copy of the package, with its cache and then without a part of it."""
    here = subprocess.run([sys.executable, '-c', CHAIN.format(threads=0)], check=False)
    assert here.returncode == 0  # what was not compiled yet is kept for all tests
    package = tmp_path / 'binocular_recon'
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns('*.pyc'))
    for file in PACKAGE.rglob('_*_kernels.py'):
        kept = _CacheLocator.get_suitable_cache_subpath(str(file))  # type: ignore[no-untyped-call]
        kept = Path(os.environ.get('NUMBA_CACHE_DIR', ''), kept)
        beside = package / file.relative_to(PACKAGE).parent / '__pycache__'
        for compiled_file in kept.glob('*.nbc'):
            beside.mkdir(exist_ok=True)
            shutil.copy(compiled_file, beside)
    once = run_copy(tmp_path, CHAIN.format(threads=1))
    loaded = run_copy(tmp_path, CHAIN.format(threads=2))
    for file in package.rglob('*.nbc'):
        if file.name.startswith(tuple(SUMMING)):
            file.unlink()
    compiled = run_copy(tmp_path, CHAIN.format(threads=2))
    assert once[0] == loaded[0] == compiled[0]
    assert once[1:] == loaded[1:] == ['0', 'False'], 'loading kernels imports nothing slow'
    assert int(compiled[1]) > 5
