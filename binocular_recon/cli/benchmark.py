# SPDX-License-Identifier: Apache-2.0
"""``benchmark``: speed and memory of each stage and of the chain, against their peers."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from binocular_recon.apps.progress import ProgressBar
from binocular_recon.cli.options import add_comparison_options, ximgproc_note
from binocular_recon.evaluation import peers
from binocular_recon.evaluation.speed.benchmark import (
    SIZES,
    STAGES,
    Results,
    benchmark,
    growth,
    step_count,
)
from binocular_recon.evaluation.speed.stages import Size
from binocular_recon.evaluation.tables import markdown_table, to_plain
from binocular_recon.io.files import make_folder, write_json
from binocular_recon.machine import machine_facts
from binocular_recon.number_text import fixed

NO_XIMGPROC = ximgproc_note('its WLS filter and the chain with it are missing', 'benchmark')
_MIN_SIDE_PX = 64


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``benchmark``."""
    add_comparison_options(parser, repeat=5)
    parser.add_argument(
        '--sizes',
        type=_size,
        nargs='+',
        default=list(SIZES),
        metavar='WxHxD',
        help=f'image sizes: width x height x disparities ({" ".join(map(str, SIZES))})',
    )


def run(args: argparse.Namespace) -> None:
    """Measure, print the tables and write ``benchmark.json``.

    Raises
    ------
    BinocularReconError
        If an option is out of range, the folder cannot be written or a process fails.

    """
    make_folder(args.output)
    sizes = sorted(args.sizes, key=lambda size: size.scores)
    with ProgressBar(step_count(sizes, args.presets), 'steps') as bar:
        results = benchmark(sizes, args.presets, args.repeat, bar.show)
    tables = [*_stage_tables(results, sizes), *_other_tables(results, sizes)]
    notes = [] if peers.has_ximgproc() else [NO_XIMGPROC]
    print('\n\n'.join([*tables, *notes]))
    facts = {'machine': machine_facts(), 'repeat': args.repeat, 'presets': args.presets}
    write_json(args.output / 'benchmark.json', to_plain({**facts, 'results': results}))


def _stage_tables(results: Results, sizes: Sequence[Size]) -> list[str]:
    tables = []
    for stage in STAGES:
        timings = [timing for timing in results.timings if timing.stage == stage]
        header = [stage]
        for size in sizes:
            header += [f'{size} ms', 'relative', *(['pairs/s'] if stage == 'chain' else [])]
        rows = []
        for name in dict.fromkeys(timing.name for timing in timings):
            row = [name]
            for timing in (t for t in timings if t.name == name):
                row += [fixed(1000 * timing.seconds), fixed(timing.relative, 2)]
                row += [fixed(1 / timing.seconds)] if stage == 'chain' else []
            rows.append(row)
        tables.append(markdown_table(header, rows))
    return tables


def _other_tables(results: Results, sizes: Sequence[Size]) -> list[str]:
    grown = growth(results.timings, sizes)
    return [
        markdown_table(
            ['match, ns per pixel and disparity', *map(str, sizes)],
            [[name, *(fixed(value, 3) for value in values)] for name, values in grown.items()],
        ),
        _direct_table(results),
        markdown_table(
            [f'peak memory of a match at {sizes[-1]}', 'MB', 'bytes per pixel and disparity'],
            [
                [one['preset'], fixed(one['peak_mb'], 0), fixed(one['bytes_per_score'], 2)]
                for one in results.memory
            ],
        ),
        _first_call_table(results, sizes[0]),
    ]


def _direct_table(results: Results) -> str:
    header = [
        f'exact WLS at {results.direct[0]["size"]}',
        'direct solver ms',
        'ours ms',
        'iterations',
    ]
    header += ['largest error px', 'its estimate px']
    rows = [
        [
            one['preset'],
            *(fixed(1000 * one[key]) for key in ('direct_s', 'filter_s')),
            str(one['iterations']),
            *(fixed(one[key], 4) for key in ('largest_error_px', 'error_estimate_px')),
        ]
        for one in results.direct
    ]
    return markdown_table(header, rows)


def _first_call_table(results: Results, size: Size) -> str:
    header = [f'first call of the chain at {size}', 'import s', 'first pair s', 'second s']
    rows = [
        [
            f'{one["preset"]}, {state} cache',
            *(fixed(one[state][key], 2) for key in ('import_s', 'first_s', 'second_s')),
        ]
        for one in results.first_call
        for state in ('cold', 'warm')
    ]
    return markdown_table(header, rows)


def _size(text: str) -> Size:
    try:
        width, height, disparity_range = map(int, text.split('x'))
    except ValueError:
        raise argparse.ArgumentTypeError(f'{text!r} is not WIDTHxHEIGHTxDISPARITIES') from None
    if min(width, height) < _MIN_SIDE_PX or disparity_range < 16 or disparity_range % 16:
        raise argparse.ArgumentTypeError(
            f'{text}: sides must be at least {_MIN_SIDE_PX} px, disparities a multiple of 16'
        )
    if disparity_range >= width:
        raise argparse.ArgumentTypeError(
            f'{text}: there must be fewer disparities than columns ({width})'
        )
    return Size(width, height, disparity_range)
