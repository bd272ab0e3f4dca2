# SPDX-License-Identifier: Apache-2.0
"""The frame of a site: control points, the vertical, reference systems, and the commands."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from binocular_recon.camera import FloatArray
from binocular_recon.cli.main import main
from binocular_recon.errors import DependencyError, MeasurementError
from binocular_recon.measurement.picks import Pick
from binocular_recon.measurement.site.adjustment import adjust
from binocular_recon.measurement.site.control_points import ControlPoint, read_control
from binocular_recon.measurement.site.levelling import level_by_ground, level_by_uprights
from binocular_recon.measurement.site.reference_systems import reference_system
from binocular_recon.measurement.site.tie import TIE_FILE, SiteTie, read_tie
from binocular_recon.measurement.snapping import PICK_SIGMA_PX, locate
from binocular_recon.measurement.uncertain import Uncertain
from test.unit.measurement.measured_site import MeasuredSite, write_output, write_rows

TURN = cv2.Rodrigues(np.array([[-1.6], [0.2], [0.1]]))[0]
# Large coordinates, as those of a map.
PLACE = np.array([512_345.678, 5_412_345.678, 300.0])
CONTROL_M = 0.005


def on_site(points: FloatArray) -> FloatArray:
    placed: FloatArray = points @ TURN.T + PLACE
    return placed


@lru_cache
def site_of(seed: int) -> MeasuredSite:
    return MeasuredSite(seed)


def control_of(
    seed: int, count: int, checks: int = 0, scale: float = 1.0
) -> tuple[list[Uncertain], list[ControlPoint]]:
    """Return points as picked and as surveyed, the control points at 12 to 18 m."""
    site, rng = site_of(seed), np.random.default_rng(seed)
    pixels, truth = site.random_pixels(rng, count, 12.0, 18.0)
    more, true = site.random_pixels(rng, checks)
    points, control = [], []
    for i, (pixel, place) in enumerate(
        zip(np.concatenate([pixels, more]), np.concatenate([truth, true]), strict=True)
    ):
        pick = Pick(f'P{i}', pixel + rng.normal(0, PICK_SIGMA_PX, 2))
        given = on_site(scale * place) + rng.normal(0, CONTROL_M, 3)
        points.append(locate(site.frame, pick))
        control.append(ControlPoint(f'P{i}', given, np.full(3, CONTROL_M), pick, i >= count))
    return points, control


@pytest.mark.long
def test_check_points_are_off_by_as_much_as_stated() -> None:
    """Four control points of 5 mm; the check points' errors are shared by those of the tie."""
    ratios: list[float] = []
    for seed in range(4):
        points, control = control_of(seed, 4, 20)
        found = adjust(points, control, site_of(seed).frame)
        for error in found.checks.values():
            ratios += (error.off_m / error.sigma_m).tolist()
        tie = found.tie
        # the tie applied by itself states the same
        for point, one in list(zip(points, control, strict=True))[4:]:
            tied = tie.to_site(point, site_of(seed).frame)
            assert tied.values == pytest.approx(one.place - found.checks[one.name].off_m, abs=1e-6)
            stated = np.hypot(tied.sigma, CONTROL_M)
            assert stated == pytest.approx(found.checks[one.name].sigma_m, rel=1e-3)
        assert tie.apply(points[0].values) == pytest.approx(
            tie.to_site(points[0], site_of(seed).frame).values, abs=1e-7
        )
    assert 0.75 < np.sqrt(np.mean(np.square(ratios))) < 1.3
    assert np.mean(np.abs(ratios) > 3) < 0.02


def test_the_vertical_of_a_tied_site_is_known() -> None:
    points, control = control_of(0, 6)
    up = adjust(points, control, site_of(0).frame).tie.up(site_of(0).frame)
    off = up.values - TURN[2]
    assert np.linalg.norm(off) < 4 * np.linalg.norm(up.sigma)


def test_a_free_scale_tells_a_wrong_one() -> None:
    found = {}
    for scale in (1.0, 1.05):
        points, control = control_of(1, 8, scale=scale)
        found[scale] = adjust(points, control, site_of(1).frame, free_scale=True)
    for scale, one in found.items():
        assert abs(one.scale - scale) < 3.5 * one.scale_sigma
        assert one.scale_sigma < 0.02
    held = adjust(*control_of(1, 8), site_of(1).frame)
    assert held.scale == 1 and np.isnan(held.scale_sigma)


def test_a_control_point_that_is_a_metre_off_is_named() -> None:
    points, control = control_of(2, 5)
    right = adjust(points, control, site_of(2).frame)
    assert set(right.left_out) == set(right.residuals) == {f'P{i}' for i in range(5)}
    for index in range(5):
        wrong = list(control)
        place = control[index].place + np.array([0.6, -0.6, 0.53])
        wrong[index] = replace(control[index], place=place)
        with pytest.raises(
            MeasurementError, match=rf'point P{index} is (0\.|1\.)\d+ m from where'
        ):
            adjust(points, wrong, site_of(2).frame)
    with pytest.raises(MeasurementError, match='three control points contradict each other'):
        adjust(points[2:], wrong[2:], site_of(2).frame)
    twice = [
        replace(one, place=one.place + np.array([0, 0, i % 2])) for i, one in enumerate(control)
    ]
    with pytest.raises(MeasurementError, match='more than one is wrong'):
        adjust(points, twice, site_of(2).frame)


