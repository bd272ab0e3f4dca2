# SPDX-License-Identifier: Apache-2.0
"""``merge``: one cloud of many frames."""

from __future__ import annotations

import argparse
from pathlib import Path

from binocular_recon.cli.options import add_output_option, names, note


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``merge``."""
    parser.add_argument(
        'folder',
        type=Path,
        metavar='OUTPUT',
        help='output folder of reconstruct; its frames are of a rig that stood still',
    )
    add_output_option(parser, content='the averaged frame, laid out as that of reconstruct')
    parser.add_argument(
        '--format',
        type=names,
        default=[],
        metavar='NAME,...',
        help='also write these, as reconstruct does: las, laz, e57, tiff, png, grey, colour,'
        ' drawing',
    )


def run(args: argparse.Namespace) -> None:
    """Merge the frames.

    Raises
    ------
    BinocularReconError
        If the frames cannot be merged, or a file cannot be read or written.

    """
    from binocular_recon.apps.survey.measured_folder import MeasuredFolder
    from binocular_recon.apps.survey.merging import merge_over_time

    folder = MeasuredFolder(args.folder)
    print(merge_over_time(folder, args.output, formats=args.format, report=note))
