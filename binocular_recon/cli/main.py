# SPDX-License-Identifier: Apache-2.0
"""The command line: run a command and turn errors into exit statuses."""

from __future__ import annotations

import argparse
import importlib
import io
import os
import sys
from collections.abc import Sequence
from types import ModuleType
from typing import NoReturn

from binocular_recon import __version__
from binocular_recon.apps.signals import (
    Terminated,
    ignore_signals,
    leave,
    leave_on_signals,
    raise_signals,
    raised,
)
from binocular_recon.errors import BinocularReconError, ConfigError, plain_text

# The program's name in all messages, however it was started.
PROGRAM = 'binocular-recon'

# Room and summary of each command. Its module in the room has the same name, with _ for -, and two
# functions: add_arguments(parser) and run(args). Only the module of the command that is run is
# imported.
COMMANDS = {
    'demo': ('clouds', 'run the whole chain on a real image pair that ships with the project'),
    'reconstruct': (
        'clouds',
        'turn a bag, images or videos of a rig into point clouds and disparity maps',
    ),
    'export': (
        'clouds',
        'write clouds and depth of an output folder as LAS, LAZ, E57, PLY, TIFF or PNG',
    ),
    'measure': (
        'survey',
        'measure between picked pixels of a reconstruction, with standard deviations',
    ),
    'view': (
        'survey',
        'look at a reconstruction in the browser, click and measure',
    ),
    'georeference': (
        'survey',
        'tie a reconstruction to control points of the site, or level it',
    ),
    'merge': (
        'survey',
        'make one cloud of many frames of a rig that stood still, or of several stations',
    ),
    'report': (
        'survey',
        'write a survey as one HTML file for a client: print-ready, the cloud to turn inside',
    ),
    'match': ('clouds', 'compute the dense disparity of one rectified pair of image files'),
    'filter': (
        'clouds',
        "filter and complete another program's disparities, with standard deviations",
    ),
    'play': ('clouds', 'publish a bag on ROS 2 topics'),
    'calibrate': ('rigs', 'calibrate a stereo rig from images of rods or points of a flat target'),
    'rods-plan': ('rigs', 'draw the rods of rods.yaml to scale, to make them and put them up'),
    'import-calibration': (
        'rigs',
        "read another program's calibration: OpenCV, Kalibr, mrcal and others",
    ),
    'simulate': (
        'quality',
        'simulate images of rods, or a survey scene as a bag, with ground truth',
    ),
    'paper': ('quality', 'repeat the paper on simulated sites: its Tables 1, 2 and 3 beside ours'),
    'evaluate': (
        'quality',
        'measure accuracy on scenes with ground truth, against other matchers',
    ),
    'warm-up': ('quality', 'compile and keep the kernels, so that the first start is quick'),
    'benchmark': ('quality', 'measure speed and memory of every stage, against its peers'),
}

_MOST_OPTIONS = 1000
EXIT_DONE, EXIT_PROBLEM, EXIT_USAGE, EXIT_INTERRUPTED, EXIT_TERMINATED = 0, 1, 2, 130, 143


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; by default those of the process, which then ends at
        once when it is interrupted.

    Returns
    -------
    status : int
        0 done, 1 a problem with the input, 2 wrong usage, 130 interrupted, 143 terminated. Unless
        it is 0, one line on stderr says why. Arguments that do not parse raise ``SystemExit(2)``.

    """
    of_process = argv is None
    argv = sys.argv[1:] if argv is None else argv
    # argparse looks at all options again for each
    if sum(word.startswith('-') for word in argv) > _MOST_OPTIONS:
        print(f'{PROGRAM}: there are more than {_MOST_OPTIONS} options', file=sys.stderr)
        return EXIT_USAGE
    command = _command(argv)
    program = f'{PROGRAM} {command}' if command in COMMANDS else PROGRAM
    try:
        if of_process:
            _write_out_what_cannot_be_encoded()
            leave_on_signals(lambda terminated: leave(_say_interrupted(program, terminated)))
        args = _parser(argv).parse_args(argv)  # imports the command
        if of_process:
            raise_signals()
        return _run(args, program)
    except KeyboardInterrupt as interrupt:
        if of_process:
            ignore_signals()
        status = _say_interrupted(program, isinstance(interrupt, Terminated), str(interrupt))
    except Exception:  # an extension may turn the interrupt into an error of its own
        interrupted = raised()
        if interrupted is None:
            raise
        ignore_signals()
        status = _say_interrupted(program, interrupted is Terminated)
    if of_process:
        leave(status)
    return status


def _write_out_what_cannot_be_encoded() -> None:
    """Write out characters that the encoding of a terminal or pipe does not have."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors='backslashreplace')


class _Parser(argparse.ArgumentParser):
    """Prints names that were given without control characters."""

    def error(self, message: str) -> NoReturn:
        super().error(plain_text(message))


def _say_interrupted(program: str, terminated: bool, kept: str = '') -> int:
    """Say that the command was interrupted, and what it kept; return its status."""
    what = 'terminated' if terminated else 'interrupted'
    print(f'{program}: {what}{"; " if kept else ""}{kept}', file=sys.stderr)
    return EXIT_TERMINATED if terminated else EXIT_INTERRUPTED


def _run(args: argparse.Namespace, program: str) -> int:
    try:
        command_module(args.command).run(args)
        _say_cache_problem()
    except BrokenPipeError:  # the reader of the output, such as `head`, has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_PROBLEM
    except (BinocularReconError, OSError, MemoryError) as error:
        if raised():
            raise
        message = plain_text(' '.join(str(error).split()))
        if isinstance(error, MemoryError):
            message = f'{message}; choose a smaller disparity_range or smaller images'
        print(f'{program}: {message}', file=sys.stderr)
        return EXIT_USAGE if isinstance(error, ConfigError) else EXIT_PROBLEM
    return EXIT_DONE


def _say_cache_problem() -> None:
    """Say that compiled kernels could not be kept, if any were compiled."""
    cache = sys.modules.get('binocular_recon._kernel_cache')
    if cache and cache.cache_problem():
        print(f'warning: {cache.cache_problem()}', file=sys.stderr)


def _command(argv: Sequence[str]) -> str:
    """Return the command that is named, '' if none is."""
    return next((word for word in argv if not word.startswith('-')), '')


def run_command(argv: Sequence[str]) -> None:
    """Run a command within another; its errors are raised."""
    args = _parser(argv).parse_args(argv)
    command_module(args.command).run(args)


def command_module(name: str) -> ModuleType:
    """Import the module of a command."""
    room, _ = COMMANDS[name]
    return importlib.import_module(f'binocular_recon.cli.{room}.{name.replace("-", "_")}')


def _parser(argv: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser; of all commands, only the one named in ``argv`` has its arguments."""
    parser = _Parser(
        prog=PROGRAM,
        description='Accurate 3-D point clouds of large scenes from a long-baseline stereo rig.',
        allow_abbrev=False,
    )
    parser.add_argument('--version', action='version', version=f'{PROGRAM} {__version__}')
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    chosen = _command(argv)
    for name, (_, summary) in COMMANDS.items():
        command = commands.add_parser(
            name, help=summary, description=summary[0].upper() + summary[1:] + '.'
        )
        if name == chosen:
            command_module(name).add_arguments(command)
    return parser
