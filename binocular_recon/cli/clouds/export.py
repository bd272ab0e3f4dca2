# SPDX-License-Identifier: Apache-2.0
"""``export``: clouds and depth images of an output folder for other programs."""

from __future__ import annotations

import argparse
from pathlib import Path

from binocular_recon.cli.options import names, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``export``."""
    from binocular_recon.apps.export import EXPORTS

    parser.add_argument(
        'folder', type=Path, metavar='OUTPUT', help='folder that reconstruct --output wrote'
    )
    parser.add_argument(
        '--format',
        type=names,
        required=True,
        metavar='NAME,...',
        help=f'formats to write, among {", ".join(EXPORTS)}',
    )
    parser.add_argument(
        '--output', type=Path, metavar='DIR', help='folder for the files (OUTPUT/export)'
    )
    parser.add_argument(
        '--georeference',
        action=argparse.BooleanOptionalAction,
        default=True,
        help='put clouds into the frame of OUTPUT/georeference.json, if it is there',
    )


def run(args: argparse.Namespace) -> None:
    """Export every frame.

    Raises
    ------
    BinocularReconError
        If a format cannot be made, or a file cannot be read or written.

    """
    from binocular_recon.apps.export import export
    from binocular_recon.io.exports.placement import read_placement

    tie = args.folder / 'georeference.json'
    placement = read_placement(tie) if args.georeference and tie.exists() else None
    say(export(args.folder, args.output or args.folder / 'export', args.format, placement))