def test_too_few_control_points_and_those_on_a_line_are_refused() -> None:
    points, control = control_of(3, 4)
    with pytest.raises(MeasurementError, match='2 control points, 3 that are not on one line'):
        adjust(points[:2], control[:2], site_of(3).frame)
    checks = [replace(one, check=True) for one in control[2:]]
    with pytest.raises(MeasurementError, match='the table has 2 control points'):
        adjust(points, [*control[:2], *checks], site_of(3).frame)
    line = [replace(one, place=PLACE + i * np.array([1.0, 2, 0])) for i, one in enumerate(control)]
    with pytest.raises(MeasurementError, match='4 control points lie on one line'):
        adjust(points, line, site_of(3).frame)


def test_level_by_ground_and_by_uprights() -> None:
    site = site_of(0)
    up = site.calibrated.left.R @ site.scene.up_xyz
    ground = level_by_ground(site.frame)
    assert _degrees(ground, up) < 0.2
    assert ground.pivot_site[2] == pytest.approx(1.5, abs=0.05)
    ends = {}
    for i, foot in enumerate(np.array([[-1.0, 1.2, 9], [0.5, 1.2, 12], [2, 1.2, 14]])):
        tilt = np.random.default_rng(i).normal(0, 0.003, 3)
        head = foot + 2 * (up + tilt)
        ends[f'rod {i}'] = _point(head), _point(foot)
    levelled = level_by_uprights(site.frame, ends)
    assert _degrees(levelled, up) < 0.5
    assert levelled.facts['tilt_sigma_deg'] < 0.4
    foot, head = np.array([0.0, 1.2, 8.0]), np.array([0.6, -0.6, 8.0])
    with pytest.raises(MeasurementError, match=r'leaning is .* degrees off the vertical of all'):
        level_by_uprights(site.frame, {**ends, 'leaning': (_point(head), _point(foot))}, 'plumb')
    for wrong, message in (
        ({}, 'nothing upright'),
        ({'a': (_point(foot), _point(foot + 0.01))}, '0.017 m long, 0.2 m is the least'),
        (
            {'a': (_point(foot), _point(foot + np.array([1.0, 0.1, 0])))},
            'a lies more than 45 degrees off .* its ends are 8.00 and 8.00 m ahead',
        ),
    ):
        with pytest.raises(MeasurementError, match=message):
            level_by_uprights(site.frame, wrong)


def _point(place: FloatArray) -> Uncertain:
    return Uncertain(place, {('pick', str(place)): 0.004 * np.eye(3)})


def _degrees(tie: SiteTie, up: FloatArray) -> float:
    return float(np.degrees(np.arccos(min(1.0, tie.R[2] @ up))))


def test_reference_systems(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'pyproj', None)
    with pytest.raises(DependencyError, match=r"pip install 'binocular_recon\[survey\]'"):
        reference_system(25832, PLACE)
    monkeypatch.undo()
    pytest.importorskip('pyproj')
    system = reference_system(25832, PLACE)
    # near the central meridian: 0.9996, and 300 m up 47 ppm less
    assert system.scale == pytest.approx(0.9996 - 45e-6, abs=5e-6)
    assert 'ETRS89' in system.wkt
    # coordinates fit every zone, so the place is said: 3 zones are 18 degrees
    assert abs(system.latitude_deg - 49) < 1 and system.place.endswith(' E')
    other = reference_system(25835, PLACE)
    assert other.longitude_deg - system.longitude_deg == pytest.approx(18, abs=1e-6)
    for code, message in (
        (99999, 'EPSG:99999 is not a known'),
        (4326, 'is not projected'),
        (2263, 'is in US survey foot'),
        (32755, 'outside of the area'),
    ):
        place = PLACE if code != 32755 else np.array([5e5, 5.4e6, 0])
        with pytest.raises(MeasurementError, match=message):
            reference_system(code, place - [0, 1e7, 0] if code == 32755 else place)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('name,x,y\nA,1,2\n', 'lacks the columns z'),
        ('name,x,y,z\nA,1,2,3\n', "'A' is not picked"),
        ('name,x,y,z,frame,u,v\nA,1,2,x,0,1,2\n', 'z must be a finite number'),
        ('name,x,y,z,frame,u,v,check\nA,1,2,3,0,1,2,maybe\n', 'check must be yes or no'),
        ('name,x,y,z,sigma_x,frame,u,v\nA,1,2,3,0,0,1,2\n', 'must be above 0'),
        ('name,x,y,z,frame,u,v\nA,1,2,3,0,1,2\nA,1,2,3,0,1,2\n', "'A' appears twice"),
        ('name,x,y,z,frame,u,v\n,1,2,3,0,1,2\n', 'the name is missing'),
    ],
)
def test_damaged_control_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / 'control.csv'
    path.write_text(text)
    with pytest.raises(MeasurementError, match=message):
        read_control(path)


