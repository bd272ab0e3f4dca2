# SPDX-License-Identifier: Apache-2.0
"""Heat maps."""

import numpy as np

from binocular_recon.drawing.colormap import heat_map


def test_none_is_black_and_nothing_else_is() -> None:
    disparity_px = np.linspace(-5, 300, 1000, dtype=np.float32).reshape(20, 50)
    disparity_px[4, 7] = np.nan
    disparity_px[9, 3] = np.inf
    black = (heat_map(disparity_px, (10.0, 200.0)) == 0).all(axis=-1)
    assert np.argwhere(black).tolist() == [[4, 7], [9, 3]]


def test_near_is_red_and_far_is_blue() -> None:
    image = heat_map(np.array([[20.0, 60.0, 100.0]], np.float32), (0.0, 120.0)).astype(int)
    blue, green, red = image[0].T
    assert blue[0] > red[0]
    assert green[1] == image[0].max()
    assert red[2] > blue[2]


def test_limits_fix_the_colours_whatever_else_is_in_the_map() -> None:
    one = heat_map(np.array([[50.0, 60.0]], np.float32), (0.0, 100.0))
    other = heat_map(np.array([[50.0, 99.0]], np.float32), (0.0, 100.0))
    np.testing.assert_array_equal(one[0, 0], other[0, 0])


def test_own_limits_ignore_single_outliers() -> None:
    disparity_px = np.linspace(40, 50, 10_000, dtype=np.float32).reshape(100, 100)
    with_outlier = disparity_px.copy()
    with_outlier[0, 0] = 4000.0
    difference = heat_map(disparity_px).astype(int) - heat_map(with_outlier)
    assert np.abs(difference[1:]).max() <= 8


def test_a_map_without_any_value_is_black() -> None:
    assert heat_map(np.full((3, 4), np.nan, np.float32)).tolist() == np.zeros((3, 4, 3)).tolist()
