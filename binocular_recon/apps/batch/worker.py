# SPDX-License-Identifier: Apache-2.0
"""A process that computes frames for another one, its parent, until that ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from multiprocessing.connection import Connection, wait

from binocular_recon._jit import limit_threads
from binocular_recon.apps.batch.frame_task import FrameOutcome, compute_frame
from binocular_recon.errors import BinocularReconError

READY = 'ready'


def serve(connection: Connection, threads: int) -> None:
    """Compute the frames that come through a connection, with so many threads.

    Ctrl-C goes to all processes of a terminal: the parent decides what it means.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    limit_threads(threads)
    outcome: FrameOutcome | BinocularReconError | str = READY
    while True:
        try:
            connection.send(outcome)
            task, folder = connection.recv()
        except (EOFError, ConnectionError):  # the parent has ended
            return
        try:
            outcome = compute_frame(task, folder)
        except BinocularReconError as error:
            outcome = error


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
