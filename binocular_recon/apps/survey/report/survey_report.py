# SPDX-License-Identifier: Apache-2.0
"""Put the sections of a report together and write it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.apps.survey.report import findings, recording, rig
from binocular_recon.apps.survey.report.cloud import cloud
from binocular_recon.apps.survey.report.frames import frame_maps
from binocular_recon.apps.survey.report.sources import ReportDetails, ReportSources, text
from binocular_recon.drawing.cloud_view import cloud_script
from binocular_recon.drawing.page import cards, embedded_image, page
from binocular_recon.errors import BinocularReconError, ConfigError, FileError, shortened
from binocular_recon.io.files import write_text
from binocular_recon.io.image_files import read_image_file
from binocular_recon.machine import now_text
from binocular_recon.measurement.check_distance import CHECK_FILE
from binocular_recon.measurement.results import MEASUREMENTS_FILE
from binocular_recon.measurement.site.tie import TIE_FILE
from binocular_recon.number_text import day_text, fixed

_Made = TypeVar('_Made')

REPORT_FILE = 'report.html'
_FOOTER = 'Uncertainties are one standard deviation.'
_LOGO_FORMATS = {'.png': 'png', '.jpg': 'jpeg', '.jpeg': 'jpeg'}
_LARGEST_LOGO = 1_000_000
# What stands around the points and the image of the cloud takes less, bytes.
_AROUND_CLOUD = 4000


def write_report(folder: Path, details: ReportDetails, output: Path | None = None) -> Path:
    """Write the report of an output folder of `reconstruct`.

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
    html = render(folder, details)
    path = output or folder / REPORT_FILE
    write_text(path, html)
    return path


def render(folder: Path, details: ReportDetails) -> str:
    """Return the report as an HTML page; raises as `write_report`."""
    sources = ReportSources(MeasuredFolder(folder), details)
    logo = _logo(details.logo)
    numbers = details.frames
    frames = [_part(folder, 'summary.json', partial(sources.folder.frame, n)) for n in numbers]

    def part(name: str, make: Callable[[ReportSources], str]) -> str:
        return _part(folder, name, partial(make, sources))

    # first, since others state its axes
    tied = part(TIE_FILE, findings.control_points)
    # in the order of the page; the cloud gets the room that is left
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

    def whole(view: str) -> str:
        return page(
            details.site or 'Survey report',
            [glance, _notes(sources), first, view, *rest],
            _FOOTER,
            subtitle=_subtitle(sources),
            logo=logo,
            script=cloud_script(),
        )

    room = details.most_bytes - len(whole('').encode(errors='backslashreplace')) - _AROUND_CLOUD
    return whole(cloud(sources, numbers[0], frames[0], room))


def _part(folder: Path, name: str, make: Callable[[], _Made]) -> _Made:
    """Return what is made from a file; raises a FileError if it is not as it should be."""
    try:
        return make()
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        if isinstance(error, BinocularReconError):
            raise
        raise FileError(
            f'{name} in {folder} is not as our commands write it ({shortened(error)}); make it'
            ' again'
        ) from error


def _subtitle(sources: ReportSources) -> str:
    details = sources.details
    words = [
        f'Survey report of {day_text(now_text())}',
        f'for {details.client}' if details.client else '',
        f'surveyed {sources.day}' if sources.day else '',
    ]
    return ' · '.join(filter(None, words))


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


def _notes(sources: ReportSources) -> str:
    """Return what the report cannot state, and what to know before relying on it."""
    notes = [f'Not stated: {text(one)}.' for one in sources.missing]
    if left := sources.summary.get('left_out'):
        notes.append(f'{len(left)} image pairs were left out; see below.')
    if not notes:
        return '<p class="good">Nothing is missing in this report.</p>'
    return f'<ul class="notes">{"".join(f"<li>{note}</li>" for note in notes)}</ul>'


def _logo(path: Path | None) -> str:
    """Return the HTML of a logo."""
    if path is None:
        return ''
    format_ = _LOGO_FORMATS.get(path.suffix.lower())
    if format_ is None:
        raise ConfigError(f'--logo must be a PNG or JPEG file, got {path}')
    read_image_file(path)  # it must be one
    data = path.read_bytes()
    if len(data) > _LARGEST_LOGO:
        raise ConfigError(
            f'{path} has {len(data) / 1e6:.1f} MB; a logo may have {_LARGEST_LOGO / 1e6:g} MB'
        )
    return embedded_image(data, format_, 'logo')
