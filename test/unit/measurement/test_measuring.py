# SPDX-License-Identifier: Apache-2.0
"""Measurements between picks: their values and stated sigma against the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from binocular_recon.camera import FloatArray
from binocular_recon.errors import FileError, MeasurementError
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.kinds import KINDS, measure
from binocular_recon.measurement.picks import Pick, Request, read_picks, write_picks
from binocular_recon.measurement.session import MeasuringSession
from binocular_recon.measurement.snapping import PICK_SIGMA_PX, locate, surface_at
from binocular_recon.measurement.uncertain import Uncertain, joined, propagate
from binocular_recon.stereo.validity import Validity
from test.unit.measurement.measured_site import MeasuredSite


@pytest.fixture(scope='module')
def site() -> MeasuredSite:
    return MeasuredSite(0)


@pytest.fixture(scope='module')
def exact() -> MeasuredSite:
    return MeasuredSite(0, 1e-6)


def session_of(site: MeasuredSite, pixels: Mapping[str, Sequence[float]]) -> MeasuringSession:
    picks = [Pick(name, np.array(pixel, float)) for name, pixel in pixels.items()]
    return MeasuringSession(lambda _: site.frame, picks)


def test_sources_that_values_share_cancel() -> None:
    common = np.array([[3.0]])
    a = Uncertain(np.array([5.0]), {('calibration', ''): common, ('pick', 'a'): common})
    b = Uncertain(np.array([2.0]), {('calibration', ''): common, ('pick', 'b'): 4 * common / 3})
    found = propagate(lambda a, b: a - b, a, b)
    assert found.sigma[0] == pytest.approx(5.0)
    assert found.shares == {
        'calibration': pytest.approx([0.0], abs=1e-8),
        'pick': pytest.approx([5.0]),
    }
    both = joined(a, b)
    assert both.covariance == pytest.approx(np.array([[18.0, 9.0], [9.0, 25.0]]))


@pytest.mark.long
def test_lengths_are_off_by_as_much_as_stated() -> None:
    """Four calibrations, matches and picks, each off by what its sigma says."""
    ratios = []
    for seed in range(4):
        site, rng = MeasuredSite(seed), np.random.default_rng(seed)
        pixels, truth = site.random_pixels(rng, 120)
        points = [
            locate(site.frame, Pick(str(i), pixel + rng.normal(0, PICK_SIGMA_PX, 2)))
            for i, pixel in enumerate(pixels)
        ]
        for i in range(0, 120, 2):
            length = float(np.linalg.norm(truth[i + 1] - truth[i]))
            if 0.5 < length < 10:
                found = propagate(lambda a, b: np.linalg.norm(a - b), points[i], points[i + 1])
                ratios.append((found.values[0] - length) / found.sigma[0])
    assert len(ratios) > 100
    assert 0.7 < np.sqrt(np.mean(np.square(ratios))) < 1.25
    assert np.mean(np.abs(ratios) > 3) < 0.02


def test_every_kind_against_the_truth(exact: MeasuredSite) -> None:
    """Without noise, what is left is the calibration, whose share is stated."""
    pixels, truth = exact.random_pixels(np.random.default_rng(3), 4)
    names = ['A', 'B', 'C', 'D']
    session = session_of(exact, dict(zip(names, pixels.tolist(), strict=True)))
    up = exact.calibrated.left.R @ exact.scene.up_xyz
    a, b, c, d = truth
    corner = np.degrees(
        np.arccos((a - b) @ (c - b) / np.linalg.norm(a - b) / np.linalg.norm(c - b))
    )
    legs = [np.linalg.norm(q - p) for p, q in ((a, b), (b, c), (c, d))]
    step = b - a
    expected = {
        'distance A B': legs[0],
        'horizontal A B': np.linalg.norm(step - (step @ up) * up),
        'vertical A B': step @ up,
        'height A': (a - _foot(exact, up)) @ up,
        'angle A B C': corner,
        'polyline A B C D': sum(legs),
        'area A B C': np.linalg.norm(np.cross(b - a, c - a)) / 2,
        'section A B': legs[0],
    }
    for text, value in expected.items():
        found = measure(session, Request.of(text)).main
        assert abs(found.value - value) < 4 * found.sigma + 0.01, text
        assert 0 < found.sigma < 0.05 * abs(value) + 0.1, text
        assert 'calibration' in found.shares and 'pick' in found.shares, text
    point = measure(session, Request.of('point A'))
    for axis, true in zip('xyz', a, strict=True):
        one = point.quantities[axis]
        assert abs(one.value - true) < 4 * one.sigma


def _foot(site: MeasuredSite, up: FloatArray) -> FloatArray:
    """Return a true point of the ground."""
    ground = site.truth[-20:][np.isfinite(site.truth[-20:, :, 2])]
    foot: FloatArray = ground[np.argmin(ground @ up)]
    return foot


def test_faces_and_profiles(site: MeasuredSite) -> None:
    """The ground is flat within the noise, and level; a profile across a step shows it."""
    height, width = site.truth.shape[:2]
    corners = {
        'A': (0.4 * width, 0.9 * height), 'B': (0.6 * width, 0.9 * height),
        'C': (0.6 * width, 0.98 * height), 'D': (0.4 * width, 0.98 * height),
    }  # fmt: skip
    session = session_of(site, corners)
    plane = measure(session, Request.of('plane A B C D'))
    flat, noise = (plane.quantities[f'{name}_rms'] for name in ('flatness', 'noise'))
    assert flat.value == pytest.approx(noise.value, rel=0.35)
    assert plane.quantities['slope'].value < 1.0
    section = measure(session, Request.of('section A C'))
    assert section.profile['along_m'][0] == pytest.approx(0, abs=0.05)
    assert np.abs(section.profile['before_m']).max() < 5 * section.profile['sigma_before_m'].max()
    assert np.abs(section.profile['height_m']).max() < 0.1


def test_a_pick_on_an_outline_is_on_the_nearer_thing(site: MeasuredSite) -> None:
    frame = flat_frame(site.frame, 30.0)
    frame.disparity_px[:, 200:] = 40.0
    for column, disparity in ((200.0, 40.0), (199.0, 40.0), (196.0, 30.0)):
        found = surface_at(frame, Pick('A', np.array([column, 100.0])))
        assert found.disparity_px == pytest.approx(disparity, abs=0.05)
    # one wrong match in ten does not matter
    frame.disparity_px[::3, ::3] = 90.0
    found = surface_at(frame, Pick('A', np.array([100.0, 100.0])))
    assert found.disparity_px == pytest.approx(30.0, abs=0.05)


def test_a_surface_is_off_by_what_its_pixels_are_off_if_right(site: MeasuredSite) -> None:
    """Errors of a window have one sign; the share of mismatches in sigma is not in its surface."""
    tile, (down, across) = 18, (10, 13)
    rows, columns = np.mgrid[: tile * down, : tile * across]
    right = np.where((rows + columns) % 2, 0.25, 0.55)
    sign = np.random.default_rng(6).standard_normal((down, across)).clip(-1.5, 1.5)
    frame = flat_frame(site.frame, 30.0)
    window = np.s_[: tile * down, : tile * across]
    frame.disparity_px[window] += (np.kron(sign, np.ones((tile, tile))) * right).astype(np.float32)
    frame = replace(frame, sigma_px=frame.sigma_px.copy())
    frame.sigma_px[window] = np.sqrt(right**2 + right**6 / 0.45**4)
    middles = (np.indices((across, down)).reshape(2, -1).T + 0.5) * tile
    found = [surface_at(frame, Pick('A', middle)) for middle in middles]
    stated = np.array([one.sigma_px for one in found])
    off = np.array([one.disparity_px for one in found]) - 30.0
    assert np.corrcoef(off.reshape(across, down).T.ravel(), sign.ravel())[0, 1] > 0.98
    assert stated.min() > 0.35
    assert 0.8 < np.sqrt(np.mean((off / stated) ** 2)) / np.std(sign) < 1.1


def flat_frame(frame: MeasuredFrame, disparity: float) -> MeasuredFrame:
    return replace(
        frame,
        disparity_px=np.full_like(frame.disparity_px, disparity),
        validity=np.full_like(frame.validity, Validity.MEASURED),
    )


def test_picks_in_both_images_give_the_same_point(exact: MeasuredSite) -> None:
    (pixel,), (truth,) = exact.random_pixels(np.random.default_rng(1), 1)
    column, row = pixel.astype(int)
    right = pixel - [float(exact.frame.disparity_px[row, column]), 0]
    found = locate(exact.frame, Pick('A', pixel, right))
    assert (np.abs(found.values - truth) < 4 * found.sigma).all()
    assert found.shares['pick'][2] > locate(exact.frame, Pick('A', pixel)).shares['pick'][2]
    for wrong, message in (
        (right + np.array([0, 3]), 'rows of the two pixels differ by -3'),
        (pixel + np.array([1, 0]), 'no point before the cameras'),
        (right - np.array([9999, 0]), 'outside of the right image'),
    ):
        with pytest.raises(MeasurementError, match=message):
            locate(exact.frame, Pick('A', pixel, np.asarray(wrong)))


def test_picks_that_show_nothing_are_refused(site: MeasuredSite) -> None:
    hollow = flat_frame(site.frame, 30.0)
    hollow.validity[90:110, 90:110] = Validity.FILLED | Validity.LOW_TEXTURE
    for pixel, message in (
        ((100.0, 100.0), 'on a hole: only 0 of 49 pixels .* too little texture'),
        ((-1.0, 5.0), r'pick A at \(-1.0000, 5.0000\) is outside of the left image of 288x180'),
        ((288.0, 5.0), 'outside of the left image'),
    ):
        with pytest.raises(MeasurementError, match=message):
            locate(hollow, Pick('A', np.array(pixel)))
    rough = flat_frame(site.frame, 30.0)
    rough.disparity_px[:] = 30 + 7.0 * (np.arange(288) % 5)
    with pytest.raises(MeasurementError, match='is on no surface'):
        locate(rough, Pick('A', np.array([100.0, 100.0])))


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('length A B', "'length' is no kind of measurement"),
        ('distance A', 'distance needs 2 picks, got 1'),
        ('polyline A', 'needs at least 2'),
        ('distance A A', 'names the pick A twice'),
        ('distance A E', "no pick 'E'; the picks are A, B, C"),
        ('distance A C', 'the same point'),
        ('area A B D', 'on one line'),
        ('', 'is its kind and picks'),
        ('plane A B D', 'were measured, 49 are the least'),
    ],
)
def test_what_cannot_be_measured_is_said(site: MeasuredSite, text: str, message: str) -> None:
    flat = MeasuredSite.__new__(MeasuredSite)
    flat.frame = flat_frame(site.frame, 30.0)
    session = session_of(
        flat, {'A': (50.0, 50.0), 'B': (60.0, 60.0), 'C': (50.0, 50.0), 'D': (70.0, 70.0)}
    )
    with pytest.raises(MeasurementError, match=message):
        measure(session, Request.of(text))


def test_picks_of_several_frames_share_the_calibration(site: MeasuredSite) -> None:
    (a, b), _ = site.random_pixels(np.random.default_rng(5), 2)
    session = MeasuringSession(lambda _: site.frame, [Pick('A', a), Pick('B', b, frame=1)])
    assert measure(session, Request.of('distance A B')).main.sigma > 0
    with pytest.raises(MeasurementError, match=r'picked in the frames \[0, 1\]'):
        measure(session, Request.of('vertical A B'))


def test_picks_files(tmp_path: Path) -> None:
    picks = [
        Pick('A', np.array([1.5, 2.0])),
        Pick('B', np.array([3.0, 4.0]), np.array([1.0, 4.0])),
    ]
    path = tmp_path / 'picks.csv'
    write_picks(path, picks)
    found, requests = read_picks(path)
    assert not requests and list(found) == ['A', 'B'] and found['A'].right is None
    right = found['B'].right
    assert right is not None and right.tolist() == [1.0, 4.0]
    yaml = tmp_path / 'picks.yaml'
    yaml.write_text(
        'picks: [{name: A, frame: 1, u: 5, v: 6}]\n'
        'measurements: [{name: width, kind: distance, points: [A, B]}, {kind: point, points: [A]}]'
    )
    found, requests = read_picks(yaml)
    assert found['A'].frame == 1
    assert requests == [Request('distance', ('A', 'B'), 'width'), Request.of('point A')]
    assert set(KINDS) > {'distance', 'upright', 'wheelbase', 'section'}


@pytest.mark.parametrize(
    ('name', 'text', 'message'),
    [
        ('a.csv', 'name,u,v\nA,1,2\n', 'lacks the columns frame'),
        ('a.csv', 'name;frame;u;v\nA;0;1,5;2\n', 'semicolons between its columns; save'),
        ('a.csv', 'name,frame,u,v\nA,0,x,2\n', "line 2: u must be a finite number, got 'x'"),
        ('a.csv', 'name,frame,u,v\nA,0.5,1,2\n', 'frame must be a whole number'),
        ('a.csv', 'name,frame,u,v\n,0,1,2\n', 'name must be a name'),
        ('a.csv', 'name,frame,u,v\nA,0,1,2\nA,0,1,2\n', "'A' is picked twice"),
        ('a.csv', 'name,frame,u,v\n', 'holds no picks'),
        ('a.yaml', '- 1\n', 'must have a list under picks'),
        ('a.yaml', 'picks: [1]\n', 'picks must be a list of mappings'),
        ('a.yaml', 'picks: [{name: A, u: 1, v: 2}]\nmeasurements: [{kind: 1}]', 'kind must be'),
    ],
)
def test_damaged_picks_files(tmp_path: Path, name: str, text: str, message: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(MeasurementError, match=message):
        read_picks(path)
    with pytest.raises(FileError, match='cannot be read'):
        read_picks(tmp_path / 'none.csv')


def test_a_surface_that_is_off_its_surroundings_says_so(site: MeasuredSite) -> None:
    """Matches of a patch that are wrong together agree; another thing does not count."""
    frame = flat_frame(site.frame, 30.0)
    pick = Pick('A', np.array([100.0, 100.0]))
    alone = surface_at(frame, pick).sigma_px
    frame.disparity_px[96:105, 96:105] += 1.5
    found = surface_at(frame, pick)
    assert found.disparity_px == pytest.approx(31.5, abs=0.01)
    assert found.sigma_px == pytest.approx(np.hypot(alone, 1.5), rel=0.1)
    frame.disparity_px[96:105, 96:105] = 60.0
    assert surface_at(frame, pick).sigma_px == pytest.approx(alone, rel=0.1)
