# SPDX-License-Identifier: Apache-2.0
"""Which image files belong together, and what is said where nothing tells."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from binocular_recon.errors import FileError
from binocular_recon.io.pairs.capture_times import capture_time_ns
from binocular_recon.io.pairs.file_lists import find_files
from binocular_recon.io.pairs.file_pairs import FilePairs, common_numbers, pair_files

GREY = np.zeros((4, 6), np.uint8)


def exif_block(time: str, fraction: str = '', zone: str = '', order: str = '<') -> bytes:
    """Return EXIF data with a time, laid out by hand after the standard."""
    texts = {0x9003: time, 0x9291: fraction, 0x9011: zone}
    entries = {tag: text.encode() + b'\0' for tag, text in texts.items() if text}
    start = 26  # of the EXIF directory: header 8, count 2, one entry 12, next 4
    body = start + 2 + 12 * len(entries) + 4
    head = struct.pack(order + '2sHIH', b'II' if order == '<' else b'MM', 42, 8, 1)
    head += struct.pack(order + 'HHII', 0x8769, 4, 1, start) + bytes(4)
    directory, data = struct.pack(order + 'H', len(entries)), b''
    for tag, text in sorted(entries.items()):
        inline = text.ljust(4, b'\0') if len(text) <= 4 else None
        value = inline or struct.pack(order + 'I', body + len(data))
        directory += struct.pack(order + 'HHI', tag, 2, len(text)) + value
        data += b'' if inline else text
    return head + directory + bytes(4) + data


def write_jpeg(path: Path, *exif: str) -> Path:
    data = cv2.imencode('.jpg', GREY)[1].tobytes()
    if exif:
        block = b'Exif\0\0' + exif_block(*exif)
        data = data[:2] + b'\xff\xe1' + struct.pack('>H', len(block) + 2) + block + data[2:]
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    return path


def touch(folder: Path, *names: str) -> list[Path]:
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / name).write_bytes(b'')
    return [folder / name for name in names]


def names_of(found: FilePairs) -> list[tuple[str, str]]:
    return [(pair.left.name, pair.right.name) for pair in found.pairs]


def test_times_of_exif_data(tmp_path: Path) -> None:
    noon_ns = 1_717_243_200 * 10**9  # 2024-06-01 12:00:00 UTC
    cases = [
        (('2024:06:01 12:00:00',), noon_ns),
        (('2024:06:01 12:00:00', '25'), noon_ns + 250_000_000),
        (('2024:06:01 14:00:00', '007', '+02:00'), noon_ns + 7_000_000),
        (('2024:06:01 12:00:00', '', '', '>'), noon_ns),
        (('not a time at all', '25'), None),
        ((), None),
    ]
    for exif, expected in cases:
        assert capture_time_ns(write_jpeg(tmp_path / 'a.jpg', *exif)) == expected
    whole = write_jpeg(tmp_path / 'b.jpg', '2024:06:01 12:00:00', '25').read_bytes()
    for end in range(0, len(whole), 7):  # cut off anywhere it is read or not, and nothing else
        (tmp_path / 'cut.jpg').write_bytes(whole[:end])
        assert capture_time_ns(tmp_path / 'cut.jpg') in (None, noon_ns, noon_ns + 250_000_000)
    (tmp_path / 'a.tif').write_bytes(exif_block('2024:06:01 12:00:00'))
    assert capture_time_ns(tmp_path / 'a.tif') == noon_ns
    assert capture_time_ns(tmp_path / 'none.jpg') is None


def test_the_number_that_tells_images_apart() -> None:
    assert common_numbers(['cam0_7_a2', 'cam0_8_a2'], ['cam1_8_a2', 'cam1_9_a2']) == (
        [7, 8],
        [8, 9],
    )
    # day and time of capture tell images apart too, but have nothing in common
    left, right = ['3_0901', '4_0902'], ['3_0911', '4_0912']
    assert common_numbers(left, right) == ([3, 4], [3, 4])
    assert common_numbers(['a', 'b'], ['1', '2']) is None
    assert common_numbers(['x1', 'y1'], ['1', '2']) is None


def test_what_tells_is_chosen_by_the_files_and_said(tmp_path: Path) -> None:
    left = touch(tmp_path / 'l', 'a_2.png', 'a_3.png', 'a_4.png', 'a_7.png', 'a_8.png', 'a_9.png')
    right = touch(tmp_path / 'r', 'b2.png', 'b3.png', 'b4.png', 'b7.png', 'b8.png', 'b10.png')
    by_number = pair_files(left, right)
    assert by_number.by == 'number'
    assert names_of(by_number)[::4] == [('a_2.png', 'b2.png'), ('a_8.png', 'b8.png')]
    assert [path.name for path in by_number.unpaired] == ['a_9.png', 'b10.png']
    assert by_number.remarks == [
        '5 pairs by the number in their names: a_2.png with b2.png to a_8.png with b8.png',
        '1 gap in the numbers, the first where a_4.png is followed by a_7.png',
        'warning: 2 images have no partner: l/a_9.png, r/b10.png',
    ]
    by_order = pair_files(
        touch(tmp_path / 'l', 'x.png', 'y.png'), touch(tmp_path / 'r', 'x.png', 'y.png')
    )
    assert by_order.by == 'order'
    assert by_order.pairs[0].stamp_ns is None
    # two files are a pair whatever they are called
    assert pair_files(left[:1], right[-1:]).by == 'order'


def test_times_pair_what_numbers_do_not(tmp_path: Path) -> None:
    left = [
        write_jpeg(tmp_path / 'l' / f'DSC_{100 + k}.jpg', f'2024:06:01 12:00:{5 * k:02d}', '10')
        for k in range(6)
    ]
    right = [
        write_jpeg(tmp_path / 'r' / f'P{k}.jpg', f'2024:06:01 12:00:{5 * k:02d}', '35')
        for k in (0, 1, 3, 4, 5)
    ]
    found = pair_files(left, right)
    assert found.by == 'time'
    assert [pair.left.name for pair in found.pairs] == [f'DSC_10{k}.jpg' for k in (0, 1, 3, 4, 5)]
    assert [pair.right.name for pair in found.pairs] == [path.name for path in right]
    assert found.unpaired == [left[2]]
    steps = np.diff([pair.stamp_ns or 0 for pair in found.pairs]) / 1e9
    np.testing.assert_array_equal(steps, [5, 10, 5, 5])
    # the order is contradicted by the times
    mixed = pair_files([*left[:2], *left[3:]], [*right[1:], right[0]], 'order')
    assert 'warning: by their EXIF times 2 pairs do not belong together' in mixed.remarks[-1]
    assert 'DSC_101.jpg and P3.jpg: 10.2 s apart, most are 5.2 s' in mixed.remarks[-1]
    with pytest.raises(FileError, match=r'agree to 0\.200 s: .*right is 250\.000 ms later'):
        pair_files(left, right, 'time', tolerance_ns=200_000_000)
    shifted = pair_files(left, right, 'time', tolerance_ns=200_000_000, offset_ns=-250_000_000)
    assert len(shifted.pairs) == 5


@pytest.mark.parametrize(
    ('left', 'right', 'by', 'match'),
    [
        (['a', 'b', 'c'], ['a', 'b'], None, 'left images: 3, right images: 2, and nothing tells'),
        (['1', '2', '3'], ['1', '2'], 'order', 'left images: 3, right images: 2, so their order'),
        (['1', '2'], ['3', '4'], 'number', r'no number in common \(1.png, 3.png\)'),
        (['a', 'b'], ['1', '2'], 'number', r'no number in common \(a.png, 1.png\)'),
        (['1', '2'], ['1', '2'], 'time', r'images without an EXIF time: l/1.png, l/2.png;'),
    ],
)
def test_files_that_cannot_be_paired(
    tmp_path: Path, left: list[str], right: list[str], by: str | None, match: str
) -> None:
    sides = [
        touch(tmp_path / folder, *(f'{name}.png' for name in names))
        for folder, names in (('l', left), ('r', right))
    ]
    with pytest.raises(FileError, match=match):
        pair_files(sides[0], sides[1], by)


def test_one_file_for_both_and_one_time_for_two(tmp_path: Path) -> None:
    files = touch(tmp_path, '1.png')
    with pytest.raises(FileError, match=r'1\.png is named for both cameras'):
        pair_files(files, files)
    left, right = (
        [write_jpeg(tmp_path / side / f'{k}.jpg', '2024:06:01 12:00:00') for k in (1, 2)]
        for side in ('l', 'r')
    )
    with pytest.raises(FileError, match=r'l/1\.jpg, l/2\.jpg have the same EXIF time'):
        pair_files(left, right, 'time')


def test_folders_patterns_and_files(tmp_path: Path) -> None:
    folder = tmp_path / 'images'
    touch(folder, 'a10.PNG', 'a9.png', '._a9.png', 'notes.txt', 'b1.jpeg')
    assert [path.name for path in find_files(str(folder), 'left')] == [
        'a9.png',
        'a10.PNG',
        'b1.jpeg',
    ]
    pattern = str(folder / 'a*.*')
    assert [path.name for path in find_files(pattern, 'left')] == ['a9.png', 'a10.PNG']
    assert find_files(str(folder / 'b1.jpeg'), 'left') == [folder / 'b1.jpeg']
    touch(tmp_path / 'text', 'a.txt')
    touch(tmp_path / 'film', 'b.mp4', 'a.mov')
    (tmp_path / 'empty').mkdir()
    for text, match in {
        tmp_path / 'empty': 'no images for the left camera: it is empty',
        tmp_path / 'text': r'1 other file \(\.txt\)',
        tmp_path / 'film': r'it has videos; give the file, such as .*a\.mov',
        folder / '*.tif': 'no file fits the pattern',
        folder / 'c.png': 'there is no such file',
        folder / '*': r'notes\.txt is not an image by its name',
    }.items():
        with pytest.raises(FileError, match=match):
            find_files(str(text), 'left')


def test_patterns_that_never_end_and_pipes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(6):
        (tmp_path / f'link{number}').symlink_to('.')
    touch(tmp_path, 'a.png')
    monkeypatch.setattr('binocular_recon.io.pairs.file_lists._MOST_NAMES', 1000)
    with pytest.raises(FileError, match=r'more than 1000 names fit the pattern, perhaps by links'):
        find_files(str(tmp_path / '*' / '*' / '*' / '*' / '*.png'), 'left')
    (tmp_path / 'deep').mkdir()
    touch(tmp_path / 'deep' / 'er', 'b.png')
    touch(tmp_path / '.thumbnails', 'c.png')
    wanted = [tmp_path / 'a.png', tmp_path / 'deep' / 'er' / 'b.png']
    assert find_files(str(tmp_path / '**' / '*.png'), 'left') == wanted  # no link is followed
    assert find_files(str(tmp_path / 'd*' / '**' / '***.png'), 'left') == wanted[1:]
    assert find_files(str(tmp_path / 'deep' / '**'), 'left') == wanted[1:]
    os.mkfifo(tmp_path / 'a.jpg')
    assert capture_time_ns(tmp_path / 'a.jpg') is None
