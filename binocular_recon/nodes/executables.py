# SPDX-License-Identifier: Apache-2.0
"""The executables of the nodes: ``executables.NAME`` starts the node of this name.

Importing a node takes a second or two. A signal in this time ends the process like a later one.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable

from binocular_recon.apps.signals import leave, leave_on_signals


def __getattr__(name: str) -> Callable[[], int]:
    if not name.endswith('_node'):
        raise AttributeError(f'there is no node {name!r}')
    return functools.partial(start, name)


def start(name: str) -> int:
    """Run a node with the command line of the process and return its exit status."""
    leave_on_signals(lambda _terminated: leave(0))
    status: int = importlib.import_module(f'binocular_recon.nodes.{name}').main()
    return status
