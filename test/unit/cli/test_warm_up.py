# SPDX-License-Identifier: Apache-2.0
"""``warm-up``: after it, nothing is left to compile."""

from __future__ import annotations

import pytest

from binocular_recon import _kernel_cache
from binocular_recon.apps import kernels
from binocular_recon.cli.main import main
from binocular_recon.config import ChainConfig


def test_warm_up_compiles_for_the_presets_that_are_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made: list[ChainConfig] = []
    monkeypatch.setattr(kernels, 'warm_up', made.append)
    monkeypatch.setattr(_kernel_cache, '_problems', [])
    assert main(['warm-up', '--presets', 'fast']) == 0
    assert all(config.match.coarse_to_fine for config in made)
    assert {config.filter.wls_guide for config in made} == {'left', 'disparity'}
    said = capsys.readouterr()
    assert said.err == 'fast: ready\ncalibration: ready\n'
    assert said.out.startswith('kernels ready after ')


def test_warm_up_that_cannot_keep_anything_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(kernels, 'warm_up', lambda _: None)
    monkeypatch.setattr(_kernel_cache, '_problems', ['kernels cannot be kept in /x: read-only'])
    assert main(['warm-up', '--presets', 'fast']) == 1
    assert 'warm-up: kernels cannot be kept in /x: read-only' in capsys.readouterr().err
