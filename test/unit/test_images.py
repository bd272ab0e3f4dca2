# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from binocular_recon.errors import ImageError
from binocular_recon.images import to_bgr8, to_grey
from binocular_recon.inputs.levels import Levels


def test_luminance_is_rec_601_and_not_rounded() -> None:
    bgr = np.array([[[10, 20, 30], [255, 255, 255]]], np.uint8)
    expected = [[0.114 * 10 + 0.587 * 20 + 0.299 * 30, 255]]
    np.testing.assert_allclose(to_grey(bgr), expected, atol=1e-3)
    bgra = np.dstack([bgr, np.full((1, 2, 1), 7, np.uint8)])
    np.testing.assert_allclose(to_grey(bgra), expected, atol=1e-3)
    assert to_grey(bgr).dtype == np.float32


def test_each_type_has_its_white() -> None:
    np.testing.assert_allclose(to_grey(np.array([[0, 65535, 257]], np.uint16)), [[0, 255, 1]])
    np.testing.assert_allclose(to_grey(np.array([[0, 1, 0.5]])), [[0, 255, 127.5]])
    np.testing.assert_array_equal(to_grey(np.array([[[0], [9]]], np.uint8)), [[0, 9]])


def test_no_data_stays_no_data() -> None:
    image = np.array([[0.5, np.nan, np.inf, -np.inf]], np.float32)
    np.testing.assert_array_equal(to_grey(image), [[127.5, np.nan, np.nan, np.nan]])
    np.testing.assert_array_equal(to_bgr8(image)[0, :, 0], [128, 0, 0, 0])


def test_colour_for_display() -> None:
    bgr = np.array([[[10, 20, 30]]], np.uint8)
    assert to_bgr8(bgr) is bgr
    sixteen = bgr.astype(np.uint16) * 257
    np.testing.assert_array_equal(to_bgr8(sixteen, Levels(0, 65535)), bgr)
    np.testing.assert_array_equal(to_bgr8(np.array([[7]], np.uint8)), [[[7, 7, 7]]])
    np.testing.assert_array_equal(to_bgr8(np.array([[[1, 2, 3, 0]]], np.uint8)), [[[1, 2, 3]]])


@pytest.mark.parametrize(
    ('image', 'message'),
    [
        (np.zeros((4, 4, 2), np.uint8), r'shape \(4, 4, 2\)'),
        (np.zeros((0, 4), np.uint8), r'shape \(0, 4\)'),
        (np.zeros(4, np.uint8), r'shape \(4,\)'),
        (np.zeros((4, 4), np.int32), 'type int32; convert it to one of uint8, uint16'),
    ],
)
def test_other_images_are_refused(image: np.ndarray, message: str) -> None:
    for convert in (to_grey, to_bgr8):
        with pytest.raises(ImageError, match=message):
            convert(image)
