# SPDX-License-Identifier: Apache-2.0
"""``demo --survey``: a simulated survey, from the rods to the report, beside the truth."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from binocular_recon.apps.survey import simulated_site
from binocular_recon.apps.survey.simulated_site import MEASURED, TARGETS, Compared
from binocular_recon.cli.main import main
from binocular_recon.cli.survey import tour


@pytest.mark.long
def test_a_simulated_survey_agrees_with_the_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, 'lazrs', None)  # a package that users may not have
    args = ['demo', '--survey', '--size', '0.5', '--boards', '4', '--output', str(tmp_path)]
    assert main(args) == 0
    printed = capsys.readouterr().out
    commands = [line.split()[2] for line in printed.splitlines() if line.startswith('$ ')]
    assert commands == [
        'rods-plan', 'calibrate', 'calibrate', 'reconstruct', 'georeference', 'measure', 'export',
        'report',
    ]  # fmt: skip
    assert 'LAZ is left out: LAZ files need the package lazrs' in printed
    cloud = tmp_path / 'cloud'
    true_m = json.loads((tmp_path / 'truth.json').read_text())['measured_m']
    measured = json.loads((cloud / 'measurements.json').read_text())['measurements']
    assert [one['name'] for one in measured] == list(true_m) == list(MEASURED)
    for one in measured:
        found = next(value for value in one.values() if isinstance(value, dict))
        assert abs(found['value'] - true_m[one['name']]) < 3 * found['sigma'] < 0.2, one['name']
    # known sizes of the scene, not those that the demo states
    assert [true_m[name] for name in list(MEASURED)[:3]] == pytest.approx([1.795, 1.81, 1.0])
    points = json.loads((cloud / 'georeference.json').read_text())['points']
    assert [point['name'] for point in points] == list(TARGETS)
    for point in points:
        if point['check']:
            for off, sigma in zip(point['error_m'], point['error_sigma_m'], strict=True):
                assert abs(off) < 3 * sigma < 1.0
    with (tmp_path / 'control.csv').open() as file:
        assert sum(row['check'] == 'yes' for row in csv.DictReader(file)) == 2
    report = (cloud / 'report.html').read_text()
    assert 'Simulated yard' in report and 'Nothing is missing in this report' in report


def test_a_value_that_contradicts_its_sigma_ends_the_tour_with_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(simulated_site, 'simulate_survey', lambda *_, **__: SimpleNamespace())
    monkeypatch.setattr(simulated_site, 'write_field_book', lambda *_, **__: None)
    values = [Compared('a good length', 2.0, 2.1, 0.05), Compared('a bad length', 2.0, 2.5, 0.05)]
    monkeypatch.setattr(simulated_site, 'compare', lambda *_: values)
    monkeypatch.setattr('binocular_recon.io.calibration_yaml.read_rig', lambda _: None)
    monkeypatch.setattr(tour, 'run_command', lambda _: None)
    monkeypatch.setitem(sys.modules, 'pyproj', None)
    assert main(['demo', '--survey', '--output', str(tmp_path)]) == 1
    shown = capsys.readouterr()
    assert 'a bad length is 2.500 m, +10.0 sigma from the truth' in shown.err
    assert 'the reference system is left out: reference systems (--epsg) need' in shown.out
    assert '--epsg' not in shown.out.partition('$ binocular-recon georeference')[2]


def test_options_of_the_survey_are_refused_without_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['demo', '--boards', '4']) == 2
    assert '--boards and --size are options of --survey' in capsys.readouterr().err
