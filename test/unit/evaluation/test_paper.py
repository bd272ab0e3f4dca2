# SPDX-License-Identifier: Apache-2.0
"""The paper end to end: rods, calibration, scene, cloud, sizes, and the tables."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from binocular_recon.cli.main import main
from binocular_recon.cli.quality import paper as command
from binocular_recon.errors import CalibrationError
from binocular_recon.evaluation.paper import runs as paper
from binocular_recon.evaluation.paper.runs import FailedRun, PaperRun, detected_captures
from binocular_recon.evaluation.paper.tables import report, table_1
from binocular_recon.io.image_files import read_image_file
from binocular_recon.simulation.capture import CaptureOptions, simulate_capture
from binocular_recon.simulation.rig import survey_rig
from binocular_recon.simulation.rods import paper_board

pytestmark = pytest.mark.long


@pytest.fixture(scope='module')
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """One site in images of half the size: twice the millimetres per pixel."""
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
        assert run['rows_px']['adjusted'] < 0.2
        rows = np.array(run['rows'])
        assert rows.shape == (6, 6)
        assert (np.diff(rows, axis=0) > 0).all()
    # 0.12 px of noise on each mark
    assert exact['rows_px']['corrected'] < 0.3
    stages = {
        key: np.mean([board[key] for board in placed['boards_px']])
        for key in placed['boards_px'][0]
    }
    assert stages['adjusted_px'] < 1.15 * 0.12 < 0.3 < stages['uncorrected_px']


def test_tables_stand_beside_the_papers(finished: tuple[Path, dict[str, Any]]) -> None:
    folder, content = finished
    text = (folder / 'tables.md').read_text()
    for figure in ('488', '389', '740', '646', '1.804', '1.276', '1.1', '4.0', '6.7'):
        assert figure in text
    mean = np.mean(np.abs(content['runs'][0]['errors_mm']['bicycle']))
    row = next(line for line in text.splitlines() if line.startswith('| bicycle'))
    assert f' {mean:.1f} |' in row
    for name in ('sizes.jpg', 'crop.jpg'):
        image = read_image_file(folder / name)
        assert image.shape[1] == 900 and image.std() > 20


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


def test_a_site_that_fails_is_named_and_the_others_are_kept(
    finished: tuple[Path, dict[str, Any]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The second site fails, the third one lacks a mark, the fourth one is interrupted."""
    good = PaperRun(**finished[1]['runs'][0])
    rows = [[np.nan, *row[1:]] if index == 2 else row for index, row in enumerate(good.rows)]

    def steps(*_: object, **__: object) -> Iterator[object]:
        yield good, None
        yield FailedRun(5, 0.005, 'no camera fits the marks')
        yield replace(good, seed=6, rows=rows), None
        raise KeyboardInterrupt

    monkeypatch.setattr(command, 'run_paper', steps)
    for draw in ('draw_sizes', 'draw_crop'):
        monkeypatch.setattr(command, draw, lambda *_: np.zeros((9, 9, 3), np.uint8))
    assert main(['paper', '--output', str(tmp_path)]) == 130
    assert '2 finished reconstructions are kept' in capsys.readouterr().err
    content = json.loads((tmp_path / 'paper.json').read_text())
    assert [run['seed'] for run in content['runs']] == [4, 6]
    assert content['runs'][1]['rows'][2][0] is None
    assert content['failed'] == [
        {'seed': 5, 'placement_m': 0.005, 'reason': 'no camera fits the marks'}
    ]
    tables = (tmp_path / 'tables.md').read_text()
    assert 'Not measured: seed 5, rods 5 mm off: no camera fits the marks.' in tables

    failed = FailedRun(0, 0.0, 'no room')
    monkeypatch.setattr(command, 'run_paper', lambda *_, **__: iter([failed]))
    assert main(['paper', '--output', str(tmp_path)]) == 1
    assert 'no site could be measured; Not measured: seed 0' in capsys.readouterr().err


def test_a_site_whose_calibration_fails_is_passed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise CalibrationError('too few boards')

    monkeypatch.setattr(paper, 'simulate_site', lambda seed, _: SimpleNamespace(seed=seed))
    monkeypatch.setattr(paper, 'run_site', fail)
    steps = list(paper.run_paper(survey_rig(), [3, 4], [0.0]))
    assert steps == [FailedRun(3, 0.0, 'too few boards'), FailedRun(4, 0.0, 'too few boards')]


def test_marks_not_found_stay_out_of_the_means(finished: tuple[Path, dict[str, Any]]) -> None:
    run = PaperRun(**finished[1]['runs'][0])
    rows = [[500.0, 507.0, 1.0, 1.0, np.nan, 1.0]] * 6
    rows[0] = [np.nan, 507.0, 1.0, 1.5, np.nan, 1.0]
    last = table_1(replace(run, rows=rows)).splitlines()[-1]
    assert [cell.strip() for cell in last.split('|')[-7:-1]] == ['', '7.00', '', '0.08', '', '-']


def test_table_1_shows_the_board_nearest_to_the_papers_and_means_of_all(
    finished: tuple[Path, dict[str, Any]],
) -> None:
    run = PaperRun(**finished[1]['runs'][0])
    stages = {'corrected': 0.2, 'adjusted': 0.1}
    runs = [
        replace(run, seed=seed, rows_px={'uncorrected': apart, **stages})
        for seed, apart in ((0, 9.0), (1, 5.0), (2, 1.0))
    ]
    words = report(runs).splitlines()[0]
    assert '(rods exact; site 1,' in words
    assert words.endswith('uncorrected 5.000, corrected 0.200, adjusted 0.100.')


def test_table_2_says_how_marks_were_made(finished: tuple[Path, dict[str, Any]]) -> None:
    run = PaperRun(**finished[1]['runs'][0])
    board = {'uncorrected_px': 0.3, 'corrected_px': 0.2, 'adjusted_px': 0.1}
    other = replace(run, seed=9, boards_px=[board])

    def words(*runs: PaperRun) -> str:
        return next(line for line in report(runs).splitlines() if line.startswith('Table 2'))

    assert words(run, other).endswith('marks simulated with 0.12 px of noise.')
    detected = replace(run, rendered=True)
    assert words(detected).endswith('rods detected in images.')
    assert words(detected, other).endswith('px: rods exact: 0.300 / 0.200 / 0.100.')


def test_unwritable_folder_is_said_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'taken').write_text('a file')
    assert main(['paper', '--output', str(tmp_path / 'taken')]) == 1
    assert 'taken cannot be made' in capsys.readouterr().err
    with pytest.raises(SystemExit, match='2'):
        main(['paper', '--seeds', '0'])
    with pytest.raises(SystemExit, match='2'):
        main(['paper', '--first-seed', '-1'])
    assert 'must not be negative' in capsys.readouterr().err
