# SPDX-License-Identifier: Apache-2.0
"""What all browsers see and do: one frame, one way of colouring, one board of picks."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import replace

import numpy as np

from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.camera import FloatArray
from binocular_recon.errors import ConfigError, MeasurementError, shortened
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.kinds import KINDS, measure
from binocular_recon.measurement.picks import Pick, Request
from binocular_recon.measurement.results import Measurement
from binocular_recon.measurement.snapping import PICK_SIGMA_PX, check_inside
from binocular_recon.viewer.coloured_frame import COLOURS, MOST_POINTS, Shown, coloured
from binocular_recon.viewer.measurer import Measurer
from binocular_recon.viewer.picks_board import Marks, PicksBoard, default_request

_CAMERA_UP = (0.0, -1.0, 0.0)


class SharedView:
    """The state behind a page.

    Methods may be called by several threads; each tells the listeners when something has changed.

    Parameters
    ----------
    folder : MeasuredFolder
    board : PicksBoard
    pick_sigma_px : float
        One standard deviation of picks, on each axis.
    most_points : int
        The shown cloud is thinned to about this number; measuring uses every pixel.

    Attributes
    ----------
    kind : str
        What the next clicks measure, a key of `KINDS`.
    shown : Shown
    displayed : ColouredFrame
        The shown frame in its colours.
    awaited : Pick, optional
        The next click in the right image says where this pick is there.
    revision : int
        Number of changes so far.
    image_revision : int
        Its value when what is shown changed last.
    listeners : list of callable
        Called after each change.

    Raises
    ------
    BinocularReconError
        If the first frame cannot be read, or picks are in frames that the folder does not have.

    """

    def __init__(
        self,
        folder: MeasuredFolder,
        board: PicksBoard,
        pick_sigma_px: float = PICK_SIGMA_PX,
        most_points: int = MOST_POINTS,
    ) -> None:
        self.folder, self.board = folder, board
        self.kind = 'distance'
        self.awaited: Pick | None = None
        self.shown = Shown()
        self.revision = self.image_revision = 0
        self.listeners: list[Callable[[], None]] = []
        self._most_points = most_points
        self._lock = threading.RLock()
        picks = board.marks.picks.values()
        self._measurer = Measurer(folder, picks, pick_sigma_px)
        self.displayed = coloured(self._measurer.session(), self.shown, most_points)

    @contextmanager
    def _changing(self) -> Iterator[Marks]:
        """Let one thread at a time change something, and tell the listeners."""
        with self._lock:
            yield self.board.marks
            self.revision += 1
            for listener in self.listeners:
                listener()

    # what is measured

    def click(self, u: float, v: float, *, both: bool = False) -> None:
        """Pick a pixel of the shown frame for the measurement that is being made.

        With ``both``, the click in the right image comes next and completes the pick.

        Raises
        ------
        MeasurementError
            If it is outside the image or, for what needs a point there, on a hole; or if what the
            pick completes cannot be measured.
        FileError
            If the picks cannot be saved.

        """
        with self._changing() as marks:
            pick = self.board.new_pick(self.shown.frame, u, v)
            if both or not KINDS[self.kind].located:
                check_inside(self.frame, pick, pick.pixel, 'left')
            else:
                self._measurer.session([pick]).point(pick.name)
            if both:
                self.awaited = pick
            else:
                self._choose(marks.with_pick(pick), pick.name)

    def click_right(self, u: float, v: float) -> None:
        """Pick where the awaited pick is in the right image; raises as `click`."""
        with self._changing() as marks:
            if self.awaited is None:
                raise MeasurementError('click the point in the left image first')
            pick = replace(self.awaited, right=np.round([u, v], 2))
            self._measurer.session([pick]).point(pick.name)
            if pick.name in marks.picks:
                self.board.change(marks.with_pick(pick))
            else:
                self._choose(marks.with_pick(pick), pick.name)
            self.awaited = None

    def await_right(self, name: str) -> None:
        """Let the next click in the right image say where a pick is there."""
        with self._changing():
            pick = self.board.pick(name)
            if pick.frame != self.shown.frame:
                raise MeasurementError(f'pick {name} is in frame {pick.frame}; show that first')
            self.awaited = pick

    def look(self, origin: FloatArray, direction: FloatArray) -> None:
        """Pick the point of the cloud that a ray meets; raises as `click`."""
        with self._lock:
            self.click(*self.displayed.pixel_on_ray(origin, direction).tolist())

    def take(self, name: str) -> None:
        """Use a pick that is there already; raises as `click`."""
        with self._changing() as marks:
            self.board.pick(name)
            if marks.chosen[:1] == (name,) and KINDS[self.kind].most == 0:
                self._finish(marks)  # the outline is closed
            else:
                self._choose(marks, name)

    def finish(self) -> None:
        """Measure between the picks that were chosen; raises as `click`."""
        with self._changing() as marks:
            self._finish(marks)

    def cancel(self) -> None:
        """Give up the measurement that is being made, and the picks that only it used."""
        with self._changing():
            self._cancel()

    def set_kind(self, kind: str) -> None:
        """Choose what is measured next; raises a MeasurementError for an unknown kind."""
        if kind not in KINDS:
            raise MeasurementError(f'{shortened(kind)} is no kind of measurement')
        with self._changing():
            if kind != self.kind:
                self._cancel()
            self.kind = kind

    def delete_pick(self, name: str) -> None:
        """Delete a pick and all that is measured with it."""
        with self._changing() as marks:
            self.board.pick(name)
            self.board.change(marks.without(name))

    def delete_measurement(self, number: int) -> None:
        """Delete a measurement, counted from 0, and the picks that only it used."""
        with self._changing() as marks:
            if not 0 <= number < len(marks.requests):
                raise MeasurementError('this measurement is not there any more')
            self.board.change(marks.without_request(number))

    def rename(self, name: str, to: str) -> None:
        """Give a pick another name; raises as `PicksBoard.rename`."""
        with self._changing():
            self.board.rename(name, to)

    def undo(self) -> None:
        """Take back the last change of picks and measurements."""
        with self._changing():
            self.board.undo()

    def redo(self) -> None:
        """Make the change again that was taken back last."""
        with self._changing():
            self.board.redo()

    def probe(self, u: float, v: float) -> Measurement:
        """Return where the pixel of the shown frame is, as a point; raises as `click`."""
        with self._lock:
            pick = Pick('here', np.array([u, v]), frame=self.shown.frame)
            return measure(self._measurer.session([pick]), Request('point', ('here',), 'here'))

    # what is shown

    def show(self, **changes: object) -> None:
        """Show another frame, colour or range of depths: the fields of `Shown`.

        Raises
        ------
        ConfigError
            If there is no such colour, or nothing between the depths.
        FileError, CalibrationError
            If the frame cannot be read.

        """
        with self._changing():
            wanted = replace(self.shown, **changes)  # type: ignore[arg-type]
            if wanted.colour not in COLOURS:
                raise ConfigError(f'{shortened(wanted.colour)} is no way of colouring')
            if not wanted.near_m < wanted.far_m:
                raise ConfigError(
                    f'the nearest depth shown, {wanted.near_m:g} m, must be below the farthest,'
                    f' {wanted.far_m:g} m'
                )
            if wanted.frame != self.shown.frame:
                self.awaited = None
            self.displayed = coloured(self._measurer.session(), wanted, self._most_points)
            self.shown, self.image_revision = wanted, self.revision + 1

    @property
    def frame(self) -> MeasuredFrame:
        """The shown frame."""
        return self.displayed.frame

    def up(self) -> FloatArray:
        """Return the unit vector against gravity, (3,): of site or ground, or of the camera."""
        with self._lock:
            try:
                source, up_of = self._measurer.session().up(self.shown.frame)
            except MeasurementError:
                return np.array(_CAMERA_UP)
            return up_of(source.values)

    # results

    def measured(self, request: Request) -> Measurement:
        """Return a measurement between picks of the board; raises as `measure`."""
        with self._lock:
            return self._measurer.measure(
                [self.board.pick(name) for name in request.points], request
            )

    def place(self, name: str) -> FloatArray | None:
        """Return the point (3,) of a pick, m; None if it is on a hole."""
        with self._lock, suppress(MeasurementError):
            found = self.measured(default_request('point', (name,))).quantities
            return np.array([found[axis].value for axis in 'xyz'])
        return None

    def held(self) -> AbstractContextManager[bool]:
        """Return what lets nothing change while it is open."""
        return self._lock

    def _choose(self, marks: Marks, name: str) -> None:
        kind = KINDS[self.kind]
        marks = replace(marks, chosen=(*marks.chosen, name))
        if len(marks.chosen) == kind.most:
            self._finish(marks)
        else:
            self.board.change(marks)

    def _finish(self, marks: Marks) -> None:
        request = default_request(self.kind, marks.chosen)
        self._measurer.measure([marks.picks[name] for name in marks.chosen], request)
        requests = marks.requests
        if request not in requests:
            requests = (*requests, request)
        self.board.change(replace(marks, requests=requests, chosen=()))

    def _cancel(self) -> None:
        marks, self.awaited = self.board.marks, None
        if marks.chosen:
            used = {name for one in marks.requests for name in one.points}
            gone = set(marks.chosen) - used
            kept = {name: pick for name, pick in marks.picks.items() if name not in gone}
            self.board.change(Marks(kept, marks.requests))
