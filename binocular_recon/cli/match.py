# SPDX-License-Identifier: Apache-2.0
"""``match``: dense disparity of one rectified pair of image files."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

from binocular_recon.cli.options import add_chain_options, chain_config
from binocular_recon.config import ChainConfig, CloudConfig
from binocular_recon.errors import ConfigError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``match``."""
    parser.add_argument('left', type=Path, metavar='LEFT', help='image of the left camera')
    parser.add_argument('right', type=Path, metavar='RIGHT', help='image of the right camera')
    parser.add_argument(
        '--max-disparity',
        type=int,
        required=True,
        metavar='N',
        help='largest disparity x_left - x_right to search, px',
    )
    parser.add_argument(
        '--output',
        type=Path,
        required=True,
        metavar='FILE.pfm',
        help='file for the disparity, float32 px',
    )
    parser.add_argument(
        '--heat-map', type=Path, metavar='FILE.png', help='also write the disparity as a heat map'
    )
    cloud_options = [spec.name for spec in dataclasses.fields(CloudConfig)]
    add_chain_options(parser, exclude=['disparity_range', *cloud_options])


def run(args: argparse.Namespace) -> None:
    """Match the pair and write its disparity.

    Raises
    ------
    BinocularReconError
        If an image cannot be read, the images do not fit or a file cannot be written.

    """
    import time

    import numpy as np

    from binocular_recon.drawing.colormap import heat_map
    from binocular_recon.io.files import make_folder
    from binocular_recon.io.image_files import read_image_file, write_image_file
    from binocular_recon.io.pfm import write_pfm
    from binocular_recon.stereo.pipeline import estimate_disparity

    config = _config(args)
    left, right = read_image_file(args.left), read_image_file(args.right)
    for path in filter(None, (args.output, args.heat_map)):
        make_folder(path.parent)
    start = time.perf_counter()
    _, filtered = estimate_disparity(left, right, config)
    seconds = time.perf_counter() - start
    disparity_px = filtered.disparity_px
    write_pfm(args.output, disparity_px)
    if args.heat_map:
        write_image_file(args.heat_map, heat_map(disparity_px))
    low, median, high = np.nanquantile(disparity_px, [0, 0.5, 1])
    print(
        f'{args.output}: density {np.isfinite(disparity_px).mean():.1%}, disparity {low:.1f} to'
        f' {high:.1f} px (median {median:.1f} px), {seconds:.2f} s'
    )


def _config(args: argparse.Namespace) -> ChainConfig:
    least = chain_config(args).match.min_disparity
    if args.max_disparity <= least:
        raise ConfigError(
            f'--max-disparity must be above the smallest disparity, {least} px,'
            f' got {args.max_disparity}'
        )
    return chain_config(args, disparity_range=args.max_disparity - least + 1)
