# SPDX-License-Identifier: Apache-2.0
"""``rods-plan``: the drawing from which the rods of ``rods.yaml`` are made and put up."""

from __future__ import annotations

import argparse
from pathlib import Path

from binocular_recon.cli.options import say
from binocular_recon.errors import ConfigError

_FORMATS = ('.pdf', '.svg')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rods-plan``."""
    parser.add_argument('rods', type=Path, metavar='rods.yaml', help='the rods')
    parser.add_argument(
        '--output',
        required=True,
        type=Path,
        metavar='FILE',
        help='the drawing, one A4 sheet; .pdf or .svg',
    )


def run(args: argparse.Namespace) -> None:
    """Draw the rods.

    Raises
    ------
    ConfigError
        If the ending of the output is neither .pdf nor .svg.
    CalibrationError
        If the file does not describe rods.
    FileError
        If a file cannot be read or written.

    """
    from binocular_recon.calibration.report.rods_plan import rods_plan
    from binocular_recon.calibration.target.rods import load_rods
    from binocular_recon.io.files import complete_file

    if args.output.suffix not in _FORMATS:
        raise ConfigError(
            f'--output must end with {" or ".join(_FORMATS)}, got {args.output.name}'
        )
    sheet = rods_plan(load_rods(args.rods))
    pdf = args.output.suffix == '.pdf'
    with complete_file(args.output) as file:
        file.write(sheet.pdf() if pdf else sheet.svg().encode())
    say(f'{args.output}: {sheet.title}; print at 100 %, and check the bar with a rule')
