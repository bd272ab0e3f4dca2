# SPDX-License-Identifier: Apache-2.0
"""What the calibration services answer; a whole calibration is in the system tests."""

from __future__ import annotations

import functools
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from binocular_recon.errors import CalibrationError
from binocular_recon.nodes.calibration import services as module
from binocular_recon.nodes.calibration.newest_pair import ImagePair
from binocular_recon.nodes.calibration.services import BusyError, CalibrationServices
from binocular_recon.nodes.calibration.steps import detect_pair
from binocular_recon.simulation.capture import CaptureOptions, simulate_capture
from binocular_recon.simulation.rig import survey_rig
from binocular_recon.simulation.rods import paper_board

pytestmark = pytest.mark.long

RIG, BOARD = survey_rig(scale=0.5), paper_board()


@pytest.fixture(scope='module')
def pair() -> ImagePair:
    """Return images of a board."""
    options = CaptureOptions(depth_m=(3.0, 6.0))
    shown = simulate_capture(BOARD, RIG, np.random.default_rng(1), options)
    return ImagePair(shown.left, shown.right)


class Crew(CalibrationServices):
    """Services of a folder that keep what is shown all the time."""

    def __init__(self, folder: Path, **changes: Any) -> None:
        self.shown: dict[str, str] = {}
        callbacks: dict[str, Any] = {
            'rig_in_use': None,
            'explain_silence': lambda: '',
            'on_state': self.shown.__setitem__,
            'send_to_cameras': lambda _rig: 'no cameras',
            'stopped': lambda: False,
        }
        super().__init__(BOARD, folder / 'rig', ('left', 'right'), **(callbacks | changes))


@pytest.fixture(autouse=True)
def _no_second_pair(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not wait for what these tests never send."""
    monkeypatch.setattr(module, '_STILL_WITHIN_S', 0.0)


@pytest.fixture(autouse=True, scope='module')
def _marks_of_a_pair_are_detected_once() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, 'detect_pair', functools.cache(detect_pair))
        yield


def test_without_boards_each_service_says_what_to_do(tmp_path: Path) -> None:
    crew = Crew(tmp_path)
    with pytest.raises(CalibrationError, match='no synchronised image pair has arrived yet; wait'):
        crew.capture()
    with pytest.raises(CalibrationError, match='there is no board to drop'):
        crew.undo()
    with pytest.raises(CalibrationError, match='no board has been captured yet'):
        crew.calibrate()
    with pytest.raises(CalibrationError, match='no calibration to save; calibrate first'):
        crew.save()
    assert crew.reset() == '0 boards dropped'
    assert crew.shown == {'boards': '0'}


def test_a_capture_is_stored_and_counted(tmp_path: Path, pair: ImagePair) -> None:
    crew = Crew(tmp_path)
    crew.pairs.put(pair)
    assert crew.capture() == (
        'board 001 captured (1 so far): 30 of 30 marks in both images; no further pair arrived,'
        ' so it is unknown whether rods and cameras stood still'
    )
    assert crew.shown == {'boards': '1'}
    assert Crew(tmp_path).shown == {'boards': '1'}  # another session goes on
    assert crew.undo() == 'board 001 dropped, 0 left'
    assert crew.shown == {'boards': '0'}


def test_a_dropped_pair_can_be_captured_again(tmp_path: Path, pair: ImagePair) -> None:
    crew = Crew(tmp_path)
    crew.pairs.put(pair)
    crew.capture()
    with pytest.raises(CalibrationError, match='no synchronised image pair has arrived since'):
        crew.capture()
    crew.undo()
    assert crew.capture().startswith('board 002 captured (1 so far)')


def test_images_of_another_size_are_not_captured(tmp_path: Path, pair: ImagePair) -> None:
    crew = Crew(tmp_path)
    crew.pairs.put(pair)
    crew.capture()
    crew.pairs.put(ImagePair(pair.left[:, :-40], pair.right[:, :-40]))
    text = 'not captured: the images are 920x600 px, those of earlier boards 960x600 px; restore'
    with pytest.raises(CalibrationError, match=text):
        crew.capture()


def test_a_capture_states_the_row_error_of_the_calibration_in_use(
    tmp_path: Path, pair: ImagePair
) -> None:
    crew = Crew(tmp_path, rig_in_use=RIG.stereo_rig())
    crew.pairs.put(pair)
    _, found, answer = crew.capture().partition('; with the calibration in use, rows differ by ')
    assert found
    assert float(answer.partition(' px')[0]) < 0.3  # the true calibration
    assert ' without noise) and lengths at ' in answer and ' % off, sigma ' in answer
    small = Crew(tmp_path / 'other', rig_in_use=survey_rig().stereo_rig())
    small.pairs.put(pair)
    assert 'the calibration in use cannot be checked: the images are 960x600 px' in small.capture()


def test_a_service_that_would_wait_for_another_is_busy(tmp_path: Path, pair: ImagePair) -> None:
    capturing, go_on = threading.Event(), threading.Event()

    def explain_silence() -> str:
        capturing.set()
        assert go_on.wait(30)
        return ''

    crew = Crew(tmp_path, explain_silence=explain_silence)
    crew.pairs.put(pair)
    answers: list[str] = []
    call = threading.Thread(target=lambda: answers.append(crew.capture()))
    call.start()
    assert capturing.wait(30)
    for service in (crew.capture, crew.undo, crew.reset, crew.calibrate):
        with pytest.raises(BusyError, match='busy with another call; try again when'):
            service()
    go_on.set()
    call.join()
    assert answers[0].startswith('board 001 captured')
    assert crew.undo() == 'board 001 dropped, 0 left'
