# SPDX-License-Identifier: Apache-2.0
"""The files of each frame, and what happens to those of an earlier run."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from binocular_recon.apps.frame_formats import FRAME_FORMATS, FrameFormat, FrameResult
from binocular_recon.apps.output_folder import ResultFolder
from binocular_recon.camera import Camera, StereoRig
from binocular_recon.cloud_config import CloudConfig
from binocular_recon.config import ChainConfig
from binocular_recon.errors import ConfigError, FileError
from binocular_recon.images import FloatImage
from binocular_recon.io.pfm import read_pfm
from binocular_recon.stereo.diagnosis import Findings
from binocular_recon.stereo.filtering.wls_filter import Filtered
from binocular_recon.stereo.matching.matcher import Match
from binocular_recon.stereo.pipeline import Reconstruction
from binocular_recon.stereo.row_check import RowOffset
from binocular_recon.stereo.search_range import RangeChoice, SearchRange
from binocular_recon.stereo.triangulation import triangulate
from binocular_recon.stereo.validity import Validity
from test import bag_tools
from test.frame_results import add_frame

RIG = bag_tools.rig()
ALWAYS = {
    '.ply', '_disparity.pfm', '_sigma.pfm', '_disparity.png', '_validity.png', '_left.png',
}  # fmt: skip


def reconstruction(disparity: float = 10.0) -> Reconstruction:
    """Return a flat wall without the first column."""
    disparity_px = np.full((bag_tools.HEIGHT, bag_tools.WIDTH), disparity, np.float32)
    disparity_px[:, 0] = np.nan
    sigma_px = np.full_like(disparity_px, 0.1)
    measured = np.where(np.isnan(disparity_px), 0, Validity.MEASURED).astype(np.uint8)
    return Reconstruction(
        *bag_tools.image_pair(0),
        Match(disparity_px, sigma_px, measured),
        Filtered(disparity_px, sigma_px, measured, 1, 0.0),
        triangulate(disparity_px, sigma_px, measured, RIG, ChainConfig().cloud),
        RangeChoice(SearchRange(0, 64)),
    )


def run(folder: Path, frames: int, *formats: str) -> ResultFolder:
    """Write frames and the summary as a command does."""
    results = ResultFolder(folder, {}, formats=formats)
    for index in range(frames):
        add_frame(results, index, RIG, reconstruction())
    results.write_summary(finished=True)
    return results


def files_of(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} - {'summary.json', 'frames.jsonl'}


def expected(frames: int, endings: set[str]) -> set[str]:
    return {f'{index:06d}{ending}' for index in range(frames) for ending in endings}


def test_rows_that_too_few_points_show_are_no_number_of_the_summary(tmp_path: Path) -> None:
    results = ResultFolder(tmp_path, {})
    findings = (Findings(RowOffset(points=3)), Findings(RowOffset(0.25, 0.3, 90)))
    for found in findings:
        add_frame(results, 0, RIG, dataclasses.replace(reconstruction(), findings=found))
    results.write_summary(finished=True)
    frames = json.loads((tmp_path / 'summary.json').read_text())['frames']
    assert [frame.get('row_offset_px') for frame in frames] == [None, 0.25]


def test_every_format_needs_parts_that_a_frame_has() -> None:
    endings = [spec.ending for spec in FRAME_FORMATS.values()]
    assert len(set(endings)) == len(endings)
    frame = FrameResult.of(reconstruction(), RIG, RIG)
    for spec in FRAME_FORMATS.values():
        assert all(hasattr(frame, name) for name in spec.needs)


def test_the_cloud_is_thinned_and_says_its_frame(tmp_path: Path) -> None:
    turn = cv2.Rodrigues(np.deg2rad([0.0, 0.65, 0.0]))[0]
    left, right = (dataclasses.replace(camera, R=turn) for camera in (RIG.left, RIG.right))
    whole = reconstruction()
    wall = dataclasses.replace(whole, thinning=CloudConfig(decimation=2))
    results = ResultFolder(tmp_path, {})
    add_frame(results, 0, StereoRig(left, right), wall)
    results.write_summary(finished=True)
    summary = json.loads((tmp_path / 'summary.json').read_text())
    text = "turned by 0.650 deg against the camera's (170 mm at 15 m); x_rectified = R x_camera"
    assert summary['frame'] == f'left rectified optical frame: {text}'
    header = (tmp_path / '000000.ply').read_bytes().partition(b'end_header')[0].decode()
    assert f'comment this frame is {text}' in header
    valid = np.isfinite(whole.cloud.depth_m)[::2, ::2]
    assert summary['frames'][0]['points'] == valid.sum()
    assert f'element vertex {valid.sum()}\n' in header


def test_a_registered_format_is_written_and_removed_with_its_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write_depth(path: Path, disparity_px: FloatImage, rig: StereoRig) -> None:
        depth_m = rig.focal_px * rig.baseline_m / np.nanmean(disparity_px)
        path.write_text(f'{depth_m:.3f}')

    spec = FrameFormat('_depth.txt', ('disparity_px', 'rig'), write_depth)
    monkeypatch.setitem(FRAME_FORMATS, 'depth', spec)
    run(tmp_path, 3)
    assert files_of(tmp_path) == expected(3, {*ALWAYS, '_depth.txt'})
    assert (tmp_path / '000002_depth.txt').read_text() == '4.000'
    run(tmp_path, 2)
    assert files_of(tmp_path) == expected(2, {*ALWAYS, '_depth.txt'})


def test_a_format_on_request_is_written_when_asked_for_and_removed_when_not(
    tmp_path: Path,
) -> None:
    run(tmp_path, 2, 'drawing')
    assert files_of(tmp_path) == expected(2, {*ALWAYS, '_cloud.png'})
    run(tmp_path, 2)
    assert files_of(tmp_path) == expected(2, ALWAYS)


def test_a_frame_that_cannot_be_written_leaves_no_file_and_no_entry(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(path: Path) -> None:
        path.write_text('part')
        raise FileError(f'{path.name} cannot be written: the disk is full')

    run(tmp_path, 1)
    before = (tmp_path / '000000_disparity.pfm').read_bytes()
    monkeypatch.setitem(FRAME_FORMATS, 'failing', FrameFormat('_x.txt', (), fail))
    results = ResultFolder(tmp_path, {})
    with pytest.raises(FileError, match=r'000000_x\.txt cannot be written'):
        add_frame(results, 0, RIG, reconstruction(20.0))
    assert results.frames == []
    results.close()
    assert files_of(tmp_path) == expected(1, ALWAYS)
    assert (tmp_path / '000000_disparity.pfm').read_bytes() == before


def test_an_unknown_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"must be among disparity, .*drawing, .*got 'obj'"):
        ResultFolder(tmp_path / 'new', {}, formats=['obj'])
    assert not (tmp_path / 'new').exists()


def test_files_of_others_are_kept(tmp_path: Path) -> None:
    for name in ('000005_notes.txt', '00001.ply', 'mine.ply'):
        (tmp_path / name).write_text('mine')
    run(tmp_path, 1)
    assert files_of(tmp_path) == expected(1, ALWAYS) | {
        '000005_notes.txt',
        '00001.ply',
        'mine.ply',
    }


def test_the_summary_describes_the_frames(tmp_path: Path) -> None:
    results = ResultFolder(tmp_path, {'source': {'bag': 'b'}, 'preset': 'fast'})
    add_frame(results, 7, RIG, reconstruction())
    camera = RIG.right
    P = camera.P * np.array([1, 1, 1, 0.5])
    other = StereoRig(RIG.left, Camera(*camera.size, camera.K, camera.D, camera.R, P))
    add_frame(results, 8, other, reconstruction(), 1.5)
    results.leave_out(9, 'too dark')
    results.write_summary(finished=False, unpaired=3)
    summary = json.loads((tmp_path / 'summary.json').read_text())
    first, second = summary['frames']
    pixels = bag_tools.HEIGHT * bag_tools.WIDTH
    assert first['density'] == pytest.approx(1 - 1 / bag_tools.WIDTH)
    assert first['points'] == pixels - bag_tools.HEIGHT
    assert first['depth_m'] == {'min': 4.0, 'median': 4.0, 'max': 4.0}
    assert 'calibration' not in first
    assert second['calibration']['baseline_m'] == pytest.approx(0.25)
    assert summary['calibration']['baseline_m'] == pytest.approx(0.5)
    assert summary['left_out'] == [{'stamp_ns': 9, 'reason': 'too dark'}]
    assert (summary['finished'], summary['unpaired'], summary['preset']) == (False, 3, 'fast')
    assert results.sentence() == (
        f'2 frames in {tmp_path}: 99.0% of the pixels measured, 99.0% with a'
        ' disparity; points from 4.00 to 4.00 m (median 4.00 m),'
        ' 1.00 s per frame; baseline 0.5 m, focal length 80 px, searched from 0.635 m to infinity'
    )
    np.testing.assert_array_equal(
        read_pfm(tmp_path / '000000_disparity.pfm'), reconstruction().filtered.disparity_px
    )
