# SPDX-License-Identifier: Apache-2.0
"""The scene of the tests of the evaluation."""

from __future__ import annotations

from pathlib import Path

import pytest

from binocular_recon.evaluation.speed.synthetic import SyntheticPair, synthetic_pair
from test.unit.evaluation.scene_folder import HEIGHT, METRIC, RANGE, WIDTH, write_scene


@pytest.fixture(scope='module')
def pair() -> SyntheticPair:
    return synthetic_pair(WIDTH, HEIGHT, RANGE, seed=5)


@pytest.fixture
def scenes(tmp_path: Path, pair: SyntheticPair) -> Path:
    """Make a folder with one scene, ``park``."""
    write_scene(tmp_path / 'scenes' / 'park', pair, METRIC)
    return tmp_path / 'scenes'
