# SPDX-License-Identifier: Apache-2.0
"""``paper``: the paper end to end on simulated sites, its Tables 1, 2 and 3 beside ours."""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from binocular_recon.cli.options import positive
from binocular_recon.cli.progress import ProgressBar
from binocular_recon.evaluation.paper import (
    BOARDS,
    MARK_NOISE_PX,
    PICKS,
    PaperRun,
    run_paper,
)
from binocular_recon.evaluation.paper_pictures import draw_crop, draw_sizes
from binocular_recon.evaluation.paper_tables import mean_of_three_mm, report
from binocular_recon.evaluation.timing import machine_facts
from binocular_recon.io.files import complete_file, make_folder, write_json
from binocular_recon.io.image_files import write_image_file
from binocular_recon.simulation.rig import TABLE_1_PITCH_RAD, survey_rig

# How exactly rods stand, one standard deviation, m.
PLACEMENTS_M = (0.0, 0.005)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        '--output', type=Path, default=Path('out/paper'), metavar='DIR',
        help='folder for paper.json, tables.md, sizes.jpg and crop.jpg (%(default)s)',
    )  # fmt: skip
    parser.add_argument(
        '--seeds', type=positive(int), default=10, metavar='N',
        help='simulated sites (%(default)s)',
    )  # fmt: skip
    parser.add_argument(
        '--first-seed', type=int, default=0, metavar='N', help='other seeds, other sites (0)'
    )
    parser.add_argument(
        '--boards', type=positive(int), default=BOARDS, metavar='N',
        help='boards of rods to calibrate with (%(default)s)',
    )  # fmt: skip
    parser.add_argument(
        '--rendered', type=int, default=1, metavar='N',
        help='sites whose rods are rendered in pictures and detected (%(default)s); for the others'
        f' marks are simulated with {MARK_NOISE_PX:g} px noise',
    )  # fmt: skip


def run(args: argparse.Namespace) -> None:
    """Run all sites, print the tables, write ``paper.json``, ``tables.md`` and two pictures."""
    make_folder(args.output)
    start = time.monotonic()
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    rig = survey_rig(pitch_rad=TABLE_1_PITCH_RAD)
    runs: list[PaperRun] = []
    with ProgressBar(len(seeds) * len(PLACEMENTS_M), 'reconstructions') as bar:
        steps = run_paper(rig, seeds, PLACEMENTS_M, boards=args.boards, rendered=args.rendered)
        for done, survey in steps:
            if not runs:
                write_image_file(args.output / 'sizes.jpg', draw_sizes(survey, done))
                write_image_file(args.output / 'crop.jpg', draw_crop(survey))
            runs.append(done)
            bar.show(len(runs))
    text = report(runs)
    with complete_file(args.output / 'tables.md') as file:
        file.write(f'{text}\n'.encode())
    write_json(args.output / 'paper.json', facts(runs))
    print(text)
    print(f'\n{args.output}/paper.json, tables.md, sizes.jpg, crop.jpg'
          f' ({time.monotonic() - start:.0f} s)')  # fmt: skip


def facts(runs: list[PaperRun]) -> dict[str, Any]:
    """Return what ``paper.json`` holds."""
    placements = sorted({run.placement_m for run in runs})
    means = {
        f'{placement:g}': {
            key: mean_of_three_mm([run for run in runs if run.placement_m == placement], key)
            for key in ('errors_mm', 'floor_mm')
        }
        for placement in placements
    }
    return {
        'machine': machine_facts(),
        'mean_of_three_mm': means,
        'picks': PICKS,
        'runs': [asdict(run) for run in runs],
    }
