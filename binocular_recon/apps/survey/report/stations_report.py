# SPDX-License-Identifier: Apache-2.0
"""The report of several stations: how they fit together, and what each of them states."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon.apps.summary_entries import STATIONS
from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.apps.survey.report import findings, recording, rig
from binocular_recon.apps.survey.report.cloud import Seen, cloud_of_stations
from binocular_recon.apps.survey.report.images import photo
from binocular_recon.apps.survey.report.sources import (
    ReportDetails,
    ReportSources,
    Statements,
    text,
)
from binocular_recon.apps.survey.report.whole_page import checked, notes, page_around_cloud
from binocular_recon.apps.survey.stations_folder import CLOUD, MOST_OFF_SIGMAS, read_stations
from binocular_recon.drawing.page import cards, section, table
from binocular_recon.errors import BinocularReconError, ConfigError
from binocular_recon.io.exports.placement import Placement
from binocular_recon.io.exports.point_table import PointTable
from binocular_recon.measurement.results import CHECK_FILE, MEASUREMENTS_FILE
from binocular_recon.measurement.site.tie import TIE_FILE
from binocular_recon.number_text import fixed, plain, significant


@dataclass(eq=False)
class _Stations(Statements):
    """What the report is made from: ``stations.json``, and the folders of the stations.

    Attributes
    ----------
    folder : Path
    details : ReportDetails
    content : dict
        Of ``stations.json``.
    missing : list of str
        What could not be stated so far, as text.

    """

    folder: Path
    details: ReportDetails
    content: dict[str, Any]
    missing: list[str] = field(default_factory=list)

    @property
    def entries(self) -> list[dict[str, Any]]:
        """What is said of each station."""
        entries: list[dict[str, Any]] = self.content['stations']
        return entries

    @cached_property
    def names(self) -> list[str]:
        """Names of the stations: of their folders, with those above where two are alike."""
        folders = [Path(str(one['folder'])) for one in self.entries]
        short = [folder.name for folder in folders]
        alike = len(set(short)) < len(short)
        return [str(Path(*folder.parts[-2:])) if alike else folder.name for folder in folders]

    @cached_property
    def sources(self) -> list[ReportSources | None]:
        """The folder of each station, None if it cannot be read any more."""
        found: list[ReportSources | None] = []
        for name, entry in zip(self.names, self.entries, strict=True):
            folder = Path(str(entry['folder']))
            if not folder.exists():  # all may have been moved together
                folder = self.folder.resolve().parent / folder.name
            try:
                found.append(ReportSources(MeasuredFolder(folder), self.details))
            except BinocularReconError:
                self.missing.append(
                    f'images and control points of {name}: {entry["folder"]} is not there'
                )
                found.append(None)
        return found

    @property
    def day(self) -> str:
        """The days of the survey; empty if they are not known."""
        days = [one.day for one in self.sources if one]
        return ', '.join(dict.fromkeys(filter(None, days)))


def render_stations(folder: Path, details: ReportDetails) -> str:
    """Return the report of a folder that `merge` made of several stations, as an HTML page.

    Raises
    ------
    ConfigError
        If frames are to be shown, which the folder does not have.
    BinocularReconError
        If a file is damaged.

    """
    if details.frames != ReportDetails().frames:
        raise ConfigError(
            f'{folder} holds the cloud of several stations, which has no frames; leave --frames'
            ' out, or give the output folder of one station'
        )
    stations = _Stations(folder, details, read_stations(folder))
    points = PointTable.of_file(folder / f'{CLOUD}.ply')
    part = partial(checked, folder, STATIONS)
    first = part(lambda: _facts(stations))
    parts = [
        part(lambda: _residuals(stations)),
        part(lambda: _places(stations)),
        *_own(stations),
        part(lambda: _versions(stations.content)),
        recording.signatures(),
    ]
    glance = part(lambda: _glance(stations, len(points)))
    lines = [f'Not stated: {text(one)}.' for one in stations.missing] + part(
        lambda: [*_warnings(stations)]
    )
    content = stations.content
    seen = part(lambda: _seen(content))
    voxel_m = part(lambda: float(content['voxel_size_m']))
    return page_around_cloud(
        details,
        stations.day,
        [glance, notes(lines), first],
        partial(cloud_of_stations, points, seen, voxel_m),
        parts,
    )


def _seen(content: Mapping[str, Any]) -> Seen:
    """Return the view of the first station's camera."""
    one = content['stations'][0]
    R, t = (np.array(one[name], np.float64) for name in ('R', 't'))
    if not content['tied']:
        return Seen()
    return Seen.of(Placement(R, t), content['axes'], level=content['level'] is True)


def _glance(stations: _Stations, points: int) -> str:
    worst = max((one.get('distance_over_sigma', 0.0) for one in stations.entries), default=0.0)
    rms_m = [one['distance_rms_m'] for one in stations.entries if 'distance_rms_m' in one]
    control = [findings.control_rms_mm(one.tie) for one in stations.sources if one]
    control = [one for one in control if one]
    figures = [
        (f'{len(stations.entries)}', 'stations'),
        (f'{points}', 'points of all stations'),
        (f'{1e3 * max(rms_m):.1f} mm' if rms_m else 'none',
         'largest RMS distance of a station to the surfaces of the others'),
        (f'{fixed(worst, 2)}', 'the same in standard deviations'),
    ]  # fmt: skip
    if stations.content['tied']:
        shown = f'{max(control, key=float)} mm' if control else 'none'
        figures.append((shown, 'largest RMS residual of the control points of a station'))
    warned = [2] if not rms_m else []
    return cards(figures, [*warned, *([3] if worst > MOST_OFF_SIGMAS else [])])


