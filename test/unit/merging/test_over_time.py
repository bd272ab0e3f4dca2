# SPDX-License-Identifier: Apache-2.0
"""Frames of a rig that stood still become one: errors, sigmas, and what moved."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.apps.survey.merging import merge_over_time
from binocular_recon.camera import Camera, FloatArray, StereoRig
from binocular_recon.cli.main import main
from binocular_recon.config import ChainConfig
from binocular_recon.errors import ConfigError, FileError, MeasurementError
from binocular_recon.images import ByteImage, FloatImage
from binocular_recon.io.pfm import read_pfm
from binocular_recon.io.ply import read_ply
from binocular_recon.merging.over_time import average
from binocular_recon.stereo.filtering.wls_filter import Filtered
from binocular_recon.stereo.matching.matcher import Match
from binocular_recon.stereo.pipeline import Reconstruction
from binocular_recon.stereo.search_range import RangeChoice, SearchRange
from binocular_recon.stereo.triangulation import triangulate
from binocular_recon.stereo.validity import Validity
from test.frame_results import store_frames

SIZE = WIDTH, HEIGHT = 128, 96
P = np.array([[150.0, 0, 64, 0], [0, 150, 48, 0], [0, 0, 1, 0]])
RIG = StereoRig(
    *(
        Camera(WIDTH, HEIGHT, P[:, :3], np.zeros(5), np.eye(3), p)
        for p in (P, P + np.array([[0, 0, 0, -75.0], [0, 0, 0, 0], [0, 0, 0, 0]]))
    )
)
RANDOM_PX, SYSTEMATIC_PX = 0.2, 0.1
# A wall at 7.5 m, and a step to 5 m.
TRUTH = np.where(np.arange(WIDTH) < 80, 10.0, 15.0).astype(np.float32) + np.zeros((HEIGHT, 1))
BOX, NEAR_PX = (slice(30, 60), slice(20, 50)), 25.0


class Scene:
    """A still scene: texture and errors of matching are those of every frame, noise is new."""

    def __init__(self, seed: int = 1) -> None:
        self.rng = np.random.default_rng(seed)
        self.systematic = self.rng.normal(0, SYSTEMATIC_PX, TRUTH.shape)
        texture = cv2.GaussianBlur(self.rng.uniform(0, 255, (HEIGHT + 8, WIDTH + 8, 3)), (0, 0), 1)
        self.texture = cv2.normalize(texture, None, 20, 235, cv2.NORM_MINMAX)
        # a corner that no frame can match
        self.validity = np.full(TRUTH.shape, Validity.MEASURED, np.uint8)
        self.validity[:20, :20] = Validity.FILLED | Validity.LOW_TEXTURE

    def frame(self, *, box: bool = False, shift: int = 0) -> Reconstruction:
        """Return a frame, with a box in front, or with a camera that was moved."""
        noise = self.rng.normal(0, RANDOM_PX, TRUTH.shape)
        disparity_px = (TRUTH + self.systematic + noise).astype(np.float32)
        sigma_px = np.full_like(disparity_px, np.hypot(RANDOM_PX, SYSTEMATIC_PX))
        left = self.texture[4 : HEIGHT + 4, 4 + shift : WIDTH + 4 + shift].copy()
        left += self.rng.normal(0, 2, left.shape)
        if box:
            disparity_px[BOX] = NEAR_PX
            left[BOX] = (0, 0, 255)
        image: ByteImage = np.clip(np.rint(left), 0, 255).astype(np.uint8)
        cloud = triangulate(disparity_px, sigma_px, self.validity, RIG, ChainConfig().cloud)
        return Reconstruction(
            image, image, Match(disparity_px, sigma_px, self.validity),
            Filtered(disparity_px, sigma_px, self.validity, 1, 0.0), cloud,
            RangeChoice(SearchRange(0, 64)),
        )  # fmt: skip


def stored(folder: Path, frames: list[Reconstruction]) -> MeasuredFolder:
    return store_frames(folder, RIG, frames)


def rms(values: FloatArray | FloatImage) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def naive(values: FloatImage, sigma: float) -> tuple[float, int]:
    """Return mean and number of the largest group of values that agree within 3 sigma."""
    groups = [values[(values >= low) & (values <= low + 6 * sigma)] for low in np.sort(values)]
    best = max(groups, key=len)
    middle = np.sort(best)[len(best) // 2]
    kept = best[np.abs(best - middle) <= 3 * sigma]
    return float(kept.mean()), len(kept)


def test_groups_are_those_of_the_naive_twin() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(10, 0.1, (9, 4, 50)).astype(np.float32)
    odd = rng.uniform(size=values.shape) < 0.3
    values[odd] += rng.choice([-6.0, 6.0, 7.0], odd.sum())
    values[rng.uniform(size=values.shape) < 0.1] = np.nan
    found = average(values, np.full_like(values, 0.1))
    for row, column in np.ndindex(4, 50):
        some = values[:, row, column]
        some = some[np.isfinite(some)]
        mean, agreeing = naive(some, 0.1)
        assert found.agreeing[row, column] == agreeing
        assert found.count[row, column] == len(some)
        assert found.disparity_px[row, column] == pytest.approx(mean, abs=1e-4)


def test_random_errors_fall_with_the_number_and_sigma_says_what_is_left(tmp_path: Path) -> None:
    scene = Scene()
    frames = [scene.frame() for _ in range(64)]
    measured = scene.validity == Validity.MEASURED
    for count in (4, 16, 64):
        output = tmp_path / f'merged{count}'
        text = merge_over_time(stored(tmp_path / f'{count}', frames[:count]), output)
        assert text.startswith(f'{count} frames are one in {output}: ')
        merged = MeasuredFolder(output).frame(0)
        assert np.mean(merged.measured == measured) > 0.999
        known = measured & merged.measured
        error = (merged.disparity_px - TRUTH)[known]
        random = error - scene.systematic[known]
        assert rms(random) == pytest.approx(RANDOM_PX / np.sqrt(count), rel=0.1)
        sigma_px = merged.sigma_px[known]
        left = np.hypot(SYSTEMATIC_PX, RANDOM_PX / np.sqrt(count))
        assert np.median(sigma_px) == pytest.approx(left, rel=0.05)
        assert 0.9 < rms(error / sigma_px) < 1.1
        # what is guessed alike in every frame does not become better
        filled_px = merged.sigma_px[~measured]
        assert np.median(filled_px) == pytest.approx(np.hypot(SYSTEMATIC_PX, RANDOM_PX), rel=0.01)
        assert (merged.validity[~measured] == scene.validity[0, 0]).all()
    entry = MeasuredFolder(output).summary['frames'][0]
    assert (entry['frames'], entry['stamp_ns'], entry['index']) == (64, 1000, 0)
    assert (output / '000000.ply').stat().st_size > 10_000


def test_what_moves_through_the_scene_vanishes(tmp_path: Path) -> None:
    scene = Scene(2)
    # most of the box covers pixels that no frame can match without it
    scene.validity[BOX] = Validity.FILLED | Validity.LOW_TEXTURE
    frames = [scene.frame(box=k in (1, 4)) for k in range(7)]
    for k in (1, 4):
        frames[k].filtered.validity[BOX] = Validity.MEASURED
    report: list[str] = []
    merge_over_time(stored(tmp_path / 'in', frames), tmp_path / 'out', report=report.append)
    merged = MeasuredFolder(tmp_path / 'out').frame(0)
    assert not report
    assert np.abs(merged.disparity_px - TRUTH)[BOX].max() < 0.7
    still = np.mean([scene.frame().left[BOX].astype(float) for _ in range(9)], axis=0)
    assert np.abs(merged.left_bgr[BOX] - still).max() < 8
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert summary['merged']['frames'] == 7 and summary['merged']['disputed'] < 0.002
    # the cloud says that five of the seven frames saw what is behind the box
    vertices = read_ply(tmp_path / 'out' / '000000.ply')[0][:]
    count = vertices['scalar_count']
    assert count.max() == 7 and np.mean(count >= 5) > 0.999
    hidden = merged.disparity_px[BOX].size
    assert np.count_nonzero(count <= 5) == pytest.approx(hidden, rel=0.05)


def test_a_frame_after_a_knock_is_left_out_and_a_moving_rig_refused(tmp_path: Path) -> None:
    scene = Scene(3)
    frames = [scene.frame(shift=3 if k == 0 else 0) for k in range(5)]
    report: list[str] = []
    folder = stored(tmp_path / 'knock', frames)
    merge_over_time(folder, tmp_path / 'out', report=report.append)
    (line,) = report
    assert line.startswith('frame 0 is left out: its image is shifted by 3.0 px')
    assert MeasuredFolder(tmp_path / 'out').summary['merged']['left_out'] == [0]
    moving = stored(tmp_path / 'moving', [scene.frame(shift=k) for k in range(5)])
    with pytest.raises(MeasurementError, match='the camera moved: of 5 images 4 are shifted'):
        merge_over_time(moving, tmp_path / 'out')
    # earlier results stay
    assert MeasuredFolder(tmp_path / 'out').frame(0).measured.any()


def test_a_scene_that_moves_as_a_whole_is_refused(tmp_path: Path) -> None:
    scene = Scene(4)
    frames = [scene.frame() for _ in range(4)]
    for k, frame in enumerate(frames):
        frame.filtered.disparity_px[:] += 3 * k
    with pytest.raises(MeasurementError, match='100% of the measured pixels have values that do'):
        merge_over_time(stored(tmp_path / 'in', frames), tmp_path / 'out')
    assert not (tmp_path / 'out' / '000000.ply').exists()


def test_folders_that_cannot_be_merged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = Scene(5)
    one = stored(tmp_path / 'one', [scene.frame()])
    with pytest.raises(MeasurementError, match='holds 1 frame; at least 2'):
        merge_over_time(one, tmp_path / 'out')
    two = stored(tmp_path / 'two', [scene.frame() for _ in range(2)])
    with pytest.raises(ConfigError, match='choose another folder'):
        merge_over_time(two, tmp_path / 'two')
    other = json.loads((tmp_path / 'two' / 'summary.json').read_text())
    calibration = json.loads(json.dumps(other['calibration']))
    calibration['right']['P'][0][3] *= 2
    other['frames'][1]['calibration'] = calibration
    (tmp_path / 'two' / 'summary.json').write_text(json.dumps(other))
    with pytest.raises(MeasurementError, match=r'frame 1 of .* has another calibration'):
        merge_over_time(MeasuredFolder(tmp_path / 'two'), tmp_path / 'out')
    damaged = stored(tmp_path / 'damaged', [scene.frame() for _ in range(3)])
    path = tmp_path / 'damaged' / '000002_disparity.pfm'
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(FileError, match=r'000002_disparity\.pfm is damaged'):
        merge_over_time(damaged, tmp_path / 'out')
    assert main(['merge', str(tmp_path / 'none'), '--output', str(tmp_path / 'out')]) == 1
    assert 'summary.json' in capsys.readouterr().err


def test_rows_of_a_disparity_map_are_read_alone(tmp_path: Path) -> None:
    folder = stored(tmp_path, [Scene(6).frame()])
    whole = read_pfm(tmp_path / '000000_disparity.pfm')
    np.testing.assert_array_equal(folder.disparity_px(0, slice(7, 30)), whole[7:30])
