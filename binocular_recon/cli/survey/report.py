# SPDX-License-Identifier: Apache-2.0
"""``report``: one HTML file about a survey, to hand to a client."""

from __future__ import annotations

import argparse
from datetime import date
from pathlib import Path

from binocular_recon.cli.options import non_negative, positive, say

_MB = 1_000_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``report``."""
    parser.add_argument(
        'folder', type=Path, metavar='OUTPUT', help='output folder of reconstruct, or of merge'
    )
    for name, what in (
        ('site', 'name of the site, the title'),
        ('client', 'who ordered the survey'),
        ('author', 'who made it'),
    ):
        parser.add_argument(f'--{name}', default='', metavar='TEXT', help=what)
    parser.add_argument(
        '--date', type=_day, metavar='YYYY-MM-DD',
        help='day of the survey (by default that of the stamps of the images)',
    )  # fmt: skip
    parser.add_argument('--logo', type=Path, metavar='FILE', help='PNG or JPEG beside the title')
    parser.add_argument(
        '--calibration', type=Path, metavar='DIR',
        help='folder of the calibration (by default where reconstruct found it)',
    )  # fmt: skip
    parser.add_argument(
        '--frames', type=_frames, default=(0,), metavar='N,...',
        help='frames whose images and maps are shown; the cloud is that of the first (0)',
    )  # fmt: skip
    parser.add_argument(
        '--max-size', type=positive(float), default=10.0, metavar='MB',
        help='largest size of the file; the cloud is thinned to it (%(default)s)',
    )  # fmt: skip
    parser.add_argument(
        '--output', type=Path, metavar='FILE.html', help='the file (OUTPUT/report.html)'
    )


def run(args: argparse.Namespace) -> None:
    """Write the report and print what it lacks.

    Raises
    ------
    BinocularReconError
        If the folder holds no reconstruction, or the report cannot be written.

    """
    from binocular_recon.apps.survey.report import ReportDetails, write_report

    details = ReportDetails(
        site=args.site,
        client=args.client,
        author=args.author,
        date=args.date or '',
        logo=args.logo,
        calibration=args.calibration,
        frames=args.frames,
        most_bytes=round(_MB * args.max_size),
    )
    path = write_report(args.folder, details, args.output)
    say(f'{path}, {path.stat().st_size / _MB:.1f} MB')


def _day(words: str) -> str:
    return date.fromisoformat(words).isoformat()


def _frames(words: str) -> tuple[int, ...]:
    return tuple(dict.fromkeys(non_negative(one) for one in words.split(',')))


_day.__name__, _frames.__name__ = 'day', 'list of frames'
