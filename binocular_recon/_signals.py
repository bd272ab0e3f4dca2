# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM during what must not be interrupted."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def signals_deferred() -> Iterator[None]:
    """Let SIGINT and SIGTERM wait until the end of the block.

    Python delivers them to the main thread only.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    noticed: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: noticed.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if noticed:
        signal.raise_signal(noticed[0])
