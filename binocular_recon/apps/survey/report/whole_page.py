# SPDX-License-Identifier: Apache-2.0
"""What every report has: title, logo, what is missing, and the cloud in the room that is left."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

from binocular_recon.apps.survey.report.sources import ReportDetails
from binocular_recon.drawing.cloud_view import cloud_script
from binocular_recon.drawing.page import embedded_image, page
from binocular_recon.errors import BinocularReconError, ConfigError, FileError, shortened
from binocular_recon.io.image_files import read_image_file
from binocular_recon.machine import now_text
from binocular_recon.number_text import day_text

_Made = TypeVar('_Made')

_FOOTER = 'Uncertainties are one standard deviation.'
_LOGO_FORMATS = {'.png': 'png', '.jpg': 'jpeg', '.jpeg': 'jpeg'}
_LARGEST_LOGO = 1_000_000
# What stands around the points and the image of the cloud takes less, bytes.
_AROUND_CLOUD = 4000


def checked(folder: Path, name: str, make: Callable[[], _Made]) -> _Made:
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


def page_around_cloud(
    details: ReportDetails,
    day: str,
    before: Sequence[str],
    cloud: Callable[[int], str],
    after: Sequence[str],
) -> str:
    """Return the page of a report, with a cloud that takes the room that the rest leaves.

    Parameters
    ----------
    details : ReportDetails
    day : str
        The day of the survey, empty if it is not known.
    before, after : sequence of str
        HTML of the sections before and behind the cloud.
    cloud : callable
        Returns the section of the cloud for the bytes that its points and its image may take.

    """
    logo = _logo(details.logo)
    words = [
        f'Survey report of {day_text(now_text())}',
        f'for {details.client}' if details.client else '',
        f'surveyed {day}' if day else '',
    ]

    def whole(view: str) -> str:
        return page(
            details.site or 'Survey report',
            [*before, view, *after],
            _FOOTER,
            subtitle=' · '.join(filter(None, words)),
            logo=logo,
            script=cloud_script(),
        )

    around = len(whole('').encode(errors='backslashreplace')) + _AROUND_CLOUD
    return whole(cloud(details.most_bytes - around))


def notes(lines: Iterable[str]) -> str:
    """Return what a report cannot state and what to know before relying on it; lines are HTML."""
    items = ''.join(f'<li>{line}</li>' for line in lines)
    if not items:
        return '<p class="good">Nothing is missing in this report.</p>'
    return f'<ul class="notes">{items}</ul>'


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
