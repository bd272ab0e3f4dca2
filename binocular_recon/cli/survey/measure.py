# SPDX-License-Identifier: Apache-2.0
"""``measure``: sizes and places in a reconstruction, each with one standard deviation."""

from __future__ import annotations

import argparse
from pathlib import Path

from binocular_recon.cli.options import add_output_option, add_pick_sigma_option, note, say
from binocular_recon.errors import MeasurementError
from binocular_recon.measurement.kinds import KINDS
from binocular_recon.measurement.picks import Request, read_picks, write_picks

_WITHOUT_COVARIANCE = (
    'sigma leaves out the calibration: its covariance is not known; reconstruct with'
    ' --calibration and a folder that has calibration.json'
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``measure``."""
    parser.add_argument('folder', type=Path, metavar='OUTPUT', help='output folder of reconstruct')
    parser.add_argument(
        '--picks', type=Path, required=True, metavar='FILE',
        help='picked pixels of the rectified left images NNNNNN_left.png: a CSV file with the'
        ' columns name,frame,u,v[,u_right,v_right], or a YAML file with picks and measurements',
    )  # fmt: skip
    kinds = '; '.join(f'{name}: {kind.text}' for name, kind in KINDS.items())
    parser.add_argument(
        '--measure', action='append', default=[], metavar="'KIND PICK ...'",
        help='what to measure between which picks, such as "distance A B"; may be repeated. By'
        ' default those of the YAML file; else all points, and the distance of each to the next.'
        f' Kinds: {kinds}',
    )  # fmt: skip
    add_pick_sigma_option(parser)
    add_output_option(
        parser,
        content='measurements.json, measurements.csv, measured_NNNNNN.png and picks.csv (the'
        ' folder of the reconstruction)',
        required=False,
    )


def run(args: argparse.Namespace) -> None:
    """Measure; print a table, write it and draw it.

    Raises
    ------
    BinocularReconError
        If nothing can be measured; or, after the rest was, if a part could not be.

    """
    from binocular_recon.apps.survey.measured_folder import MeasuredFolder
    from binocular_recon.apps.survey.measuring import (
        default_requests,
        measure_all,
        open_session,
        write_measurements,
    )
    from binocular_recon.measurement.results import table

    by_name, listed = read_picks(args.picks)
    picks = list(by_name.values())
    requests = [Request.of(text) for text in args.measure] or listed or default_requests(picks)
    folder = MeasuredFolder(args.folder)
    session = open_session(folder, picks, args.pick_sigma)
    found, problems = measure_all(session, requests)
    if found:
        output = args.output or args.folder
        paths = write_measurements(folder, output, session, found)
        write_picks(output / 'picks.csv', picks)
        say(table(found))
        say(', '.join(str(path) for path in [*paths, output / 'picks.csv']))
        if folder.rig(found[0].frame).covariance is None:
            note(_WITHOUT_COVARIANCE)
    if problems:
        more = f' (and {len(problems) - 1} more)' if len(problems) > 1 else ''
        raise MeasurementError(f'{problems[0]}{more}')
