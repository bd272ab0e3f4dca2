# SPDX-License-Identifier: Apache-2.0
"""A node that is interrupted ends, with status 0 and without a traceback."""

from __future__ import annotations

import itertools
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from stereo_msgs.msg import DisparityImage

from binocular_recon.stereo.rectification import Rectifier
from test.system.graph import Graph, NodeProcess, wait_until
from test.system.rig import CameraPair, image_pair, raw_rig


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_interrupted_in_the_middle_of_a_frame(
    graph: Graph, tmp_path: Path, number: signal.Signals
) -> None:
    rectify = Rectifier(raw_rig(width=480, height=360))
    images = rectify(*image_pair(1, 480, 360))
    # so slow that another frame always waits when one is done
    node = NodeProcess('match_node', tmp_path / 'log', disparity_range=300)
    cameras = CameraPair(graph, rectify.rig, image='image_rect')
    indices = itertools.count()
    with graph.listening(('/rig/disparity', DisparityImage)) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics)

        def first_came() -> bool:
            cameras.send(next(indices), images)
            return bool(inbox.messages)

        wait_until(first_came, 'the first disparity')
        assert node.stop(number) == 0, node.text()
    assert 'Traceback' not in node.text(), node.text()
    assert len(inbox.messages) < next(indices)


# What has happened when the signal comes, and the file or the library that shows it.
STAGES = {'imports': 'numpy', 'ROS loaded': 'librcl', 'compilation': '*/*.nbc'}


@pytest.mark.parametrize('stage', STAGES)
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_interrupted_while_it_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: str, number: signal.Signals
) -> None:
    """Without a cache: a compilation does not delay the end."""
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'cache'))
    monkeypatch.setenv('NUMBA_CPU_NAME', 'generic')  # nor does one beside the sources fit
    log = tmp_path / 'log'
    start = 'from binocular_recon.nodes import executables; executables.match_node()'
    with log.open('w') as file:
        command = [sys.executable, '-c', start]
        process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT)
    libraries = Path(f'/proc/{process.pid}/maps')

    def reached() -> bool:
        if stage == 'compilation':
            return any((tmp_path / 'cache').glob(STAGES[stage]))
        return STAGES[stage] in libraries.read_text()

    try:
        wait_until(reached, stage)
        process.send_signal(number)
        assert process.wait(20) == 0, log.read_text()
    finally:
        process.kill()
    assert 'Traceback' not in log.read_text()
    assert 'kernels ready' not in log.read_text()


# An interrupt within C code, as rclpy's conversion of a message, may come out as another error.
CHANGES_INTERRUPT = """
import os, signal, sys
from rclpy.node import Node
from binocular_recon.nodes.runtime.process import run_node

class Interrupted(Node):
    def __init__(self):
        super().__init__('interrupted')
        self.create_timer(0.01, self.interrupt)

    def interrupt(self):
        try:
            if NUMBER:
                os.kill(os.getpid(), NUMBER)
        except KeyboardInterrupt:
            pass
        raise ERROR('unable to convert')

sys.exit(run_node(Interrupted))
"""


@pytest.mark.parametrize('error', ['RuntimeError', 'SystemError'])
@pytest.mark.parametrize('number', [0, signal.SIGINT, signal.SIGTERM])
def test_interrupt_that_comes_as_another_error(number: int, error: str) -> None:
    program = CHANGES_INTERRUPT.replace('NUMBER', str(int(number))).replace('ERROR', error)
    command = [sys.executable, '-c', program]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == (0 if number else 1), run.stderr
    assert ('unable to convert' in run.stderr) == (not number), run.stderr
