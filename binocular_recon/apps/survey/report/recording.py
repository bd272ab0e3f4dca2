# SPDX-License-Identifier: Apache-2.0
"""Sections about the recording: what it is of, what was left out and why, the options."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from binocular_recon.apps.survey.report.sources import ReportSources, Statements, text
from binocular_recon.drawing.page import section, table
from binocular_recon.number_text import counted, fixed, plain, reach, significant

# Rows of a table; of longer recordings the first are shown.
_MOST_ROWS = 100


def facts(sources: ReportSources) -> str:
    """Return the section that says what was surveyed, when, by whom and with what."""
    summary = sources.summary
    rows = [
        *occasion(sources),
        ('Images', _images(summary)),
        ('Rig', _rig(sources)),
        ('Coordinates', _coordinates(sources)),
        ('Standard deviations hold', text(summary.get('sigma', 'matching'))),
        ('Output folder', text(sources.folder.folder)),
    ]
    return section('The survey', 'What was surveyed, and with what.', words(rows))


def occasion(report: Statements) -> list[tuple[str, str]]:
    """Return the rows that say what was surveyed, for whom, by whom and when, HTML."""
    details = report.details
    return [
        ('Site', text(details.site) or report.lacks('site', '--site')),
        ('Client', text(details.client) or report.lacks('client', '--client')),
        ('Surveyed by', text(details.author) or report.lacks('author', '--author')),
        ('Date', text(report.day) or report.lacks('date', 'images have no time; --date')),
    ]


def _images(summary: Mapping[str, Any]) -> str:
    source = summary.get('source')
    source = source if isinstance(source, dict) else {}
    names = [source[key] for key in ('bag', 'left', 'right') if source.get(key)]
    pairs = counted(len(summary['frames']), 'image pair')
    return f'{pairs} of {text(", ".join(map(str, names)) or "an unknown source")}'


def _rig(sources: ReportSources) -> str:
    summary = sources.summary
    width, height = sources.folder.rig().left.size
    return (
        f'baseline {fixed(summary["baseline_m"], 3)} m, focal length'
        f' {fixed(summary["focal_px"], 1)} px, images of {width} x {height} px'
    )


def _coordinates(sources: ReportSources) -> str:
    tie = sources.tie
    if tie is None:
        return 'rectified left camera: x right, y down, z forward, metres'
    axes = ', '.join(map(text, tie['axes']))
    if crs := tie.get('crs'):
        return f'EPSG:{text(crs["epsg"])} {text(crs["name"])}: {axes}, metres'
    return f'frame of the site: {axes}, metres{", level" if tie["level"] else ""}'


def left_out(sources: ReportSources) -> str:
    """Return the section about what is not in the result, with the warnings of the run."""
    summary = sources.summary
    pairs = summary.get('left_out') or []
    rows = [
        (text(' and '.join(one.get('images') or [f'pair at {one.get("stamp_ns")} ns'])),
         text(one['reason']))
        for one in pairs[:_MOST_ROWS]
    ]  # fmt: skip
    notes = [text(one) for one in summary.get('damage') or []]
    if unpaired := summary.get('unpaired'):
        read = summary['images_read']
        has = counted(unpaired, f'of {read} images has', f'of {read} images have')
        notes.append(text(f'{has} no partner.'))
    notes += [f'<b>Frame {text(index)}:</b> {text(words)}' for index, words in _warnings(summary)]
    if not summary.get('finished'):
        notes.append('The run was interrupted: more image pairs may exist.')
    items = ''.join(f'<li>{note}</li>' for note in notes)
    count = counted(len(pairs), 'image pair was', 'image pairs were')
    count = count if pairs else 'No image pair was'
    return section(
        'What was left out, and why',
        f'{count} left out. Pixels without a match are filled from around them or have no point;'
        ' the table of frames states their share.',
        table(('left out', 'reason'), rows, kind='words wide') if rows else '',
        f'<ul class="advice">{items}</ul>' if items else '<p>There were no warnings.</p>',
    )


def _warnings(summary: Mapping[str, Any]) -> Iterator[tuple[int, str]]:
    for frame in summary['frames']:
        for words in (frame.get('warning'), *(frame.get('findings') or ())):
            if words:
                yield frame['index'], words


def frame_table(sources: ReportSources) -> str:
    """Return the section with the figures of every frame."""
    summary = sources.summary
    frames = summary['frames']
    rows = []
    for frame in frames[:_MOST_ROWS]:
        depth = frame['depth_m']
        rows.append(
            (
                text(frame['index']),
                text(', '.join(dict.fromkeys(frame.get('images') or ['-']))),
                f'{100 * frame["matched"]:.1f} %',
                f'{100 * frame["density"]:.1f} %',
                *(fixed(depth[name], 2) for name in ('min', 'median', 'max')),
                text(frame['points']),
                fixed(frame.get('row_offset_px'), 3),
            )
        )
    more = f' Of {len(frames)} frames the first {_MOST_ROWS}.' if len(frames) > _MOST_ROWS else ''
    near, far = (summary.get('depth_searched_m') or [None, None])[:2]
    searched = f'{significant(near)} m to {reach(float("inf") if far is None else far)}'
    head = (
        'frame', 'images', 'measured', 'with disparity', 'nearest, m', 'median, m', 'farthest, m',
        'points', 'row offset, px',
    )  # fmt: skip
    return section(
        'Frames',
        f'Searched from {searched}. Measured on average:'
        f' {100 * summary["matched"]:.1f} % of the pixels.{more}',
        f'<div class="scroll">{table(head, rows, kind="long")}</div>',
    )


def options(sources: ReportSources) -> str:
    """Return the section with options and versions."""
    summary = sources.summary
    rows = [
        (text(name), text(value))
        for name, value in _flat(summary.get('options') or {})
        if not name.startswith('onnx_') or summary['options']['match']['matcher'] == 'onnx'
    ]
    half = -(-len(rows) // 2)
    return section(
        'Options and versions',
        f'Preset {text(summary.get("preset", "unknown"))}; every option of the chain as it was'
        ' used.',
        *(table(('option', 'value'), part, kind='long') for part in (rows[:half], rows[half:])),
        version_table(summary.get('versions') or {}),
    )


def version_table(versions: Mapping[str, Any]) -> str:
    """Return the table of the versions of software, HTML."""
    return table(('software', 'version'), [(text(k), text(v)) for k, v in versions.items()])


def signatures() -> str:
    """Return the section that is signed on paper."""
    fields = ('Surveyed by, date', 'Checked by, date')
    blanks = ''.join(f'<div>{one}</div>' for one in fields)
    return section(
        'Signatures',
        'All stated uncertainties are one standard deviation.',
        f'<div class="signatures">{blanks}</div>',
    )


def _flat(values: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value)
        elif value != '':
            yield name, plain(value) if isinstance(value, float) else str(value)


def words(rows: Iterable[tuple[str, str]]) -> str:
    """Return a table of names and texts, HTML."""
    cells = ''.join(f'<tr><td>{name}</td><td>{value}</td></tr>' for name, value in rows)
    return f'<table class="words wide"><tbody>{cells}</tbody></table>'
