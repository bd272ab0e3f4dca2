# SPDX-License-Identifier: Apache-2.0
"""Text files that anybody may have written: limits, and errors that name the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from binocular_recon.errors import CalibrationError, FileError
from binocular_recon.io.text_files import (
    number,
    numbers,
    parse_yaml,
    read_json,
    read_text,
    read_yaml,
    whole_number,
)

DEEP = 100_000


def test_yaml_is_read(tmp_path: Path) -> None:
    path = tmp_path / 'a.yaml'
    path.write_text('\ufeffa: [1, 2.5, 1e-05, yes]\nb: {c: text}\n', encoding='utf-8')
    assert read_yaml(path, 'give one') == {'a': [1, 2.5, '1e-05', True], 'b': {'c': 'text'}}
    assert parse_yaml('') is None


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('a: &x [1, 2]\nb: [*x, *x]', 'has an alias in line 2'),
        ('[' * DEEP, 'is nested too deeply: 50 levels in line 1'),
        ('? ' * DEEP, 'is nested too deeply: 50 levels'),
        ('[' + '1,' * DEEP + ']', 'holds more than 30000 values'),
        ('a: 1\nb: 2\na: 3', "is not valid YAML: line 3: 'a' is stated twice"),
        ('a: ' + '9' * 5000, 'is not valid YAML: line 1: a number has 5000 characters'),
        ('a: ' + '1:' * 5000 + '1', 'is not valid YAML: line 1: a number has'),
        ('a: 2001-99-99', 'is not valid YAML: a value cannot be read'),
        ('a: [1', 'is not valid YAML: line'),
        (
            'a: !!python/object/apply:os.system [id]',
            'is not valid YAML: line 1: could not determine a constructor',
        ),
        ('{[]: 1}', 'is not valid YAML: line 1'),
        ('a: \x07', 'is not valid YAML'),
        ('---\na: 1\n---\nb: 2', 'is not valid YAML: line 3'),
    ],
)
def test_hostile_yaml_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / 'a.yaml'
    path.write_text(text)
    with pytest.raises(FileError, match=rf'a\.yaml {message}.*; give another'):
        read_yaml(path, 'give another')


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('[' * DEEP, 'is not valid JSON: maximum recursion'),
        ('{"a": 1, "a": 2}', "is not valid JSON: 'a' is stated twice"),
        ('[' + '9' * 5000 + ']', 'is not valid JSON: a number has 5000 digits'),
        ('{"a": ', 'is not valid JSON'),
        ('', 'is not valid JSON'),
    ],
)
def test_hostile_json_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / 'a.json'
    path.write_text(text)
    with pytest.raises(FileError, match=rf'a\.json {message}.*; give another'):
        read_json(path, 'give another')


def test_what_is_no_text_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r'is not a file; give one'):
        read_text(tmp_path, 'give one', 10)
    (tmp_path / 'a').write_bytes(b'ab\xff')
    with pytest.raises(FileError, match='byte 2 is not UTF-8; give one'):
        read_text(tmp_path / 'a', 'give one', 10)
    with pytest.raises(FileError, match='more than 2e-06 MB, the limit of such files; give one'):
        read_text(tmp_path / 'a', 'give one', 2)
    with pytest.raises(FileError, match='null'):
        read_text(Path('a\0b'), 'give one', 2)


def test_numbers_are_finite_and_rows_equally_long() -> None:
    assert numbers('K', [1, '1e-05', 2.5], CalibrationError).tolist() == [1, 1e-5, 2.5]
    assert numbers('K', [[1, 2], [3, 4]], CalibrationError).shape == (2, 2)
    assert numbers('K', [], CalibrationError).dtype == np.float64
    for value, message in (
        ('text', 'K must be a list of numbers, got .text'),
        ({'a': 1}, 'K must be a list of numbers'),
        ([True], 'K must hold finite numbers, got True'),
        ([None], 'K must hold finite numbers, got None'),
        (['nan'], "K must hold finite numbers, got 'nan'"),
        ([10**400], 'K must hold finite numbers, got 1000'),
        ([[1], [1, 2]], 'the rows of K must be equally long'),
        ([[1], 2], 'K must be a list of numbers, got 2'),
    ):
        with pytest.raises(CalibrationError, match=message):
            numbers('K', value, CalibrationError)


def test_single_numbers() -> None:
    assert number('x', '1e-05', FileError) == 1e-5
    assert whole_number('x', 640.0, FileError) == 640
    with pytest.raises(FileError, match=r'x must be a whole number, got 640\.5'):
        whole_number('x', 640.5, FileError)
    with pytest.raises(FileError, match=r'x must be a finite number, got inf'):
        number('x', float('inf'), FileError)
