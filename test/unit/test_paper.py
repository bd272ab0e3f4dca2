# SPDX-License-Identifier: Apache-2.0
"""The paper end to end: rods, calibration, scene, cloud, sizes, and the tables."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from binocular_recon.cli import paper as command
from binocular_recon.cli.main import main
from binocular_recon.evaluation.paper import detected_captures
from binocular_recon.io.image_files import read_image_file
from binocular_recon.simulation.capture import CaptureOptions, simulate_capture
from binocular_recon.simulation.rig import survey_rig
from binocular_recon.simulation.rods import paper_board


@pytest.fixture(scope='module')
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """One site in pictures of half the size: twice the millimetres per pixel."""
    folder = tmp_path_factory.mktemp('paper')
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, 'survey_rig', lambda pitch_rad: survey_rig(0.5, pitch_rad))
        options = ['--seeds', '1', '--boards', '8', '--rendered', '0', '--first-seed', '4']
        assert main(['paper', '--output', str(folder), *options]) == 0
    return folder, json.loads((folder / 'paper.json').read_text())


def test_sizes_are_measured_to_what_picking_allows(
    finished: tuple[Path, dict[str, Any]],
) -> None:
    """0.3 px are 5.5 mm at 15 m here; an exact cloud adds to it what the calibration errs."""
    runs = finished[1]['runs']
    assert [run['placement_m'] for run in runs] == [0.0, 0.005]
    for run in runs:
        for name in ('person_1', 'person_2', 'bicycle'):
            errors = np.array(run['errors_mm'][name])
            picking = np.array(run['floor_mm'][name])
            assert 1.0 < np.abs(picking).mean() < 15.0
            assert np.abs(errors).mean() < 25.0
            if name != 'bicycle':
                # the same picks: what is left is the cloud's and the calibration's
                assert np.abs(errors - picking).mean() < 10.0
                assert np.abs(run['on_ground_mm'][name]).mean() < 15.0
                assert -300.0 < run['automatic_mm'][name][0] < 10.0


def test_rows_agree_after_correction(finished: tuple[Path, dict[str, Any]]) -> None:
    exact, placed = finished[1]['runs']
    for run in (exact, placed):
        assert run['rows_px']['uncorrected'] > 1.0
        assert run['rows_px']['adjusted'] < 0.3
        rows = np.array(run['rows'])
        assert rows.shape == (6, 6)
        assert (np.diff(rows, axis=0) > 0).all()
    # 0.2 px of noise on each mark
    assert exact['rows_px']['corrected'] < 0.35
    stages = {
        key: np.mean([board[key] for board in placed['boards_px']])
        for key in placed['boards_px'][0]
    }
    assert stages['adjusted_px'] < 0.22 < 0.35 < stages['uncorrected_px']


def test_tables_stand_beside_the_papers(finished: tuple[Path, dict[str, Any]]) -> None:
    folder, content = finished
    text = (folder / 'tables.md').read_text()
    for figure in ('488', '389', '740', '646', '1.804', '1.276', '1.1', '4.0', '6.7'):
        assert figure in text
    mean = np.mean(np.abs(content['runs'][0]['errors_mm']['bicycle']))
    row = next(line for line in text.splitlines() if line.startswith('| bicycle'))
    assert f' {mean:.1f} |' in row
    for name in ('sizes.jpg', 'crop.jpg'):
        picture = read_image_file(folder / name)
        assert picture.shape[1] == 900 and picture.std() > 20


def test_detected_rods_are_where_they_were_rendered() -> None:
    rig, board = survey_rig(), paper_board(0.0)
    capture = detected_captures(rig, board, 1, 3)[0]
    rendered = simulate_capture(board, rig, np.random.default_rng([3, 0]), CaptureOptions())
    for found, true in (
        (capture.left_px, rendered.left_px),
        (capture.right_px, rendered.right_px),
    ):
        error = found - true
        assert np.isfinite(error).mean() > 0.9
        assert np.nanmean(error**2) < 0.12**2


def test_unwritable_folder_is_said_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'taken').write_text('a file')
    assert main(['paper', '--output', str(tmp_path / 'taken')]) == 1
    assert 'taken cannot be made' in capsys.readouterr().err
    with pytest.raises(SystemExit, match='2'):
        main(['paper', '--seeds', '0'])
