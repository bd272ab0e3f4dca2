# SPDX-License-Identifier: Apache-2.0
"""A whole calibration by services, with the mishaps of a day in the field."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

from binocular_recon.calibration.target.rods import save_rods
from binocular_recon.camera import StereoRig
from binocular_recon.io.calibration_yaml import read_rig
from test.system.calibration_crew import (
    BOARD,
    BOARDS,
    NODE,
    RIG,
    Cameras,
    Operator,
    contents,
    simulated,
)
from test.system.conftest import StartNode
from test.system.graph import Graph, NodeProcess, wait_until


@dataclass
class Day:
    """What a day of calibrating gave: the answers by step, and what was there after some."""

    output: Path
    cameras: Cameras
    answers: dict[str, Any]
    boards_on_disk: list[str]
    detections: Image
    saved: dict[str, bytes]
    rig: StereoRig

    def message(self, step: str, *, success: bool) -> str:
        """Return the message of an answer that must have this success."""
        answer = self.answers[step]
        assert answer.success is success, answer.message
        return str(answer.message)


@pytest.fixture(scope='module')
def day(
    graph: Graph, start_node: StartNode, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Day]:
    """Drive the node through a day once; the tests look at what it answered."""
    folder = tmp_path_factory.mktemp('day')
    save_rods(BOARD, folder / 'rods.yaml')
    output = folder / 'rig'
    parameters = {'rods': folder / 'rods.yaml', 'output': output, 'left_camera_name': 'port'}
    start = partial(start_node, 'calibration_node', **parameters)
    operator, cameras = Operator(graph), Cameras(graph)
    answers: dict[str, Any] = {}

    node: NodeProcess = start()
    operator.wait_for_node()
    for service in ('calibrate', 'save', 'undo'):
        answers[f'{service} without boards'] = operator.call(service)
    empty = np.full(RIG.left.size[::-1], 120, np.uint8)
    answers['empty images'] = operator.capture(empty, empty)

    first, second = simulated(0), simulated(1)
    with graph.listening(('/rig/detections', Image)) as (drawn,):
        answers['first board'] = operator.capture(first.left, first.right)
        boards_on_disk = sorted(path.name for path in (output / 'captures').iterdir())
        detections = drawn.wait()[-1]
    answers['same pair'] = operator.call('capture')
    answers['same board'] = operator.capture(first.left, first.right)
    answers['second board'] = operator.capture(second.left, second.right)
    answers['undo'] = operator.call('undo')

    node.kill()
    node = start()
    operator.wait_for_node()
    for seed in range(1, BOARDS):
        board = simulated(seed)
        answers[f'board {seed + 1}'] = operator.capture(board.left, board.right)

    answers['calibrate'], answers['calibrate meanwhile'] = calibrate_twice(graph)
    answers['save'] = operator.call('save')
    saved, rig = contents(output), read_rig(output)
    answers['save again'] = operator.call('save')
    answers['different sizes'] = operator.capture(first.left, first.right[::2, ::2])
    answers['reset'] = operator.call('reset')
    answers['save after reset'] = operator.call('save')
    assert node.stop() == 0
    yield Day(output, cameras, answers, boards_on_disk, detections, saved, rig)
    cameras.close()


def calibrate_twice(graph: Graph) -> tuple[Any, Any]:
    """Call `calibrate` twice at once; return the answer with success and the other one."""
    client = graph.do(partial(graph.node.create_client, Trigger, f'{NODE}/calibrate'))
    assert client.wait_for_service(10)
    calls = [client.call_async(Trigger.Request()) for _ in range(2)]
    wait_until(lambda: all(call.done() for call in calls), 'both answers', 60)
    solved, other = sorted((call.result() for call in calls), key=lambda one: not one.success)
    return solved, other


# The first of these tests waits for the whole day.
pytestmark = pytest.mark.timeout(180)


@pytest.mark.parametrize(
    ('service', 'message'),
    [
        ('calibrate', 'no board has been captured yet'),
        ('save', 'calibrate first'),
        ('undo', 'there is no board to drop'),
    ],
)
def test_services_say_what_is_missing(day: Day, service: str, message: str) -> None:
    assert message in day.message(f'{service} without boards', success=False)


def test_images_without_rods_are_not_captured(day: Day) -> None:
    assert 'left image: no board found' in day.message('empty images', success=False)


def test_a_board_is_on_disk_when_the_service_has_answered(day: Day) -> None:
    message = day.message('first board', success=True)
    assert 'board 001 captured (1 so far): 30 of 30 marks in both images' in message
    assert day.boards_on_disk == ['left_001.png', 'right_001.png']


def test_detections_are_drawn_side_by_side(day: Day) -> None:
    assert (day.detections.width, day.detections.height) == (2 * RIG.left.width, RIG.left.height)


def test_neither_a_pair_nor_a_board_is_captured_twice(day: Day) -> None:
    message = day.message('same pair', success=False)
    assert 'no synchronised image pair has arrived since the last capture' in message
    assert 'repeats board 001' in day.message('same board', success=False)


def test_undo_drops_the_last_board(day: Day) -> None:
    day.message('second board', success=True)
    assert 'board 002 dropped, 1 left' in day.message('undo', success=True)


def test_boards_survive_a_node_that_is_killed(day: Day) -> None:
    counts = [
        re.search(r'\((\d+) so far\)', day.message(f'board {number}', success=True))
        for number in range(2, BOARDS + 1)
    ]
    assert [int(count[1]) for count in counts if count] == list(range(2, BOARDS + 1))


def test_calibrate_answers_with_figures_and_advice(day: Day) -> None:
    message = day.message('calibrate', success=True)
    assert message.startswith(f'{BOARDS} boards: reprojection error 0.')
    assert 'depth sigma' in message and 'next: a board at' in message


def test_a_second_calibration_meanwhile_is_busy(day: Day) -> None:
    assert 'busy' in day.message('calibrate meanwhile', success=False)


def test_the_saved_calibration_is_that_of_the_rig(day: Day) -> None:
    assert f'{BOARDS} of {BOARDS} boards' in day.message('save', success=True)
    sigma_m = json.loads(day.saved['calibration.json'])['sigma']['baseline_m']
    true_baseline_m = float(np.linalg.norm(RIG.T))
    assert abs(day.rig.baseline_m - true_baseline_m) < max(4 * sigma_m, 1e-3)
    assert abs(day.rig.left.K[0, 0] / RIG.left.K[0, 0] - 1) < 0.01
    assert 'camera_name: port' in day.saved['left.yaml'].decode()


def test_cameras_get_the_saved_calibration(day: Day) -> None:
    message = day.message('save', success=True)
    assert message.endswith('left/set_camera_info accepted it; right/set_camera_info accepted it')
    assert [len(infos) for infos in day.cameras.taken.values()] == [2, 2]
    np.testing.assert_allclose(
        day.cameras.taken['right'][0].p, day.rig.right.P.ravel(), rtol=1e-12
    )


def test_a_camera_that_rejects_a_calibration_is_named(day: Day) -> None:
    message = day.message('save again', success=True)
    assert 'left/set_camera_info accepted it' in message
    assert 'right/set_camera_info rejected it: the flash is locked' in message


def test_saving_again_keeps_the_previous_files(day: Day) -> None:
    assert contents(day.output / 'previous') == day.saved


def test_images_of_other_sizes_than_before_are_not_captured(day: Day) -> None:
    message = day.message('different sizes', success=False)
    assert 'images are 960x600 and 480x300 px, those of earlier boards 960x600 px' in message


def test_reset_moves_all_boards_away(day: Day) -> None:
    message = day.message('reset', success=True)
    assert f'{BOARDS} boards dropped; their images are in' in message
    dropped = Path(message.partition(' are in ')[2])
    assert len(list(dropped.iterdir())) == 2 * BOARDS
    assert [path.name for path in (day.output / 'captures').iterdir()] == ['dropped']


def test_a_calibration_of_dropped_boards_is_not_saved(day: Day) -> None:
    message = day.message('save after reset', success=False)
    assert f'{BOARDS} of the {BOARDS} boards of the calibration were dropped since' in message
    assert contents(day.output) == day.saved
