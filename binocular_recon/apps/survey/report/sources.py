# SPDX-License-Identifier: Apache-2.0
"""What a report is made from: the files of an output folder, and of its calibration."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime, timezone
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

from binocular_recon.apps.earlier_run import fingerprint
from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.errors import FileError, plain_text
from binocular_recon.images import Image
from binocular_recon.io.image_files import read_image_file
from binocular_recon.io.text_files import read_json
from binocular_recon.measurement.results import CHECK_FILE, MEASUREMENTS_FILE
from binocular_recon.measurement.site.tie import TIE_FILE
from binocular_recon.number_text import day_text

# Earlier stamps are those of a simulation or of a clock that was not set.
_FIRST_YEAR = 2000


@dataclass(frozen=True)
class ReportDetails:
    """What a report states that no file holds.

    Attributes
    ----------
    site, client, author, date : str
        Name of the site, who ordered the survey, who made it, and when (YYYY-MM-DD); empty if not
        given.
    logo : Path, optional
        PNG or JPEG beside the title.
    calibration : Path, optional
        Folder of the calibration; by default where `reconstruct` found it.
    frames : tuple of int
        Frames that are shown; the cloud is that of the first.
    most_bytes : int
        Largest size of the file; the cloud is thinned to it.

    """

    site: str = ''
    client: str = ''
    author: str = ''
    date: str = ''
    logo: Path | None = None
    calibration: Path | None = None
    frames: tuple[int, ...] = (0,)
    most_bytes: int = 10_000_000


class Statements:
    """What a report states of itself, and a list of what it cannot state.

    Attributes
    ----------
    details : ReportDetails
    missing : list of str
        What could not be stated so far, as text.

    """

    details: ReportDetails
    missing: list[str]

    @property
    def day(self) -> str:
        """The day of the survey as text; empty if it is not known."""
        raise NotImplementedError

    def lacks(self, what: str, remedy: str) -> str:
        """Note that something cannot be stated; returns the HTML that stands for it."""
        self.missing.append(f'{what}: {remedy}')
        return f'<span class="missing">not stated: {text(remedy)}</span>'


@dataclass(eq=False)
class ReportSources(Statements):
    """The files that a report is made from.

    Attributes
    ----------
    folder : MeasuredFolder
    details : ReportDetails
    missing : list of str
        What could not be stated so far, as text.

    """

    folder: MeasuredFolder
    details: ReportDetails
    missing: list[str] = field(default_factory=list)
    _image: tuple[Path, Image] | None = None

    @property
    def summary(self) -> dict[str, Any]:
        """Content of ``summary.json``."""
        return self.folder.summary

    @cached_property
    def measurements(self) -> dict[str, Any] | None:
        """Content of ``measurements.json``, None if nothing was measured."""
        return self._read(MEASUREMENTS_FILE, 'measure again')

    @cached_property
    def tie(self) -> dict[str, Any] | None:
        """Content of ``georeference.json``, None if there is none."""
        return self._read(TIE_FILE, 'georeference again')

    @cached_property
    def check(self) -> dict[str, Any] | None:
        """Content of ``check.json``, None if no check distance was written."""
        return self._read(CHECK_FILE, 'check again')

    @cached_property
    def calibration(self) -> dict[str, Any] | str:
        """Content of ``calibration.json``, or why it cannot be stated."""
        source = self.summary.get('source')
        source = source if isinstance(source, dict) else {}
        stated = self.details.calibration or source.get('calibrated_in')
        if not stated:
            return 'the summary does not say where the calibration is (--calibration DIR)'
        path = Path(stated)
        if not (path / 'calibration.json').is_file():
            return f'there is no calibration.json in {path} (--calibration DIR)'
        used, there = source.get('calibration'), fingerprint(path)
        if isinstance(used, dict):
            for name in ('left.yaml', 'right.yaml'):
                if used.get(name) != there.get(name):
                    return f'the calibration in {path} is not the one that was used'
        content = read_json(path / 'calibration.json', 'calibrate again')
        return content if isinstance(content, dict) else f'{path} holds no calibration'

    @cached_property
    def recorded(self) -> list[datetime]:
        """When the first and the last frame were recorded, UTC; empty if that is not known."""
        stamps = [frame.get('stamp_ns') for frame in self.summary['frames']]
        times = [
            datetime.fromtimestamp(stamp / 1e9, timezone.utc)
            for stamp in stamps
            if isinstance(stamp, int) and 0 < stamp < 1 << 63
        ]
        times = [time for time in times if time.year >= _FIRST_YEAR]
        return [min(times), max(times)] if times else []

    @property
    def day(self) -> str:
        """The day of the survey as text; empty if it is not known."""
        if self.details.date:
            return day_text(self.details.date)
        days = [day_text(time.isoformat()) for time in self.recorded]
        return ' to '.join(dict.fromkeys(days))

    def image(self, path: Path) -> Image:
        """Read an image, once if it is asked for again right away."""
        if self._image is None or self._image[0] != path:
            self._image = path, read_image_file(path)
        return self._image[1]

    def _read(self, name: str, remedy: str) -> dict[str, Any] | None:
        path = self.folder.folder / name
        if not path.exists():
            return None
        content = read_json(path, remedy)
        if not isinstance(content, dict):
            raise FileError(f'{path} is not what our commands write; {remedy}')
        return content


def text(value: object) -> str:
    """Return something from a file as HTML."""
    return escape(plain_text(str(value)))
