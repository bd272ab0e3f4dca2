# SPDX-License-Identifier: Apache-2.0
"""PFM files: layout byte by byte, round trip, damaged files."""

import struct
from pathlib import Path

import numpy as np
import pytest

from binocular_recon.errors import FileError
from binocular_recon.io.pfm import read_pfm, write_pfm


def test_layout_is_little_endian_rows_bottom_to_top_inf_for_none(tmp_path: Path) -> None:
    path = tmp_path / 'a.pfm'
    write_pfm(path, np.array([[1, 2, 3], [np.nan, 5, -6.5]], np.float32))
    assert path.read_bytes() == b'Pf\n3 2\n-1.0\n' + struct.pack(
        '<6f', float('inf'), 5, -6.5, 1, 2, 3
    )


def test_round_trip_keeps_every_bit_and_nan(tmp_path: Path) -> None:
    disparity_px = np.random.default_rng(1).normal(60, 40, (37, 53)).astype(np.float32)
    disparity_px[3, 4] = np.nan
    write_pfm(tmp_path / 'a.pfm', disparity_px)
    back = read_pfm(tmp_path / 'a.pfm')
    assert back.dtype == np.float32
    np.testing.assert_array_equal(back, disparity_px)


def test_big_endian_is_read_and_the_scale_is_not_applied(tmp_path: Path) -> None:
    path = tmp_path / 'big.pfm'
    path.write_bytes(b'Pf\n2 1\n0.003922\n' + struct.pack('>2f', 17.25, float('inf')))
    np.testing.assert_array_equal(read_pfm(path), np.array([[17.25, np.nan]], np.float32))


@pytest.mark.parametrize(
    ('content', 'message'),
    [
        (b'PF\n1 1\n-1\n' + bytes(12), 'three channels'),
        (b'\x89PNG\r\n\x1a\n' + bytes(400), 'not a PFM file'),
        (b'Pf\n0 4\n-1\n', 'not a PFM file'),
        (b'Pf\n3 two\n-1\n', 'not a PFM file'),
        (b'', 'not a PFM file'),
        (b'Pf\n3 2\ninf\n' + bytes(24), 'not a PFM file'),
        (b'Pf\n32766 32766\n-1\n' + bytes(24), 'need 4294443024 bytes, it has 24'),
        (b'Pf\n99999999999999999999 2\n-1\n', 'has at most 32766 px a side'),
        (b'Pf\n3 2\n-1\n' + bytes(23), '3x2 px need 24 bytes, it has 23'),
        (b'Pf\n3 2\n-1\n' + bytes(25), 'it has more'),
    ],
)
def test_damaged_files_are_named_with_what_is_wrong(
    tmp_path: Path, content: bytes, message: str
) -> None:
    path = tmp_path / 'bad.pfm'
    path.write_bytes(content)
    with pytest.raises(FileError, match=message) as caught:
        read_pfm(path)
    assert 'bad.pfm' in str(caught.value)


def test_missing_file_is_a_file_error(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r'gone\.pfm cannot be read: No such file'):
        read_pfm(tmp_path / 'gone.pfm')
