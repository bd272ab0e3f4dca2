# SPDX-License-Identifier: Apache-2.0
"""Each fault once: the nodes recover and name the cause. How quickly, `make soak` looks at."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).with_name('run.py')
pytestmark = pytest.mark.ros


def test_nodes_survive_each_fault_and_name_it(tmp_path: Path) -> None:
    command = [sys.executable, str(PROGRAM), '--minutes', '0', '--within', '25']
    done = subprocess.run(
        [*command, '--output', str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    page = (tmp_path / 'report.html').read_text('utf-8')
    assert '<polyline' in page and '<td>a node killed and restarted</td>' in page
    assert 'composed/stereo_node' in page and 'separate/match_node' in page
    assert ' src=' not in page and '<link' not in page, 'it needs nothing else'


def test_memory_that_grows_and_faults_without_recovery_are_problems() -> None:
    from test.soak.report import Episode, Life, growth, soak_page

    times_s = [float(second) for second in range(1000)]
    leak = Life('a/node', times_s, [100 + 0.02 * max(0.0, at - 300) for at in times_s])
    start = Life('a/node', times_s, [min(100.0, at) for at in times_s])
    assert growth(leak) == pytest.approx(0.02 * 525 / 101.75, rel=0.02)
    assert growth(start) == 0 == growth(Life('a/node', times_s[:200], times_s[:200]))
    bad = Episode('a fault', 'a', 1.0, 9.0, '', 'recovered after 9.0 s')
    page = soak_page('', [bad, bad._replace(problem='')], [leak], {}, ['a fault'])
    assert page.count('class="ours"') == 1
