# SPDX-License-Identifier: Apache-2.0
"""The command line: finds the command, runs it and turns errors into exit statuses."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

from binocular_recon import __version__
from binocular_recon.errors import BinocularReconError, ConfigError

# What each command's module of this package does; only the module of the command is imported.
COMMANDS = {
    'demo': 'the whole chain on a real picture pair that comes with the project',
    'reconstruct': 'a stereo bag in, point clouds and disparity maps out',
    'match': 'dense disparity of one rectified pair of picture files',
    'play': 'publish a bag on ROS 2 topics',
    'calibrate': 'pictures of rods, or points of a flat target, to a calibrated stereo rig',
    'simulate': 'pictures of rods, or a survey scene as a bag, with ground truth',
    'paper': 'the paper end to end on simulated sites: its Tables 1, 2 and 3 beside ours',
    'evaluate': "accuracy on scenes with ground truth, against OpenCV's matchers",
    'benchmark': 'speed and memory of every stage, against its peers',
}

EXIT_DONE, EXIT_PROBLEM, EXIT_USAGE, EXIT_INTERRUPTED = 0, 1, 2, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; those of the process by default.

    Returns
    -------
    status : int
        0 done, 1 a problem with the input, 2 wrong usage, 130 interrupted; one line on stderr
        unless 0. What the parser refuses raises ``SystemExit(2)``.

    """
    argv = sys.argv[1:] if argv is None else argv
    args = _parser(argv).parse_args(argv)
    module = importlib.import_module(f'binocular_recon.cli.{args.command}')
    try:
        module.run(args)
    except BrokenPipeError:  # who reads the output, such as `head`, has enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_PROBLEM
    except (BinocularReconError, OSError, MemoryError) as error:
        message = ' '.join(str(error).split())
        if isinstance(error, MemoryError):
            message = f'{message}; choose a smaller disparity_range or smaller pictures'
        print(f'binocular_recon {args.command}: {message}', file=sys.stderr)
        return EXIT_USAGE if isinstance(error, ConfigError) else EXIT_PROBLEM
    except KeyboardInterrupt as interrupt:
        kept = f'; {interrupt}' if str(interrupt) else ''
        print(f'binocular_recon {args.command}: interrupted{kept}', file=sys.stderr)
        return EXIT_INTERRUPTED
    return EXIT_DONE


def _parser(argv: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser; only the command in ``argv`` has its arguments, which its module adds."""
    parser = argparse.ArgumentParser(
        prog='binocular_recon',
        description='Accurate 3-D point clouds of large scenes from a long-baseline stereo rig.',
        allow_abbrev=False,
    )
    parser.add_argument('--version', action='version', version=f'binocular_recon {__version__}')
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    asked = next((word for word in argv if not word.startswith('-')), None)
    for name, summary in COMMANDS.items():
        command = commands.add_parser(
            name, help=summary, description=summary[0].upper() + summary[1:] + '.'
        )
        if name == asked:
            importlib.import_module(f'binocular_recon.cli.{name}').add_arguments(command)
    return parser
