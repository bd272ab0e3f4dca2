# SPDX-License-Identifier: Apache-2.0
"""``view``: a page of this machine to look at a reconstruction, click and measure."""

from __future__ import annotations

import argparse
import os
import threading
import webbrowser
from pathlib import Path

from binocular_recon.cli.options import add_pick_sigma_option, non_negative, note, positive, say
from binocular_recon.viewer.coloured_frame import MOST_POINTS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``view``."""
    parser.add_argument('folder', type=Path, metavar='OUTPUT', help='output folder of reconstruct')
    parser.add_argument(
        '--picks', type=Path, metavar='FILE',
        help='picks file that is read, and written at each click; measure reads it. YAML keeps'
        ' what is measured too, CSV the picks only (picks.yaml in OUTPUT)',
    )  # fmt: skip
    parser.add_argument(
        '--port', type=non_negative, default=0, metavar='N',
        help='port on 127.0.0.1 (one that is free)',
    )  # fmt: skip
    parser.add_argument(
        '--no-browser', action='store_true', help='print the address, but open no browser'
    )
    parser.add_argument(
        '--max-points', type=positive(int), default=MOST_POINTS, metavar='N',
        help='the shown cloud is thinned to about this number; measuring uses every pixel'
        ' (%(default)s)',
    )  # fmt: skip
    add_pick_sigma_option(parser)


def run(args: argparse.Namespace) -> None:
    """Serve the page until the command is interrupted.

    Raises
    ------
    BinocularReconError
        If the folder or the picks cannot be read, viser is missing, or the port is in use.

    """
    from binocular_recon.apps.survey.measured_folder import MeasuredFolder
    from binocular_recon.viewer import PageServer, PicksBoard, SharedView

    board = PicksBoard(args.picks or args.folder / 'picks.yaml')
    view = SharedView(MeasuredFolder(args.folder), board, args.pick_sigma, args.max_points)
    server = PageServer(view, args.port)
    try:
        say(server.address)
        note('Ctrl-C ends it; the page is served to this machine only')
        # without a screen, a browser would be one of the terminal
        if not args.no_browser and {'DISPLAY', 'WAYLAND_DISPLAY'} & set(os.environ):
            webbrowser.open(server.address)
        threading.Event().wait()
    except KeyboardInterrupt as interrupt:
        count = len(board.marks.picks)
        interrupt.args = (f'{count} pick{"" if count == 1 else "s"} in {board.path}',)
        raise