@pytest.fixture(scope='module')
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an output folder of `reconstruct` with one frame of a simulated site."""
    return write_output(site_of(0), tmp_path_factory.mktemp('out'))


def test_measure_and_georeference_an_output_folder(
    output: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site = site_of(0)
    pixels, truth = site.random_pixels(np.random.default_rng(2), 6, 10.0, 18.0)
    rows: list[dict[str, object]] = [
        {'name': f'P{i}', 'frame': 0, 'u': pixel[0], 'v': pixel[1]}
        for i, pixel in enumerate(pixels)
    ]
    picks = write_rows(tmp_path / 'picks.csv', rows)
    arguments = ['measure', str(output), '--picks', str(picks)]
    assert main([*arguments, '--measure', 'distance P0 P1', '--output', str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert 'distance P0 P1' in shown and '+-' in shown
    content = json.loads((tmp_path / 'measurements.json').read_text())
    length = content['measurements'][0]['length']
    assert abs(length['value'] - np.linalg.norm(truth[1] - truth[0])) < 4 * length['sigma']
    assert set(length['sigma_by_source']) == {'pick', 'matching', 'calibration'}
    assert content['sigma'] == 'matching and calibration'
    image = cv2.imread(str(tmp_path / 'measured_000000.png'))
    assert (image != site.frame.left_bgr).any() and image.shape == site.frame.left_bgr.shape
    assert (tmp_path / 'measurements.csv').read_text().count('\n') == 2
    # what can be measured is, what cannot is said
    assert main([*arguments, '--measure', 'distance P0 P9', '--measure', 'point P0']) == 1
    assert "there is no pick 'P9'" in capsys.readouterr().err
    assert (output / 'measurements.json').exists()

    places = on_site(truth)
    control: list[dict[str, object]] = [
        {'name': f'P{i}', 'x': x, 'y': y, 'z': z, 'check': 'yes' if i == 5 else ''}
        for i, (x, y, z) in enumerate(places.tolist())
    ]
    table = write_rows(tmp_path / 'control.csv', control)
    tie = ['georeference', str(output), '--control', str(table), '--picks', str(picks)]
    assert main([*tie, '--free-scale']) == 0
    shown = capsys.readouterr().out
    assert 'scale ' in shown and 'agrees with the calibration' in shown and 'check' in shown
    read = read_tie(output / TIE_FILE)
    frame_point = locate(site.frame, Pick('P5', pixels[5]))
    tied = read.to_site(frame_point, site.frame)
    assert (np.abs(tied.values - places[5]) < 4 * tied.sigma).all()
    assert main([*arguments, '--measure', 'point P5']) == 0  # now in the site's frame, too
    found = json.loads((output / 'measurements.json').read_text())['measurements'][0]
    assert found['X']['value'] == pytest.approx(places[5, 0], abs=0.5)
    before = (output / TIE_FILE).read_bytes()
    control[1]['x'] = float(places[1, 0]) + 1
    write_rows(table, control)
    assert main(tie) == 1
    assert 'control point P1 is' in capsys.readouterr().err
    assert (output / TIE_FILE).read_bytes() == before  # nothing is lost
    assert main([*tie, '--leave-out', 'P1']) == 0
    assert 'warning' not in capsys.readouterr().out
    control[1]['x'], control[5]['z'] = float(places[1, 0]), float(places[5, 2]) - 1
    write_rows(table, control)
    assert main(tie) == 0  # check points have no part in the tie
    assert re.search(r'warning: check point P5 is (1\.|0\.9)\d* m from', capsys.readouterr().out)
    for wrong, status, message in (
        ([*tie, '--leave-out', 'Q'], 1, "has no point 'Q'"),
        ([*tie, '--level', 'ground'], 2, 'either --control'),
        (['georeference', str(output), '--level', 'rods'], 2, 'needs --picks'),
        (['georeference', str(tmp_path), '--level', 'ground'], 1, 'summary.json'),
    ):
        assert main(wrong) == status
        assert message in capsys.readouterr().err
    assert main(['georeference', str(output), '--level', 'ground']) == 0
    assert 'm above the ground' in capsys.readouterr().out
    (output / TIE_FILE).write_text('{}')
    assert main([*arguments, '--measure', 'point P5']) == 1
    assert 'is not a georeference' in capsys.readouterr().err
    (output / TIE_FILE).unlink()
    (output / '000000_sigma.pfm').unlink()
    assert main([*arguments, '--measure', 'point P5']) == 1
    assert '000000_sigma.pfm is missing' in capsys.readouterr().err
