# SPDX-License-Identifier: Apache-2.0
"""``merge``: one cloud of many frames."""

from __future__ import annotations

import argparse
from pathlib import Path

from binocular_recon.cli.options import add_output_option, names, note, positive, say

VOXEL_SIZE_M = 0.02


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``merge``."""
    parser.add_argument(
        'folders',
        type=Path,
        nargs='+',
        metavar='OUTPUT',
        help='output folder of reconstruct. One folder: its frames, of a rig that stood still, are'
        ' averaged. Several: stations of one frame each, all georeferenced, or overlapping (extra'
        ' merge); their clouds become one',
    )
    add_output_option(
        parser,
        content='the averaged frame, laid out as that of reconstruct; or cloud.ply and'
        ' stations.json',
    )
    parser.add_argument(
        '--voxel-size',
        type=positive(float),
        default=VOXEL_SIZE_M,
        metavar='M',
        help='of several stations one point is kept per cube of this edge, metres (%(default)s)',
    )
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
    from binocular_recon.apps.survey.stations import merge_stations

    folders = [MeasuredFolder(folder) for folder in args.folders]
    if len(folders) == 1:
        say(merge_over_time(folders[0], args.output, formats=args.format, report=note))
        return
    say(merge_stations(folders, args.output, args.voxel_size, formats=args.format, report=note))
