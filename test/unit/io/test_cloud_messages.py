# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import array
from types import SimpleNamespace

import numpy as np
import pytest

from binocular_recon.io.messages.clouds import fill_cloud
from binocular_recon.stereo.triangulation import Cloud


@pytest.mark.parametrize(
    ('colour', 'padding', 'step', 'offsets'),
    [
        (True, True, 32, {'sigma_z': 20, 'sigma_x': 24, 'sigma_y': 28, 'validity': 12}),
        (True, False, 32, {'sigma_z': 16, 'sigma_x': 20, 'sigma_y': 24, 'validity': 28}),
        (False, True, 28, {'sigma_z': 12, 'sigma_x': 16, 'sigma_y': 20, 'validity': 24}),
        (False, False, 28, {'sigma_z': 12, 'sigma_x': 16, 'sigma_y': 20, 'validity': 24}),
    ],
)
def test_sigmas_with_the_share_of_the_calibration(
    colour: bool, padding: bool, step: int, offsets: dict[str, int]
) -> None:
    rng = np.random.default_rng(8)
    points, sigma = rng.normal(size=(2, 3, 5, 3)).astype(np.float32)
    validity = rng.integers(0, 9, (3, 5)).astype(np.uint8)
    bgr = np.zeros((3, 5, 3), np.uint8)
    message = SimpleNamespace(data=array.array('B'))
    fill_cloud(
        message, Cloud(points, sigma), None, SimpleNamespace, colour=bgr if colour else None,
        validity=validity, padding=padding,
    )  # fmt: skip
    offsets = {'x': 0, 'y': 4, 'z': 8, **offsets}
    if colour:
        offsets['rgb'] = 16 if padding else 12
    assert message.point_step == step
    assert {field.name: field.offset for field in message.fields} == offsets
    formats = ['<u4' if name in {'rgb', 'validity'} else '<f4' for name in offsets]
    layout = np.dtype(
        {
            'names': list(offsets),
            'formats': formats,
            'offsets': list(offsets.values()),
            'itemsize': step,
        }
    )
    read = np.frombuffer(message.data, layout).reshape(3, 5)
    for axis, name in enumerate('xyz'):
        np.testing.assert_array_equal(read[name], points[..., axis])
        np.testing.assert_array_equal(read[f'sigma_{name}'], sigma[..., axis])
    np.testing.assert_array_equal(read['validity'], validity)


@pytest.mark.parametrize(
    ('colour', 'padding', 'step', 'offsets'),
    [
        (True, True, 32, {'x': 0, 'y': 4, 'z': 8, 'rgb': 16, 'sigma_z': 20}),
        (True, False, 20, {'x': 0, 'y': 4, 'z': 8, 'rgb': 12, 'sigma_z': 16}),
        (False, True, 16, {'x': 0, 'y': 4, 'z': 8, 'sigma_z': 12}),
        (False, False, 16, {'x': 0, 'y': 4, 'z': 8, 'sigma_z': 12}),
    ],
)
def test_organised_cloud(colour: bool, padding: bool, step: int, offsets: dict[str, int]) -> None:
    generator = np.random.default_rng(4)
    points = generator.normal(size=(3, 5, 3)).astype(np.float32)
    sigma = generator.random((3, 5)).astype(np.float32)
    bgr = generator.integers(0, 256, (3, 5, 3)).astype(np.uint8)
    header = SimpleNamespace(frame_id='left')
    message = SimpleNamespace(data=array.array('B'))
    cloud = Cloud(points, sigma[..., None])
    fill_cloud(
        message, cloud, header, SimpleNamespace, colour=bgr if colour else None, padding=padding
    )
    assert (message.height, message.width) == (3, 5) and message.header is header
    assert (message.point_step, message.row_step) == (step, 5 * step)
    assert message.is_dense and not message.is_bigendian
    assert {field.name: field.offset for field in message.fields} == offsets
    assert {(field.datatype, field.count) for field in message.fields} == {(7, 1)}
    # read by name, as any consumer does
    names = list(offsets)
    formats = ['<u4' if name == 'rgb' else '<f4' for name in names]
    layout = np.dtype(
        {'names': names, 'formats': formats, 'offsets': list(offsets.values()), 'itemsize': step}
    )
    read = np.frombuffer(message.data, layout).reshape(3, 5)
    for axis, name in enumerate('xyz'):
        np.testing.assert_array_equal(read[name], points[..., axis])
    np.testing.assert_array_equal(read['sigma_z'], sigma)
    if colour:
        red = read['rgb'] >> 16 & 255
        np.testing.assert_array_equal(red, bgr[..., 2])
        np.testing.assert_array_equal(read['rgb'] & 255, bgr[..., 0])
    points[1, 1] = np.nan
    fill_cloud(message, cloud, header, SimpleNamespace)
    assert message.is_dense is False


def test_a_message_that_is_filled_again_keeps_nothing_of_the_cloud_before() -> None:
    """Nor its memory, if somebody still looks at it and the size changes."""
    message = SimpleNamespace(data=array.array('B'))
    large, small = (
        Cloud(np.full((2, width, 3), 1.5, np.float32), np.full((2, width, 1), 0.5, np.float32))
        for width in (3, 2)
    )
    bits = np.full((2, 3), 7, np.uint8)
    colour = np.full((2, 3, 3), 9, np.uint8)
    fill_cloud(message, large, None, SimpleNamespace, colour=colour, validity=bits)
    again = SimpleNamespace(data=array.array('B'))
    for one in (message, again):
        fill_cloud(one, large, None, SimpleNamespace, colour=colour)
    assert message.data == again.data
    view = np.frombuffer(message.data, np.uint8)
    before = view.copy()
    fill_cloud(message, small, None, SimpleNamespace)
    assert len(message.data) == 2 * 2 * 16
    np.testing.assert_array_equal(view, before)
