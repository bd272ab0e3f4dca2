# SPDX-License-Identifier: Apache-2.0
"""``export``: clouds and depth images of an output folder for other programs."""

from __future__ import annotations

import argparse
from pathlib import Path

from binocular_recon.cli.options import names


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


def run(args: argparse.Namespace) -> None:
    """Export every frame.

    Raises
    ------
    BinocularReconError
        If a format cannot be made, or a file cannot be read or written.

    """
    from binocular_recon.apps.export import export

    print(export(args.folder, args.output or args.folder / 'export', args.format))
