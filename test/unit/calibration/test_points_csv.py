# SPDX-License-Identifier: Apache-2.0
"""Tables of points from other detectors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from binocular_recon.calibration.session.points_csv import read_points
from binocular_recon.errors import CalibrationError, FileError
from test.calibration_tools import CHESSBOARD

HEAD = 'name,side,id,X_m,Y_m,u_px,v_px\n'


def written(folder: Path, text: str) -> Path:
    path = folder / 'points.csv'
    path.write_text(text)
    return path


def test_chessboard() -> None:
    table = read_points(CHESSBOARD)
    assert len(table.captures) == 13 and table.least_size == (640, 480)
    assert table.target.shape == (54, 1) and not table.target.has_rods
    assert table.captures[0].name == '01'
    np.testing.assert_allclose(table.captures[0].left_px[0, 0], [244.4274, 94.1646])
    np.testing.assert_allclose(table.target.anchors_m[1], [0.025, 0.0, 0.0])


def test_missing_points_are_missing_marks(tmp_path: Path) -> None:
    rows = 'a,left,p,0,0,10,20\na,left,q,1,0,30,20\na,right,q,1,0,25,20\n'
    capture = read_points(written(tmp_path, HEAD + rows)).captures[0]
    assert np.isfinite(capture.left_px).all()
    assert np.isnan(capture.right_px[0]).all() and np.isfinite(capture.right_px[1]).all()


def test_rows_that_are_no_numbers_are_named_and_left_out(tmp_path: Path) -> None:
    rows = 'a,left,p,0,0,10,20\na,left,q,1,0,nan,nan\na,right,q,1,0,25\na,right,p,0,0,5,20\n'
    table = read_points(written(tmp_path, HEAD + rows))
    assert len(table.left_out) == 2
    assert 'line 3: ' in table.left_out[0] and 'line 4: ' in table.left_out[1]
    assert table.target.shape == (1, 1) and np.isfinite(table.captures[0].right_px).all()


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('name,side,id,X_m,Y_m,u_px\n', 'lacks the columns v_px'),
        (HEAD, 'holds no points'),
        (HEAD + 'a,middle,0,0,0,1,1\n', "line 2: side must be left or right, got 'middle'"),
        (HEAD + 'a,left,0,0,0,x,1\n', 'holds no points; .*line 2: .* must be numbers'),
        (HEAD + 'a,left,0,0,0,1,1\nb,left,0,0.5,0,1,1\n', "line 3: point '0' lies at"),
        (HEAD + 'a,left,0,0,0,1,1\na,left,0,0,0,2,1\n', 'appears twice in the left image of a'),
        (HEAD + 'a,left,0,0,0,1e9,1\n', 'must be in pixels'),
        (HEAD + 'a,left,0,0,0,-3,1\n', 'line 2: u_px and v_px must be in the image, got -3 and 1'),
        (HEAD + 'a,left,0,1e300,0,3,1\n', 'line 2: X_m and Y_m must be within 100 m, got 1e'),
        (HEAD + 'a,left,0,0,0,1,1,9\n', 'holds no points; .*line 2: there are more values'),
        (HEAD + ',left,0,0,0,1,1\n', 'holds no points; .*line 2: name or id is missing'),
        ('id,' + HEAD, 'has several columns id; its first line'),
        (
            HEAD + ''.join(f'{i},left,{i},0,0,1,1\n' for i in range(1500)),
            '1500 boards of a target with 1500 points are more than 2000000 marks',
        ),
    ],
)
def test_wrong_tables_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        read_points(written(tmp_path, text))


def test_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(FileError, match='cannot be read'):
        read_points(tmp_path / 'absent.csv')
    (tmp_path / 'binary.csv').write_bytes(b'\xff\xfe\x00\x01')
    with pytest.raises(FileError, match='cannot be read'):
        read_points(tmp_path / 'binary.csv')
