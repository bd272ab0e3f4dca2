# SPDX-License-Identifier: Apache-2.0
"""``filter``: another program's disparities through the filter, with standard deviations."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from binocular_recon.cli.options import add_chain_options, beside, chain_config, say
from binocular_recon.config import ChainConfig, MatchConfig
from binocular_recon.errors import ConfigError, ImageError

if TYPE_CHECKING:
    from binocular_recon.images import FloatImage, Image
    from binocular_recon.stereo.matching import Match

# Options of matching that count here: limits, and those of the checks against the right image.
_USED = ('min_disparity', 'disparity_range', 'correlation_window_size', 'texture_threshold')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``filter``."""
    parser.add_argument(
        'left', type=Path, metavar='LEFT', help='rectified image of the left camera'
    )
    parser.add_argument(
        'disparity',
        type=Path,
        metavar='DISPARITY',
        help='its disparities x_left - x_right, px: PFM, TIFF or npy, NaN or inf = none, or PNG of'
        ' 16 bit in 1/256 px, 0 = none',
    )
    parser.add_argument(
        '--right',
        type=Path,
        metavar='IMAGE',
        help='rectified image of the right camera: disparities that it contradicts are dropped,'
        ' and the others get their confidence by it',
    )
    parser.add_argument(
        '--confidence',
        type=Path,
        metavar='FILE',
        help="the disparities' confidence 1 / (1 + (sigma / 0.25 px)^2), in [0, 1], in a file of"
        ' the same kinds; without it and --right, all have confidence 1',
    )
    parser.add_argument(
        '--output',
        type=Path,
        required=True,
        metavar='FILE.pfm',
        help='file for the dense disparity; FILE_sigma.pfm and FILE_validity.png go beside it',
    )
    parser.add_argument(
        '--heat-map', type=Path, metavar='FILE.png', help='also write the disparity as a heat map'
    )
    config = ChainConfig()
    matching = {spec.name for spec in dataclasses.fields(MatchConfig)} - set(_USED)
    cloud = {spec.name for spec in dataclasses.fields(config.cloud)}
    add_chain_options(parser, exclude=matching | cloud)


def run(args: argparse.Namespace) -> None:
    """Filter the disparities and write them.

    Raises
    ------
    BinocularReconError
        If a file cannot be read, the images do not fit or a file cannot be written.

    """
    import numpy as np

    from binocular_recon.drawing.colormap import heat_map_with_scale
    from binocular_recon.images import mark_empty, to_grey
    from binocular_recon.inputs.levels import LevelTracker
    from binocular_recon.io.disparity_files import read_disparity_file
    from binocular_recon.io.files import make_folder
    from binocular_recon.io.image_files import read_image_file, write_image_file
    from binocular_recon.io.pfm import write_pfm
    from binocular_recon.stereo.filtering.wls_filter import filter_disparity

    if args.right and args.confidence:
        raise ConfigError(
            '--right makes the confidence itself: leave out one of --right and --confidence'
        )
    config = chain_config(args)
    disparity_px = read_disparity_file(args.disparity)
    match_config = _with_range(config.match, disparity_px, args.disparity)
    images = [read_image_file(path) for path in (args.left, args.right) if path]
    for path, image in zip((args.left, args.right), images, strict=False):
        _check_size(path, image, disparity_px)
    levels = LevelTracker(config.images).update(*images)
    greys = [to_grey(image, level) for image, level in zip(images, levels, strict=True)]
    for grey in greys:
        mark_empty(grey)
    matched = _matched(args, disparity_px, greys, match_config)
    found = filter_disparity(
        matched.disparity_px,
        matched.confidence,
        greys[0],
        config.filter,
        limits_px=match_config.limits_px,
        reasons=matched.validity,
    )
    for path in filter(None, (args.output, args.heat_map)):
        make_folder(path.parent)
    write_pfm(args.output, found.disparity_px)
    write_pfm(beside(args.output, '_sigma.pfm'), found.sigma_px)
    write_image_file(beside(args.output, '_validity.png'), found.validity)
    if args.heat_map:
        write_image_file(args.heat_map, heat_map_with_scale(found.disparity_px, 'px'))
    given = float(np.isfinite(disparity_px).mean())
    say(
        f'{args.output}: {given:.1%} of the pixels had a disparity, {matched.matched_share:.1%}'
        f' passed the checks, {np.isfinite(found.disparity_px).mean():.1%} have one now; median'
        f' sigma {np.nanmedian(found.sigma_px):.2f} px'
    )


def _matched(
    args: argparse.Namespace,
    disparity_px: FloatImage,
    greys: list[FloatImage],
    config: MatchConfig,
) -> Match:
    """Return the disparities with their confidence."""
    import numpy as np

    from binocular_recon.io.disparity_files import read_disparity_file
    from binocular_recon.stereo.foreign import check_disparity
    from binocular_recon.stereo.matching import Match
    from binocular_recon.stereo.validity import Validity

    if args.right:
        return check_disparity(disparity_px, greys[0], greys[1], config)
    known = np.isfinite(disparity_px)
    confidence = known.astype(np.float32)
    if args.confidence:
        confidence = np.nan_to_num(read_disparity_file(args.confidence))
        _check_size(args.confidence, confidence, disparity_px)
        if confidence.min() < 0 or confidence.max() > 1:
            raise ImageError(
                f'{args.confidence} holds values from {confidence.min():g} to'
                f' {confidence.max():g}; a confidence is within 0..1'
            )
        known &= confidence > 0
    validity = np.where(known, np.uint8(Validity.MEASURED), np.uint8(0))
    return Match(np.where(known, disparity_px, np.float32(np.nan)), confidence, validity)


def _with_range(config: MatchConfig, disparity_px: FloatImage, path: Path) -> MatchConfig:
    """Return the options with the range of the disparities, if none is set."""
    import numpy as np

    from binocular_recon.stereo.search_range import FARTHEST_START, MOST_DISPARITIES, SearchRange

    if not config.finds_range:
        return config
    known = disparity_px[np.isfinite(disparity_px)]
    if not known.size:
        raise ImageError(f'{path} has no disparity: all its values are NaN, infinite or unset')
    low, high = int(np.floor(known.min())) - 1, int(np.ceil(known.max())) + 1
    if low < -FARTHEST_START or high - low + 1 > MOST_DISPARITIES:
        raise ImageError(
            f'{path} has disparities from {known.min():g} to {known.max():g} px; set'
            ' --min-disparity and --disparity-range to those that are valid'
        )
    return SearchRange(low, high - low + 1).applied_to(config)


def _check_size(path: Path, image: Image, disparity_px: FloatImage) -> None:
    if image.shape[:2] != disparity_px.shape:
        rows, columns = disparity_px.shape
        raise ImageError(
            f'{path} is {image.shape[1]}x{image.shape[0]} px and the disparity'
            f' {columns}x{rows} px; both must belong to the same image'
        )
