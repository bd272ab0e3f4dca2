# SPDX-License-Identifier: Apache-2.0
"""``match``: dense disparity of one rectified pair of image files."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from binocular_recon.cli.options import add_chain_options, beside, chain_config, note, say
from binocular_recon.cloud_config import CloudConfig
from binocular_recon.config import ChainConfig
from binocular_recon.errors import ConfigError, ImageError

if TYPE_CHECKING:
    from binocular_recon.stereo.pipeline import DisparityEstimate


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``match``."""
    parser.add_argument('left', type=Path, metavar='LEFT', help='image of the left camera')
    parser.add_argument('right', type=Path, metavar='RIGHT', help='image of the right camera')
    parser.add_argument(
        '--max-disparity',
        type=int,
        metavar='N',
        help='largest disparity x_left - x_right to search, px (by default found from the images)',
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

    from binocular_recon.drawing.colormap import heat_map_with_scale
    from binocular_recon.io.files import make_folder
    from binocular_recon.io.image_files import read_image_file, write_image_file
    from binocular_recon.io.pfm import write_pfm
    from binocular_recon.stereo.pipeline import estimate_disparity

    config = _config(args)
    left, right = read_image_file(args.left), read_image_file(args.right)
    for path in filter(None, (args.output, args.heat_map)):
        make_folder(path.parent)
    start = time.perf_counter()
    found = estimate_disparity(left, right, config)
    filtered = found.filtered
    seconds = time.perf_counter() - start
    disparity_px = filtered.disparity_px
    write_pfm(args.output, disparity_px)
    if args.heat_map:
        write_image_file(args.heat_map, heat_map_with_scale(disparity_px, 'px'))
    write_image_file(beside(args.output, '_validity.png'), filtered.validity)
    matched = found.matched.matched_share
    low, median, high = np.nanquantile(disparity_px, [0, 0.5, 1])
    say(
        f'{args.output}: {matched:.1%} of the pixels'
        f' measured, {np.isfinite(disparity_px).mean():.1%} with a disparity; {low:.1f} to'
        f' {high:.1f} px (median {median:.1f} px) of {found.range.search.min_disparity} to'
        f' {found.range.search.last} px searched, {seconds:.2f} s'
    )
    _judge(found, matched)


def _judge(found: DisparityEstimate, matched: float) -> None:
    """Warn of a result that may be wrong; raise an ImageError if most of it must be."""
    from binocular_recon.stereo.validity import (
        LEAST_MATCHED,
        MOST_OUTSIDE,
        REMEDY,
        few_matched_warning,
    )

    if found.range.outside_share > MOST_OUTSIDE:
        raise ImageError(found.range.warning)
    if matched < LEAST_MATCHED:
        raise ImageError(
            f'only {matched:.1%} of the pixels could be matched; {found.findings.cause or REMEDY}'
        )
    if found.range.warning:
        note(f'warning: {found.range.warning}')
    for text in found.findings.warnings:
        note(f'warning: {text}')
    warning = few_matched_warning(matched, found.findings.cause)
    if warning:
        note(f'warning: {warning}')


def _config(args: argparse.Namespace) -> ChainConfig:
    if args.max_disparity is None:
        return chain_config(args)
    least = chain_config(args).match.min_disparity
    if args.max_disparity <= least:
        raise ConfigError(
            f'--max-disparity must be above the smallest disparity, {least} px,'
            f' got {args.max_disparity}'
        )
    return chain_config(args, disparity_range=args.max_disparity - least + 1)
