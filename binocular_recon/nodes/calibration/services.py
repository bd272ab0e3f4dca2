# SPDX-License-Identifier: Apache-2.0
"""What the services of `calibration_node` do, without ROS."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from binocular_recon.calibration.model import DEFAULT_LENS
from binocular_recon.calibration.result import CalibrationResult
from binocular_recon.calibration.screening import rejection_reason
from binocular_recon.calibration.session.calibration_files import finish_saving, save_calibration
from binocular_recon.calibration.session.capture_store import CaptureStore
from binocular_recon.calibration.session.captures import CaptureSet
from binocular_recon.calibration.solve import calibrate
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.calibration.target.target import Target
from binocular_recon.camera import StereoRig
from binocular_recon.errors import BinocularReconError, CalibrationError
from binocular_recon.inputs.common_size import CommonSize
from binocular_recon.measurement.check_distance import check_distances
from binocular_recon.nodes.calibration.newest_pair import NewestPair
from binocular_recon.nodes.calibration.steps import (
    check_still,
    describe_holding,
    describe_missing_marks,
    describe_next_step,
    describe_result,
    describe_size_change,
    detect_pair,
)
from binocular_recon.number_text import counted

# How long a capture waits for a second pair to compare with.
_STILL_WITHIN_S = 1.0


class BusyError(BinocularReconError):
    """Another service is still working on the same data."""


class CalibrationServices:
    """Captured boards and the calibration made of them; any thread may call.

    Each service is a method that returns its answer, a sentence with figures, or raises a
    BinocularReconError with the reason and the remedy. None waits for another: where two would
    work on the same data, the second one raises a BusyError.

    Parameters
    ----------
    board : RodBoard
        The rods.
    output : Path
        Folder of the calibration; captures are kept in ``captures/`` under it.
    names : (str, str)
        Names of the left and the right camera.
    lens : str
        Lens of both cameras, one of `calibration.model.calibrated_lenses`.
    rig_in_use : StereoRig or None
        Calibration that captures are compared with.
    explain_silence : callable
        Returns why no image pairs arrive, '' while they do.
    on_state : callable
        Called with name and value of what a crew wants to see all the time.
    send_to_cameras : callable
        Passes a calibration to the cameras and returns what became of it.
    stopped : callable
        Returns True when reading boards from disk is to end early.

    Attributes
    ----------
    pairs : NewestPair
        Where the image pairs arrive that `capture` takes.

    """

    def __init__(
        self,
        board: RodBoard,
        output: Path,
        names: tuple[str, str],
        *,
        lens: str = DEFAULT_LENS,
        rig_in_use: StereoRig | None,
        explain_silence: Callable[[], str],
        on_state: Callable[[str, str], None],
        send_to_cameras: Callable[[StereoRig], str],
        stopped: Callable[[], bool],
    ) -> None:
        self.pairs = NewestPair()
        self._board, self._target = board, Target.from_rods(board)
        self._output, self._names = output, names
        self._lens, self._rig_in_use = lens, rig_in_use
        self._explain_silence, self._on_state = explain_silence, on_state
        self._send_to_cameras = send_to_cameras
        self._store = CaptureStore(output / 'captures', board, stopped=stopped)
        finish_saving(output)
        self._result: CalibrationResult | None = None
        self._storing, self._solving = threading.Lock(), threading.Lock()
        self._on_state('boards', str(len(self._store.names)))

    def read_boards(self) -> None:
        """Read the boards of an earlier session now, so that the first capture need not."""
        with contextlib.suppress(BinocularReconError):  # the first capture says what is wrong
            self._store.usable()

    def capture(self) -> str:
        """Detect the rods in the newest pair and store it as a board."""
        with _or_busy(self._storing):
            stored = self._store.usable()  # may take long: before the pair is taken
            pair = self.pairs.take(self._explain_silence)
            found = detect_pair(pair, self._board)
            capture = Capture('new', found[0].marks_px, found[1].marks_px)
            missing = describe_missing_marks(found)
            reason = self._rejection_reason(capture, pair.sizes, stored)
            if reason:
                raise CalibrationError(f'not captured: {reason}{missing}')
            later = self.pairs.wait_for_next(pair, _STILL_WITHIN_S)
            remark = check_still(pair, capture, later, self._board)
            name = self._store.add(pair.left, pair.right)
            self._store.keep(Capture(name, capture.left_px, capture.right_px), pair.sizes)
            self.pairs.mark_captured(pair)
            count = len(self._store.names)
            self._on_state('boards', str(count))
            both = found[0].found & found[1].found
            holding = describe_holding(self._rig_in_use, capture, pair.sizes, self._board)
            return (
                f'board {name} captured ({count} so far): {both.sum()} of {both.size} marks in'
                f' both images{missing}{holding}{remark}'
            )

    def undo(self) -> str:
        """Drop the last board."""
        with _or_busy(self._storing):
            names = self._store.names
            if not names:
                raise CalibrationError('there is no board to drop')
            self._store.drop(names[-1:])
            self.pairs.mark_captured(None)
            self._on_state('boards', str(len(names) - 1))
            return f'board {names[-1]} dropped, {len(names) - 1} left'

    def reset(self) -> str:
        """Drop all boards."""
        with _or_busy(self._storing):
            count, folder = len(self._store.names), self._store.drop_all()
            self.pairs.mark_captured(None)
            self._on_state('boards', '0')
            where = f'; their images are in {folder}' if folder else ''
            return f'{counted(count, "board")} dropped{where}'

    def calibrate(self) -> str:
        """Calibrate from all boards."""
        with _or_busy(self._solving):
            begun_s = time.monotonic()
            with _or_busy(self._storing):
                found = self._store.captures()
            result = calibrate(
                found.captures,
                self._board,
                found.sizes.left,
                right_size=found.sizes.right,
                lens=self._lens,
                rejected=found.rejected,
            )
            self._result = result
            self._on_state('calibration', f'{counted(len(result.names), "board")}, not saved yet')
            seconds = time.monotonic() - begun_s
            return f'{describe_result(result)}; took {seconds:.0f} s; {describe_next_step(result)}'

    def check(self) -> str:
        """Measure a known length of the rods in the newest pair; raise an error if it is off."""
        rig = self._rig_in_use if self._result is None else self._result.rig
        if rig is None:
            raise CalibrationError(
                'there is no calibration to check; calibrate first, or set the parameter'
                ' calibration'
            )
        pair = self.pairs.take(self._explain_silence)
        found = detect_pair(pair, self._board)
        calibrated = CommonSize(rig.left.size, rig.right.size)
        if pair.sizes != calibrated:
            raise CalibrationError(describe_size_change(pair.sizes, calibrated))
        capture = Capture('now', found[0].marks_px, found[1].marks_px)
        (distance,) = check_distances(rig, [capture], self._target)
        if not distance.passed:
            raise CalibrationError(
                f'{distance}; check the heights of the marks in rods.yaml, else calibrate again'
            )
        return str(distance)

    def save(self) -> str:
        """Write the calibration and pass it to the cameras."""
        with _or_busy(self._solving):
            if self._result is None:
                raise CalibrationError('there is no calibration to save; calibrate first')
            used, stored = self._result.names, self._store.names
            gone = set(used) - set(stored)
            if gone:
                raise CalibrationError(
                    f'{len(gone)} of the {len(used)} boards of the calibration were dropped'
                    ' since; calibrate again'
                )
            save_calibration(self._result, self._output, self._names, self._store.folder)
            self._on_state('calibration', f'saved in {self._output}')
            sent = self._send_to_cameras(self._result.rig)
            return f'saved in {self._output}: {len(used)} of {len(stored)} boards; {sent}'

    def _rejection_reason(
        self, capture: Capture, sizes: CommonSize, stored: CaptureSet | None
    ) -> str | None:
        """Return why a capture cannot be used with the stored boards, None if it can."""
        if stored is not None and (change := describe_size_change(sizes, stored.sizes)):
            return change
        others = () if stored is None else stored.captures
        return rejection_reason(
            capture.on_common(sizes),
            self._target,
            sizes.left,
            [other.on_common(sizes) for other in others],
            self._lens,
        )


@contextlib.contextmanager
def _or_busy(lock: threading.Lock) -> Iterator[None]:
    """Hold a lock; raise a BusyError where another call holds it."""
    if not lock.acquire(blocking=False):
        raise BusyError('busy with another call; try again when that has answered')
    try:
        yield
    finally:
        lock.release()