def _warnings(stations: _Stations) -> Iterator[str]:
    for name, one in zip(stations.names, stations.entries, strict=True):
        if 'distance_rms_m' not in one:
            yield f'{text(name)} shares no surface with the other stations.'
        elif one['distance_over_sigma'] > MOST_OFF_SIGMAS:
            yield (
                f'The surfaces of {text(name)} are {fixed(one["distance_over_sigma"], 2)} standard'
                ' deviations from those of the others (RMS).'
            )


def _facts(stations: _Stations) -> str:
    content = stations.content
    axes = ', '.join(text(one) for one in content['axes'])
    where = f'{text(content["crs"])}: ' if content['crs'] else 'frame of the site: '
    if not content['tied']:
        where = f'rectified left camera of {text(stations.names[0])}, right, down and forward: '
    how = 'control points' if content['tied'] else 'what they both see (overlap)'
    rows = [
        *recording.occasion(stations),
        ('Stations', ', '.join(map(text, stations.names))),
        ('Joined by', how),
        ('Coordinates', f'{where}{axes}, metres{", level" if content["level"] else ""}'),
        ('One point per cube of', f'{plain(1e3 * content["voxel_size_m"])} mm'),
        ('Output folder', text(stations.folder)),
    ]
    return section('The survey', 'What was surveyed, and with what.', recording.words(rows))


def _residuals(stations: _Stations) -> str:
    rows = []
    for name, one in zip(stations.names, stations.entries, strict=True):
        rows.append(
            (
                text(name),
                f'{100 * one["overlap"]:.0f} %',
                *(
                    fixed(1e3 * one[key] if key in one else None, 1)
                    for key in ('distance_median_m', 'distance_rms_m')
                ),
                fixed(one.get('distance_over_sigma'), 2),
                text(one['points']),
                text(one['voxels']),
            )
        )
    head = (
        'station', 'on surfaces of others', 'median, mm', 'RMS, mm', 'RMS / sigma', 'points',
        'cubes',
    )  # fmt: skip
    return section(
        'How the stations fit together',
        'The share of the points of a station that lie on surfaces of the other stations, and how'
        f' far off these they are. From {MOST_OFF_SIGMAS:g} sigma on a station is warned of.',
        f'<div class="scroll">{table(head, rows, kind="long")}</div>',
    )


def _places(stations: _Stations) -> str:
    content, tied = stations.content, stations.content['tied']
    rows = []
    for name, one in zip(stations.names, stations.entries, strict=True):
        sigma = one.get('place_sigma_m') or [None] * 3
        places = zip(one['t'], sigma, strict=True)
        shared = one['shared_features']
        rows.append(
            (
                text(name),
                *(
                    fixed(place, 3) + ('' if off is None else f' ± {significant(off, 2)}')
                    for place, off in places
                ),
                '-' if shared is None else text(shared),
            )
        )
    head = ('camera of station', *(f'{text(one)}, m' for one in content['axes']),
            'shared features')  # fmt: skip
    words = (
        'Each lies where its own control points put it.'
        if tied
        else 'The first defines the frame; each other one is joined to one that lies already.'
    )
    return section(
        'Where the stations stood',
        f'Place of the left camera. {words}',
        table(head, rows, kind='long wide'),
    )


def _own(stations: _Stations) -> Iterator[str]:
    """Yield what the stations state themselves; what they lack is added to what is missing."""
    there = [
        (name, sources)
        for name, sources in zip(stations.names, stations.sources, strict=True)
        if sources
    ]
    if there:
        images = [
            photo(checked(one.folder.folder, 'summary.json', partial(one.folder.left_bgr, 0)),
                  text(name))
            for name, one in there
        ]  # fmt: skip
        yield section('What the stations saw', 'Left images, rectified.', *images)
    for name, one in there:
        if stations.content['tied'] and one.tie is not None:
            yield _of(name, _part_of(one, TIE_FILE, findings.control_points))
        if one.measurements is not None:
            yield _of(name, _part_of(one, MEASUREMENTS_FILE, findings.measurements))
    # stated once for the stations of one rig that were checked alike
    calibrated: dict[str, list[str]] = {}
    for name, one in there:
        html = _part_of(one, f'calibration.json or {CHECK_FILE}', rig.calibration)
        calibrated.setdefault(html, []).append(name)
    for html, names in calibrated.items():
        yield html if len(calibrated) == 1 else _of(', '.join(names), html)
    stations.missing += dict.fromkeys(line for _, one in there for line in one.missing)


def _part_of(one: ReportSources, file: str, make: Callable[[ReportSources], str]) -> str:
    return checked(one.folder.folder, file, partial(make, one))


def _of(name: str, html: str) -> str:
    """Return a section with the name of its stations in the title."""
    return html.replace('<h2>', f'<h2>{text(name)}: ', 1)


def _versions(content: Mapping[str, Any]) -> str:
    return section(
        'Versions', 'Of what joined the stations.', recording.version_table(content['versions'])
    )
