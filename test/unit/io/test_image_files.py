# SPDX-License-Identifier: Apache-2.0
"""Image files and 16-bit disparity files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from binocular_recon.errors import FileError
from binocular_recon.io.disparity_png import read_disparity_png, write_disparity_png
from binocular_recon.io.image_files import read_image_file, write_image_file

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    'image',
    [
        RNG.integers(0, 256, (9, 7), np.uint8),
        RNG.integers(0, 256, (9, 7, 3), np.uint8),
        RNG.integers(0, 256, (9, 7, 4), np.uint8),
        RNG.integers(0, 65536, (9, 7), np.uint16),
    ],
)
def test_depth_and_channels_are_kept(tmp_path: Path, image: npt.NDArray[np.uint8]) -> None:
    write_image_file(tmp_path / 'ä.png', image)
    back = read_image_file(tmp_path / 'ä.png')
    assert back.dtype == image.dtype
    np.testing.assert_array_equal(back, image)


def test_what_is_not_an_image_is_named(tmp_path: Path) -> None:
    for name, content in (('text.png', b'hello'), ('empty.png', b'')):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FileError, match=rf'{name} is not an image \({len(content)} bytes\)'):
            read_image_file(tmp_path / name)
    with pytest.raises(FileError, match=r'gone\.png cannot be read: No such file'):
        read_image_file(tmp_path / 'gone.png')
    with pytest.raises(FileError, match='is not a file; give a PNG'):
        read_image_file(tmp_path)


def test_a_name_that_stands_for_no_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"'\.xyz' is not a format for images of uint8; choose"):
        write_image_file(tmp_path / 'a.xyz', np.zeros((2, 2), np.uint8))
    assert list(tmp_path.iterdir()) == []


def test_disparity_png_rounds_to_a_256th_and_keeps_none(tmp_path: Path) -> None:
    disparity_px = RNG.uniform(0.01, 255, (40, 30)).astype(np.float32)
    disparity_px[2, 3] = np.nan
    write_disparity_png(tmp_path / 'd.png', disparity_px)
    back = read_disparity_png(tmp_path / 'd.png')
    assert back.dtype == np.float32
    np.testing.assert_allclose(back, disparity_px, atol=1 / 512 + 1e-5)
    assert np.argwhere(np.isnan(back)).tolist() == [[2, 3]]
    # KITTI's development kit: disparity = value / 256
    assert read_image_file(tmp_path / 'd.png')[0, 0] == round(float(disparity_px[0, 0]) * 256)


def test_an_8_bit_image_is_not_a_disparity_map(tmp_path: Path) -> None:
    write_image_file(tmp_path / 'd.png', np.zeros((4, 4), np.uint8))
    with pytest.raises(FileError, match='16-bit grey is needed, got uint8'):
        read_disparity_png(tmp_path / 'd.png')
