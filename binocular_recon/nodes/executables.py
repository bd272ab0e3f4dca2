# SPDX-License-Identifier: Apache-2.0
"""The executables of the nodes: ``executables.NAME`` starts the node of this name.

Importing a node takes a second or two. A signal in this time ends the process like a later one.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable

from binocular_recon.apps.signals import ignore_signals, leave, raise_signals


def __getattr__(name: str) -> Callable[[], int]:
    if not name.endswith('_node'):
        raise AttributeError(f'there is no node {name!r}')
    return functools.partial(start, name)


def start(name: str) -> int:
    """Run a node with the command line of the process and return its exit status."""
    raise_signals()
    try:
        status: int = importlib.import_module(f'binocular_recon.nodes.{name}').main()
    except KeyboardInterrupt:
        ignore_signals()
        leave(0)
    return status
