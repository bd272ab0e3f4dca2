# SPDX-License-Identifier: Apache-2.0
"""Put the sections of a report together and write it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.apps.survey.report import findings, recording, rig
from binocular_recon.apps.survey.report.cloud import cloud
from binocular_recon.apps.survey.report.frames import frame_maps
from binocular_recon.apps.survey.report.sources import ReportDetails, ReportSources, text
from binocular_recon.apps.survey.report.stations_report import render_stations
from binocular_recon.apps.survey.report.whole_page import checked, notes, page_around_cloud
from binocular_recon.apps.survey.stations_folder import is_of_stations
from binocular_recon.drawing.page import cards
from binocular_recon.io.files import write_text
from binocular_recon.measurement.results import CHECK_FILE, MEASUREMENTS_FILE
from binocular_recon.measurement.site.tie import TIE_FILE
from binocular_recon.number_text import counted, fixed

REPORT_FILE = 'report.html'


def write_report(folder: Path, details: ReportDetails, output: Path | None = None) -> Path:
    """Write the report of an output folder of `reconstruct` or of several stations.

    Parameters
    ----------
    folder : Path
    details : ReportDetails
    output : Path, optional
        The file; by default ``report.html`` in the folder.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    BinocularReconError
        If the folder holds no reconstruction, one of its files is damaged, a frame does not
        exist, or the report cannot be written.

    """
    html = (render_stations if is_of_stations(folder) else render)(folder, details)
    path = output or folder / REPORT_FILE
    write_text(path, html)
    return path


def render(folder: Path, details: ReportDetails) -> str:
    """Return the report as an HTML page; raises as `write_report`."""
    sources = ReportSources(MeasuredFolder(folder), details)
    numbers = details.frames
    frames = [checked(folder, 'summary.json', partial(sources.folder.frame, n)) for n in numbers]

    def part(name: str, make: Callable[[ReportSources], str]) -> str:
        return checked(folder, name, partial(make, sources))

    # first, since others state its axes
    tied = part(TIE_FILE, findings.control_points)
    # in the order of the page
    first = part('summary.json', recording.facts)
    rest = [
        part(MEASUREMENTS_FILE, findings.measurements),
        tied,
        part(f'calibration.json or {CHECK_FILE}', rig.calibration),
        *(frame_maps(sources, *one) for one in zip(numbers, frames, strict=True)),
        part('summary.json', recording.frame_table),
        part('summary.json', recording.left_out),
        part('summary.json', recording.options),
        recording.signatures(),
    ]
    glance = part('summary.json', _glance)
    lines = [f'Not stated: {text(one)}.' for one in sources.missing]
    if left := sources.summary.get('left_out'):
        pairs = counted(len(left), 'image pair was', 'image pairs were')
        lines.append(f'{pairs} left out; see below.')
    return page_around_cloud(
        details,
        sources.day,
        [glance, notes(lines), first],
        partial(cloud, sources, numbers[0], frames[0]),
        rest,
    )


def _glance(sources: ReportSources) -> str:
    """Return the key figures."""
    summary, content = sources.summary, sources.calibration
    depths = [f['depth_m']['median'] for f in summary['frames'] if f['depth_m']['median']]
    middle = float(np.median(depths)) if depths else float('nan')
    control = findings.control_rms_mm(sources.tie)
    count = len((sources.measurements or {}).get('measurements', ()))
    figures = [
        (f'{100 * summary["matched"]:.1f} %', 'of the pixels were measured, not filled'),
        (f'{fixed(middle, 1)} m', 'median depth of the points'),
        (f'{count}', 'measurements, each with its standard deviation'),
        (f'{control} mm' if control else 'none', 'residuals of the control points, RMS'),
        (rig.check_verdict(sources), 'check distance against the calibration'),
    ]
    if isinstance(content, dict) and (sigmas := content['depth_sigma_m']):
        depth = min(sigmas, key=lambda one: abs(float(one) - middle))
        if sigmas[depth] is not None:
            figures.insert(
                2,
                (f'{1e3 * sigmas[depth]:.0f} mm', f'predicted sigma of depth at {text(depth)} m'),
            )
    warned = [i for i, (value, _) in enumerate(figures) if value in {'none', 'FAILED', '0'}]
    return cards(figures, warned)
