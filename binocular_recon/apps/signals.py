# SPDX-License-Identifier: Apache-2.0
"""How processes of the package take SIGINT (Ctrl-C) and SIGTERM: they end soon and tidily."""

from __future__ import annotations

import _thread
import contextlib
import functools
import os
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

# Soon enough not to be noticed, late enough for the destructor to be over.
_AGAIN_S = 0.02


class Terminated(KeyboardInterrupt):
    """SIGTERM, as the KeyboardInterrupt of another sender."""


_ERRORS = {signal.SIGINT: KeyboardInterrupt, signal.SIGTERM: Terminated}
_raised: list[type[KeyboardInterrupt]] = []


def raise_signals() -> None:
    """Let SIGINT and SIGTERM raise in the main thread, unless the process was told to ignore them.

    An exception in a destructor or a callback of C code is lost; the signal is then raised again.
    Extensions may turn it into another exception: ask `raised`.
    """
    for number, error in _ERRORS.items():
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, functools.partial(_raise, error))
    sys.unraisablehook = _raise_again


def raised() -> type[KeyboardInterrupt] | None:
    """Return what the last signal raised, whatever became of it; None before the first."""
    return _raised[-1] if _raised else None


def leave_on_signals(end: Callable[[bool], object]) -> None:
    """Let SIGINT and SIGTERM call ``end``, which ends the process: while modules are imported.

    An exception that is raised in the import of an extension may come out as another one. ``end``
    is told whether it was SIGTERM. `raise_signals` ends this.
    """
    for number in _ERRORS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda sent, _: end(sent == signal.SIGTERM))


def ignore_signals() -> None:
    """Ignore SIGINT and SIGTERM from now on: the process is about to end."""
    for number in _ERRORS:
        signal.signal(number, signal.SIG_IGN)


def leave(status: int) -> None:
    """End the process now, without waiting for threads that still compile or compute."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # its reader is gone
            stream.flush()
    os._exit(status)


def _raise(error: type[KeyboardInterrupt], _number: int, _frame: object) -> None:
    _raised.append(error)
    raise error


def _raise_again(unraisable: Any) -> None:
    for number, error in _ERRORS.items():
        if unraisable.exc_type is error:
            _thread.start_new_thread(_interrupt_later, (number,))
            return
    sys.__unraisablehook__(unraisable)


def _interrupt_later(number: signal.Signals) -> None:
    time.sleep(_AGAIN_S)
    _thread.interrupt_main(number)
