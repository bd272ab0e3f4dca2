# SPDX-License-Identifier: Apache-2.0
"""A whole calibration by services, with the mishaps of a day in the field."""

from __future__ import annotations

import contextlib
import json
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Image
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import Trigger

from binocular_recon.calibration.session.calibration_files import FILES
from binocular_recon.calibration.target.rods import save_rods
from binocular_recon.io.calibration_yaml import read_rig
from binocular_recon.simulation.capture import CaptureOptions, SimulatedCapture, simulate_capture
from binocular_recon.simulation.rig import survey_rig
from binocular_recon.simulation.rods import paper_board, with_placement
from test.system.conftest import StartNode
from test.system.graph import Graph, wait_until
from test.system.rig import header, image_message

NODE = '/rig/calibration_node'
BOARDS = 8
# half the size of the survey rig's pictures, so boards stand at half the distance
RIG = survey_rig(scale=0.5)
BOARD = with_placement(paper_board(), 0.002)


@cache
def captured(seed: int) -> SimulatedCapture:
    options = CaptureOptions(depth_m=(3.5, 8.0), noise=1.0)
    return simulate_capture(BOARD, RIG, np.random.default_rng([7, seed]), options)


class Field:
    """The cameras and the crew."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._index = 0
        self._images = {
            side: graph.publisher(f'/rig/{side}/image_raw', Image) for side in ('left', 'right')
        }

    def show(self, left: np.ndarray, right: np.ndarray) -> None:
        """Send one pair."""
        self._index += 1
        for side, image in (('left', left), ('right', right)):
            self._images[side].publish(image_message(image, header(self._index, side)))

    def call(self, service: str) -> Any:
        return self._graph.call(f'{NODE}/{service}', Trigger, Trigger.Request())

    def capture(self, left: np.ndarray, right: np.ndarray) -> Any:
        """Send a pair and capture it once the node has it."""
        before = self._received()
        for _ in range(10):  # one that was sent while a node joined may be lost
            self.show(left, right)
            with contextlib.suppress(AssertionError):
                wait_until(lambda: self._received() > before, 'the pair at the node', 3.0)
                break
        return self.call('capture')

    def _received(self) -> int:
        status = self._graph.status(NODE)
        values = {pair.key: pair.value for pair in status.values} if status else {}
        return int(values.get('received sets', 0))


@pytest.mark.timeout(150)
def test_a_crew_calibrates(graph: Graph, start_node: StartNode, tmp_path: Path) -> None:
    save_rods(BOARD, tmp_path / 'rods.yaml')
    output = tmp_path / 'rig'
    parameters = {'rods': tmp_path / 'rods.yaml', 'output': output, 'left_camera_name': 'port'}
    node = start_node('calibration_node', **parameters)
    field = Field(graph)
    taken = {'left': [], 'right': []}  # type: dict[str, list[CameraInfo]]
    services = [
        graph.do(partial(_offer_set_camera_info, graph, side, infos))
        for side, infos in taken.items()
    ]
    graph.wait_for_subscriber('/rig/left/image_raw', '/rig/right/image_raw')
    empty = np.full(RIG.left.size[::-1], 120, np.uint8)

    answer = field.call('calibrate')
    assert not answer.success
    assert 'no board has been captured yet' in answer.message
    assert 'calibrate first' in field.call('save').message
    assert 'no board to drop' in field.call('undo').message

    answer = field.capture(empty, empty)
    assert not answer.success
    assert 'left image: no board found' in answer.message

    first = captured(0)
    with graph.listening(('/rig/detections', Image)) as (drawn,):
        answer = field.capture(first.left, first.right)
        assert answer.success, answer.message
        assert 'board 001 captured (1 so far): 30 of 30 marks in both images' in answer.message
        picture = drawn.wait()[-1]
    assert (picture.width, picture.height) == (2 * RIG.left.width, RIG.left.height)
    # on disk when the service has answered
    assert sorted(path.name for path in (output / 'captures').iterdir()) == [
        'left_001.png',
        'right_001.png',
    ]
    assert 'no synchronised pair has come since' in field.call('capture').message
    assert 'repeats board 001' in field.capture(first.left, first.right).message

    second = captured(1)
    assert field.capture(second.left, second.right).success
    assert 'board 002 dropped, 1 left' in field.call('undo').message

    # killed, not stopped: what was acknowledged is there
    node.process.kill()
    node.process.wait()
    node.process.returncode = 0
    node = start_node('calibration_node', **parameters)
    graph.wait_for_subscriber('/rig/left/image_raw', '/rig/right/image_raw')
    graph.wait_for_status(NODE, '')
    for seed in range(1, BOARDS):
        board = captured(seed)
        answer = field.capture(board.left, board.right)
        assert answer.success, answer.message
    assert f'({BOARDS} so far)' in answer.message

    client = graph.do(partial(graph.node.create_client, Trigger, f'{NODE}/calibrate'))
    assert client.wait_for_service(10)
    calls = [client.call_async(Trigger.Request()) for _ in range(2)]
    wait_until(lambda: all(call.done() for call in calls), 'both answers', 60)
    solved, refused = sorted((call.result() for call in calls), key=lambda one: not one.success)
    assert solved.success, solved.message
    assert not refused.success and 'busy' in refused.message
    assert 'depth sigma' in solved.message and 'next: a board at' in solved.message

    answer = field.call('save')
    assert answer.success, answer.message
    assert 'left/set_camera_info took it' in answer.message
    rig = read_rig(output)
    true_baseline_m = float(np.linalg.norm(RIG.T))
    sigma_m = json.loads((output / 'calibration.json').read_text())['sigma']['baseline_m']
    assert abs(rig.baseline_m - true_baseline_m) < max(4 * sigma_m, 1e-3)
    assert abs(rig.left.K[0, 0] / RIG.left.K[0, 0] - 1) < 0.01
    assert [len(infos) for infos in taken.values()] == [1, 1]
    np.testing.assert_allclose(taken['right'][0].p, rig.right.P.ravel(), rtol=1e-12)
    assert 'camera_name: port' in (output / 'left.yaml').read_text()
    assert f'{BOARDS} of {BOARDS} boards' in answer.message

    before = {name: (output / name).read_bytes() for name in FILES}
    answer = field.call('save')
    assert answer.success, answer.message
    assert 'left/set_camera_info took it' in answer.message
    assert 'right/set_camera_info refused: the flash is locked' in answer.message
    assert {name: (output / 'previous' / name).read_bytes() for name in FILES} == before

    answer = field.capture(first.left, first.right[::2, ::2])
    assert not answer.success
    assert 'left image is 960x600, right 480x300 px; set both alike' in answer.message

    answer = field.call('reset')
    assert answer.success and f'{BOARDS} boards dropped; their pictures are in' in answer.message
    dropped = Path(answer.message.partition(' are in ')[2])
    assert len(list(dropped.iterdir())) == 2 * BOARDS
    assert [path.name for path in (output / 'captures').iterdir()] == ['dropped']
    answer = field.call('save')
    assert not answer.success
    assert f'boards that were dropped since ({BOARDS} of {BOARDS})' in answer.message
    assert read_rig(output).baseline_m == rig.baseline_m
    assert node.stop() == 0
    for service in services:
        graph.do(partial(graph.node.destroy_service, service))


@pytest.mark.timeout(60)
def test_rods_that_move_are_not_captured(
    graph: Graph, start_node: StartNode, tmp_path: Path
) -> None:
    save_rods(BOARD, tmp_path / 'rods.yaml')
    node = start_node('calibration_node', rods=tmp_path / 'rods.yaml', output=tmp_path / 'rig')
    field = Field(graph)
    graph.wait_for_status(NODE, '')
    graph.wait_for_subscriber('/rig/left/image_raw', '/rig/right/image_raw')
    shown = captured(0)
    moved = [np.roll(image, 5, axis=1) for image in (shown.left, shown.right)]
    client = graph.do(partial(graph.node.create_client, Trigger, f'{NODE}/capture'))
    assert client.wait_for_service(10)
    field.show(shown.left, shown.right)
    wait_until(lambda: field._received() > 0, 'the pair at the node')
    call = client.call_async(Trigger.Request())
    # pairs come on until the answer

    def answered() -> bool:
        field.show(*moved)
        return bool(call.done())

    wait_until(answered, 'the answer')
    answer = call.result()
    assert not answer.success
    assert 'the marks moved by 5.0 px' in answer.message
    assert node.stop() == 0


@pytest.mark.parametrize(
    ('parameters', 'message'),
    [
        ({}, 'parameter rods is empty'),
        ({'rods': '/nowhere/rods.yaml', 'output': 'out'}, '/nowhere/rods.yaml'),
    ],
)
def test_node_refuses_to_start(
    tmp_path: Path, parameters: dict[str, object], message: str
) -> None:
    from test.system.graph import NodeProcess

    node = NodeProcess('calibration_node', tmp_path / 'log', **parameters)
    assert node.process.wait(30) == 1
    assert message in node.text()
    assert 'Traceback' not in node.text(), node.text()


def _offer_set_camera_info(graph: Graph, side: str, taken: list[CameraInfo]) -> Any:
    def answer(request: Any, response: Any) -> Any:
        taken.append(request.camera_info)
        response.success = side == 'left' or len(taken) == 1
        if not response.success:
            response.status_message = 'the flash is locked'
        return response

    return graph.node.create_service(SetCameraInfo, f'/rig/{side}/set_camera_info', answer)
