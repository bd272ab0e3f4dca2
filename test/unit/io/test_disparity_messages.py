# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.errors import CalibrationError, ImageError
from binocular_recon.io.messages.disparities import fill_disparity, read_disparity
from test import stereo_image_proc

FOCAL_PX, BASELINE_M = 994.0, 0.193
OFFSETS_PX = [-32.8, 0.0, 32.8, -32.0, 7.25]
HEADER = SimpleNamespace(frame_id='left')


def rig(offset_px: float) -> StereoRig:
    """Return a rig with cx_left - cx_right = offset_px."""
    P = np.array([[FOCAL_PX, 0, 311, 0], [0, FOCAL_PX, 254, 0], [0, 0, 1, 0]])
    shift = np.array([[0, 0, -offset_px, -FOCAL_PX * BASELINE_M], [0] * 4, [0] * 4])
    left, right = (Camera(64, 48, p[:, :3], np.zeros(5), np.eye(3), p) for p in (P, P + shift))
    return StereoRig(left, right)


def blank() -> SimpleNamespace:
    window = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)
    return SimpleNamespace(image=SimpleNamespace(data=np.zeros(0, np.uint8)), valid_window=window)


def ours(raw: np.ndarray, offset_px: float, limits_px: tuple[float, float]) -> Any:
    message = blank()
    fill_disparity(message, raw, rig(offset_px), limits_px, HEADER, step_px=0.25)
    return message


def theirs(raw: np.ndarray, offset_px: float, limits_px: tuple[int, int]) -> Any:
    message = blank()
    stereo_image_proc.fill(message, raw, rig(offset_px), limits_px)
    return message


def values_of(message: Any) -> np.ndarray:
    shape = message.image.height, message.image.width
    return np.frombuffer(message.image.data, np.float32).reshape(shape)


def raw_map(limits_px: tuple[float, float], *, holes: bool, seed: int = 3) -> np.ndarray:
    generator = np.random.default_rng(seed)
    raw = generator.uniform(*limits_px, (48, 64)).astype(np.float32)
    if holes:
        raw[generator.random(raw.shape) < 0.3] = np.nan
    return raw


@pytest.mark.parametrize('holes', [False, True])
@pytest.mark.parametrize('offset_px', OFFSETS_PX)
def test_message_follows_the_published_definition(offset_px: float, holes: bool) -> None:
    raw = raw_map((0, 63), holes=holes)
    raw[4, 5], raw[4, 6] = 0.0, 63.0  # at the limits
    message = ours(raw, offset_px, (0, 63))
    values = values_of(message)
    low, high = np.float32(message.min_disparity), np.float32(message.max_disparity)
    assert low == pytest.approx(0 - offset_px) and high == pytest.approx(63 - offset_px)
    valid = ~np.isnan(raw)
    assert ((values > low) & (values < high))[valid].all()
    assert (values[~valid] == low - np.float32(1)).all()
    np.testing.assert_allclose(values[valid], raw[valid] - offset_px, atol=1e-4)
    assert (message.f, message.t, message.delta_d) == pytest.approx((FOCAL_PX, BASELINE_M, 0.25))
    assert message.header is HEADER and message.image.header is HEADER


@pytest.mark.parametrize('holes', [False, True])
@pytest.mark.parametrize('offset_px', OFFSETS_PX)
def test_own_message_comes_back(offset_px: float, holes: bool) -> None:
    for limits_px in ((0, 63), (-20, 43), (16, 79)):
        raw = raw_map(limits_px, holes=holes)
        read = read_disparity(ours(raw, offset_px, limits_px), rig(offset_px))
        np.testing.assert_allclose(read.disparity_px, raw, atol=1e-4)
        assert read.limits_px == pytest.approx(limits_px, abs=1e-4)


@pytest.mark.parametrize('holes', [False, True])
@pytest.mark.parametrize('offset_px', OFFSETS_PX)
def test_message_of_stereo_image_proc(offset_px: float, holes: bool) -> None:
    for limits_px in ((0, 63), (-20, 43), (16, 79)):
        raw = stereo_image_proc.in_sixteenths(raw_map(limits_px, holes=holes))
        raw[0, :2] = limits_px[0], limits_px[1]
        read = read_disparity(theirs(raw, offset_px, limits_px), rig(offset_px))
        np.testing.assert_allclose(read.disparity_px, raw, atol=1e-4)
        assert read.limits_px == pytest.approx(limits_px)


