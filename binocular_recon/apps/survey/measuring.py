# SPDX-License-Identifier: Apache-2.0
"""Measure in an output folder: tables and images of what was measured."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.drawing.measurements import Drawn, draw_measurements
from binocular_recon.errors import MeasurementError
from binocular_recon.io.files import make_folder
from binocular_recon.io.image_files import write_image_file
from binocular_recon.measurement.kinds import measure
from binocular_recon.measurement.picks import Pick, Request
from binocular_recon.measurement.results import Measurement, write_results
from binocular_recon.measurement.session import MeasuringSession
from binocular_recon.measurement.site.tie import TIE_FILE, read_tie
from binocular_recon.measurement.snapping import PICK_SIGMA_PX
from binocular_recon.stereo.point_covariance import sigma_shares


def open_session(
    folder: MeasuredFolder, picks: Sequence[Pick], pick_sigma_px: float = PICK_SIGMA_PX
) -> MeasuringSession:
    """Return a session on the frames of a folder, tied to the site if the folder is."""
    wrong = sorted({pick.frame for pick in picks if not 0 <= pick.frame < folder.count})
    if wrong:
        raise MeasurementError(
            f'there are picks in frame {wrong[0]}, but {folder.folder} holds {folder.count}'
            f' frame{"" if folder.count == 1 else "s"}, counted from 0'
        )
    path = folder.folder / TIE_FILE
    tie = read_tie(path) if path.exists() else None
    return MeasuringSession(folder.frame, picks, pick_sigma_px, tie)


def default_requests(picks: Sequence[Pick]) -> list[Request]:
    """Return what is measured if nothing is asked: points, and the distance of each to the next.

    Distances are those within one frame.
    """
    requests = [Request('point', (pick.name,), pick.name) for pick in picks]
    for first, last in itertools.pairwise(picks):
        if first.frame == last.frame:
            requests.append(Request.of(f'distance {first.name} {last.name}'))
    return requests


def measure_all(
    session: MeasuringSession, requests: Sequence[Request]
) -> tuple[list[Measurement], list[str]]:
    """Return the measurements, and why others could not be made."""
    found, problems = [], []
    for request in requests:
        try:
            found.append(measure(session, request))
        except MeasurementError as error:  # noqa: PERF203 - the others can still be measured
            problems.append(f'{request.name}: {error}')
    return found, problems


def write_measurements(
    folder: MeasuredFolder, output: Path, session: MeasuringSession, found: list[Measurement]
) -> list[Path]:
    """Write tables, and the image of each frame with what was measured in it.

    Returns the paths. Raises a FileError if one cannot be written.
    """
    make_folder(output)
    calibrated = session.frame(found[0].frame).rig.covariance is not None
    facts = {
        'reconstruction': str(folder.folder),
        'sigma': sigma_shares(calibrated),
        'pick_sigma_px': session.pick_sigma_px,
        'frame': 'left rectified optical frame: x right, y down, z forward, metres',
        'picks': {
            pick.name: {
                'frame': pick.frame,
                'left_px': pick.pixel.tolist(),
                'right_px': None if pick.right is None else pick.right.tolist(),
            }
            for pick in session.picks.values()
        },
    }
    paths = write_results(output, found, facts)
    for number in sorted({one.frame for one in found}):
        here = [one for one in found if one.frame == number]
        drawn = [Drawn(one.outline_px, one.closed, one.label) for one in here]
        path = output / f'measured_{number:06d}.png'
        write_image_file(path, draw_measurements(session.frame(number).left_bgr, drawn))
        paths.append(path)
    return paths
