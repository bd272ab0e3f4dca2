# SPDX-License-Identifier: Apache-2.0
"""Measurements between picks of a folder, each made once while few frames are held."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.apps.survey.measuring import open_session
from binocular_recon.errors import MeasurementError
from binocular_recon.measurement.kinds import measure
from binocular_recon.measurement.picks import Pick, Request
from binocular_recon.measurement.results import Measurement
from binocular_recon.measurement.session import MeasuringSession

_MOST_FRAMES = 4


class Measurer:
    """Measures as `measure` of the command line does.

    Parameters
    ----------
    folder : MeasuredFolder
    picks : iterable of Pick
        Picks that there are already.
    pick_sigma_px : float
        One standard deviation of picks, on each axis.

    Raises
    ------
    MeasurementError
        If a pick is in a frame that the folder does not have.

    """

    def __init__(
        self, folder: MeasuredFolder, picks: Iterable[Pick], pick_sigma_px: float
    ) -> None:
        self._folder, self._pick_sigma_px = folder, pick_sigma_px
        self._session = open_session(folder, list(picks), pick_sigma_px)
        self._found: dict[tuple[object, ...], Measurement | str] = {}

    def session(self, picks: Iterable[Pick] = ()) -> MeasuringSession:
        """Return a session of picks; what was read of the last frames is kept."""
        if self._session.frame.cache_info().currsize > _MOST_FRAMES:
            self._session = open_session(self._folder, (), self._pick_sigma_px)
        return self._session.with_picks(picks)

    def measure(self, picks: Sequence[Pick], request: Request) -> Measurement:
        """Return what is asked for between picks; raises a MeasurementError as `measure`."""
        key = (request.kind, *picks)
        if key not in self._found:
            try:
                self._found[key] = measure(self.session(picks), request)
            except MeasurementError as error:
                self._found[key] = str(error)
        found = self._found[key]
        if isinstance(found, str):
            raise MeasurementError(found)
        return replace(found, name=request.name)
