# SPDX-License-Identifier: Apache-2.0
"""``warm-up``: compile the kernels, so that the first start of everything else is quick."""

from __future__ import annotations

import argparse
import time

from binocular_recon.cli.options import note, preset_names, say
from binocular_recon.config import PRESETS
from binocular_recon.errors import FileError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``warm-up``."""
    parser.add_argument(
        '--presets',
        type=preset_names,
        default=list(PRESETS),
        metavar='NAME,...',
        help=f'presets whose kernels are compiled (all: {",".join(PRESETS)})',
    )


def run(args: argparse.Namespace) -> None:
    """Compile the kernels of presets and of the calibration.

    Raises
    ------
    FileError
        If what was compiled cannot be kept.

    """
    from binocular_recon._kernel_cache import cache_problem
    from binocular_recon.apps.kernels import compile_all

    begun_s = time.monotonic()
    compile_all(args.presets, lambda part: note(f'{part}: ready'))
    if cache_problem():
        raise FileError(cache_problem())
    say(f'kernels ready after {time.monotonic() - begun_s:.0f} s; later starts load them')
