# SPDX-License-Identifier: Apache-2.0
"""A short round of changed inputs; ``make fuzz`` runs a long one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

RUN = Path(__file__).with_name('run.py')
CASES = 120


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(RUN), '--output', str(folder), *words],
        capture_output=True,
        text=True,
        check=False,
    )


def test_no_input_ends_in_a_traceback_takes_long_or_much_memory(tmp_path: Path) -> None:
    done = run(tmp_path, '--cases', str(CASES))
    assert done.returncode == 0, done.stdout
    assert f'camera_yaml: {CASES} inputs, 0 findings' in done.stdout


def test_what_must_not_happen_is_found(tmp_path: Path) -> None:
    done = run(tmp_path, '--cases', '4', '--forms', 'check')
    assert done.returncode == 1
    assert 'check: 4 inputs, 4 findings of 4 kinds' in done.stdout
    for text in (
        'ValueError',
        'more than 2 s of processor time',
        'more than 1 GB',
        'ended by SIGABRT',
    ):
        assert text in done.stdout
    assert len(list(tmp_path.glob('check_*.txt'))) == 4
