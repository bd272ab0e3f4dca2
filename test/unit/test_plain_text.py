# SPDX-License-Identifier: Apache-2.0
"""Foreign names in messages: harmless to a terminal."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import binocular_recon
from binocular_recon.errors import BagError, BinocularReconError, FileError, plain_text, shortened

HOSTILE = '/a\x1b]0;title\x07\x9b31m\r\u202eb'
HARMLESS = '/a\\x1b]0;title\\x07\\x9b31m\\r\\u202eb'


def test_control_characters_are_written_out() -> None:
    assert plain_text(HOSTILE) == HARMLESS
    assert plain_text('left: 5 px, Überlänge\n\tnext') == 'left: 5 px, Überlänge\n\tnext'


def test_foreign_values_are_short() -> None:
    assert shortened('x' * 500) == f"'{'x' * 115} ..."
    assert shortened(ValueError('a\n  b\x1b')) == 'a b\\x1b'


@pytest.mark.parametrize('kind', [BinocularReconError, FileError, BagError])
def test_no_error_holds_control_characters(kind: type[BinocularReconError]) -> None:
    assert str(kind(f'{HOSTILE} is missing')) == f'{HARMLESS} is missing'


def test_nothing_in_the_current_folder_is_imported(tmp_path: Path) -> None:
    """``python -m`` looks there first."""
    for name in ('numpy', 'yaml', 'cv2', 'argparse_extra'):
        (tmp_path / f'{name}.py').write_text(f"open('{tmp_path}/ran', 'w')")
    source = str(Path(binocular_recon.__file__).parents[1])
    done = subprocess.run(
        [
            sys.executable,
            '-m',
            'binocular_recon',
            'match',
            'no.png',
            'no.png',
            '--output',
            'a.pfm',
        ],
        cwd=tmp_path,
        env={'PYTHONPATH': source},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1 and 'no.png cannot be read' in done.stderr
    assert not (tmp_path / 'ran').exists()
