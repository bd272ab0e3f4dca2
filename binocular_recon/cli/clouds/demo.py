# SPDX-License-Identifier: Apache-2.0
"""``demo``: the whole chain on a real pair that ships with the project, or a simulated survey."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from binocular_recon.cli.options import (
    add_chain_options,
    add_output_option,
    chain_config,
    note,
    option_flags,
    positive,
    say,
)
from binocular_recon.errors import ConfigError
from binocular_recon.io.shared_files import shared_file

# Boards that `demo --survey` calibrates with.
_BOARDS = 11


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``demo``."""
    add_output_option(parser, content='the results (out/demo, out/survey)', required=False)
    parser.add_argument(
        '--survey',
        action='store_true',
        help='instead: simulate a site and survey it, from the rods to the report; values beside'
        ' the truth',
    )
    parser.add_argument(
        '--boards', type=positive(int), metavar='N',
        help=f'boards that --survey calibrates with ({_BOARDS})',
    )  # fmt: skip
    parser.add_argument(
        '--size', type=positive(float), metavar='SHARE',
        help='size of the images of --survey relative to 1920x1200 (1)',
    )  # fmt: skip
    add_chain_options(parser)


def run(args: argparse.Namespace) -> None:
    """Reconstruct the pair, draw the cloud and compare the disparity with the ground truth.

    Raises
    ------
    BinocularReconError
        If the bag is missing, the results cannot be written, or the survey contradicts the truth.

    """
    if args.survey:
        from binocular_recon.cli.survey.tour import survey_tour

        survey_tour(
            args.output or Path('out/survey'),
            boards=args.boards or _BOARDS,
            size=args.size or 1.0,
            options=option_flags(args),
        )
        return
    if args.boards or args.size:
        raise ConfigError('--boards and --size are options of --survey; give that too')
    from binocular_recon.apps.bag_input import BagInput
    from binocular_recon.apps.reconstruction import reconstruct_pairs

    output = args.output or Path('out/demo')
    bags = shared_file('bags/motorcycle').parent
    source = BagInput(bag=bags / 'motorcycle')
    config = chain_config(args)
    say('Middlebury scene Motorcycle: depth 2.0 to 4.6 m, focal length 999 px, baseline 0.193 m')
    say(reconstruct_pairs(source, output, args.preset, config, formats=['drawing'], report=note))
    say(_accuracy(output, bags / 'motorcycle_truth' / 'disparity.png'))
    for name, content in {
        '000000.ply': 'point cloud with colour and sigma_z, for CloudCompare, MeshLab or Open3D',
        '000000_validity.png': 'which pixels are measured, and why the others are not',
        '000000_cloud.png': 'left image, and the cloud from an oblique view',
        '000000_disparity.png': 'disparity as a heat map; the .pfm file holds the numbers',
        'summary.json': 'depth range, accuracy, options, calibration and versions',
    }.items():
        say(f'  {output / name}: {content}')


def _accuracy(output: Path, truth: Path) -> str:
    """Compare with the ground truth; add the figures to the summary and return a sentence."""
    from binocular_recon.evaluation.accuracy.metrics import BAD_THRESHOLDS_PX, accuracy
    from binocular_recon.io.disparity_png import read_disparity_png
    from binocular_recon.io.files import write_json
    from binocular_recon.io.pfm import read_pfm

    found = accuracy(read_pfm(output / '000000_disparity.pfm'), read_disparity_png(truth))
    bad = {
        f'bad-{limit:.1f} %': round(share, 2)
        for limit, share in zip(BAD_THRESHOLDS_PX, found.bad_percent, strict=True)
    }
    figures = {**bad, 'mean_error_px': round(found.mean_error_px, 3), 'pixels': found.pixels}
    summary = json.loads((output / 'summary.json').read_text())
    write_json(output / 'summary.json', {**summary, 'accuracy': figures})
    shares = ', '.join(f'{name.removesuffix(" %")} {share:.1f} %' for name, share in bad.items())
    return (
        f'against the ground truth of {found.pixels} pixels, half-occluded ones included:'
        f' {shares}, mean error {found.mean_error_px:.2f} px'
    )
