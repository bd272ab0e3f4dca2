# SPDX-License-Identifier: Apache-2.0
"""PLY files: header and vertices, read back without our own code."""

import struct
from pathlib import Path

import numpy as np

from binocular_recon.io.ply import write_ply
from binocular_recon.stereo.triangulation import Cloud


def test_valid_points_only_with_colour_and_sigma(tmp_path: Path) -> None:
    points = np.arange(18, dtype=np.float32).reshape(2, 3, 3)
    points[0, 1] = np.nan
    points[1, 2, 2] = np.inf
    sigma = np.linspace(0.1, 0.6, 6, dtype=np.float32).reshape(2, 3)
    validity = np.array([[1, 1, 2], [34, 1, 1]], np.uint8)
    bgr = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
    path = tmp_path / 'a.ply'

    frame = 'turned by 0.650 deg'
    assert write_ply(path, Cloud(points, sigma[..., None]), validity, bgr, frame=frame) == 4

    header, body = path.read_bytes().split(b'end_header\n')
    assert b'\ncomment this frame is turned by 0.650 deg\n' in header
    lines = [line for line in header.decode().splitlines() if not line.startswith('comment')]
    assert lines == [
        'ply',
        'format binary_little_endian 1.0',
        'element vertex 4',
        'property float x',
        'property float y',
        'property float z',
        'property uchar red',
        'property uchar green',
        'property uchar blue',
        'property float scalar_sigma_z',
        'property float scalar_validity',
    ]
    expected = [(0, 0), (0, 2), (1, 0), (1, 1)]
    assert len(body) == 23 * len(expected)
    for vertex, (row, column) in zip(struct.iter_unpack('<3f3B2f', body), expected, strict=True):
        assert vertex[:3] == tuple(points[row, column])
        assert vertex[3:6] == tuple(bgr[row, column, ::-1])
        assert vertex[6:] == (sigma[row, column], validity[row, column])


def test_sigmas_with_the_share_of_the_calibration(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    points = rng.normal(size=(2, 3, 3)).astype(np.float32)
    sigma = rng.random((2, 3, 3)).astype(np.float32)
    validity = np.ones((2, 3), np.uint8)
    bgr = np.zeros((2, 3, 3), np.uint8)
    for sigmas, share in ((sigma, 'matching and calibration'), (sigma[..., 2:], 'matching only')):
        cloud = Cloud(points, sigmas)
        write_ply(tmp_path / 'a.ply', cloud, validity, bgr)
        header, body = (tmp_path / 'a.ply').read_bytes().split(b'end_header\n')
        lines = header.decode().splitlines()
        assert any(line.startswith('comment') and share in line for line in lines)
        names = [line.split()[-1] for line in lines if 'property float scalar' in line]
        assert names == [f'scalar_{name}' for name in (*cloud.sigmas_m, 'validity')]
        vertices = np.frombuffer(body, f'(3,)<f4, (3,)u1, ({len(names)},)<f4')
        np.testing.assert_array_equal(vertices['f2'][:, :-1], sigmas.reshape(6, -1))


def test_a_cloud_without_points_is_a_valid_file(tmp_path: Path) -> None:
    points = np.full((2, 2, 3), np.nan, np.float32)
    zeros = np.zeros((2, 2), np.float32)
    bgr = np.zeros((2, 2, 3), np.uint8)
    count = write_ply(
        tmp_path / 'a.ply', Cloud(points, zeros[..., None]), zeros.astype(np.uint8), bgr
    )
    assert count == 0
    assert (tmp_path / 'a.ply').read_bytes().endswith(b'end_header\n')