@pytest.mark.parametrize('offset_px', OFFSETS_PX)
def test_message_of_stereo_image_proc_without_near_or_far_things(offset_px: float) -> None:
    """Values that both conventions would accept: only limits and marker tell them apart."""
    for span in ((33.0, 40.0), (1.0, 12.0), (50.0, 63.0)):
        raw = stereo_image_proc.in_sixteenths(raw_map(span, holes=True))
        read = read_disparity(theirs(raw, offset_px, (0, 63)), rig(offset_px))
        np.testing.assert_allclose(read.disparity_px, raw, atol=1e-4)


@pytest.mark.parametrize('far_px', [0.0, 33.0])
@pytest.mark.parametrize('holes', [False, True])
@pytest.mark.parametrize('offset_px', [-32.8, -32.0])
def test_own_valid_pixel_at_the_other_marker_is_kept(
    offset_px: float, holes: bool, far_px: float
) -> None:
    """What would be stereo_image_proc's marker is an ordinary disparity in our messages."""
    if offset_px == -32.0 and far_px > 0 and not holes:
        far_px = 31.0  # both would explain the whole image: any farther pixel settles it
    raw = raw_map((far_px, 63), holes=holes)
    raw[10, 10:13] = -offset_px - 1 + np.array([-1 / 33, 0, 1 / 33])
    raw[20, 20] = far_px
    read = read_disparity(ours(raw, offset_px, (0, 63)), rig(offset_px))
    np.testing.assert_allclose(read.disparity_px, raw, atol=1e-4)


def test_depth_of_the_message_is_that_of_the_rig() -> None:
    for offset_px in OFFSETS_PX:
        depth_m = np.array([[4.0, 7.5]], np.float32)
        raw = (FOCAL_PX * BASELINE_M / depth_m + offset_px).astype(np.float32)
        message = ours(raw, offset_px, (-64, 127))
        z = message.f * message.t / values_of(message)
        np.testing.assert_allclose(z, depth_m, rtol=1e-5)


def test_window_of_valid_pixels() -> None:
    raw = np.full((48, 64), np.nan, np.float32)
    message = ours(raw, 0.0, (0, 63))
    assert vars(message.valid_window) == {'x_offset': 0, 'y_offset': 0, 'width': 0, 'height': 0}
    raw[3, 8] = raw[10, 5] = 7.0
    message = ours(raw, 0.0, (0, 63))
    assert vars(message.valid_window) == {'x_offset': 5, 'y_offset': 3, 'width': 4, 'height': 8}


def test_not_a_number_is_no_disparity() -> None:
    message = theirs(raw_map((0, 63), holes=False), -32.8, (0, 63))
    values = values_of(message).copy()
    values[0, :3] = np.nan, np.inf, -np.inf
    message.image.data = values.tobytes()
    read = read_disparity(message, rig(-32.8)).disparity_px
    assert np.isnan(read[0, :3]).all() and np.isfinite(read).sum() == read.size - 3


@pytest.mark.parametrize(
    ('member', 'value', 'error', 'text'),
    [
        ('f', 900.0, CalibrationError, 'made with f = 900, the camera infos say 994'),
        ('t', 0.1, CalibrationError, r'made with t = 0\.1, the camera infos say 0\.193'),
        ('max_disparity', 0.0, ImageError, r'limits 0\.\.0 px; the sender must fill'),
        ('max_disparity', np.nan, ImageError, 'disparity has max_disparity = nan; the sender'),
        ('min_disparity', -np.inf, ImageError, 'disparity has min_disparity = -inf; the sender'),
        ('delta_d', np.inf, ImageError, 'disparity has delta_d = inf; the sender must fill it'),
        ('f', np.nan, ImageError, 'disparity has f = nan; the sender must fill it with a finite'),
        ('t', np.inf, ImageError, 'disparity has t = inf; the sender must fill it with a finite'),
    ],
)
def test_bad_message(member: str, value: float, error: type[Exception], text: str) -> None:
    message = theirs(raw_map((0, 63), holes=True), 0.0, (0, 63))
    setattr(message, member, value)
    with pytest.raises(error, match=text):
        read_disparity(message, rig(0.0))


def test_bad_image_in_the_message() -> None:
    message = theirs(raw_map((0, 63), holes=True), 0.0, (0, 63))
    message.image.encoding = '16UC1'
    with pytest.raises(ImageError, match="encoding '16UC1'; it must be 32FC1"):
        read_disparity(message, rig(0.0))
    message.image.encoding, message.image.data = '32FC1', bytes(7)
    with pytest.raises(ImageError, match='disparity holds 7 bytes'):
        read_disparity(message, rig(0.0))
