# SPDX-License-Identifier: Apache-2.0
"""Which nodes exist: the modules ``<name>_node.py`` of this folder, one per node.

Such a module has a class whose ``NAME`` is the module's name, with ``INPUTS``, ``OUTPUTS``,
``SERVICES`` and the option groups ``LIVE`` and ``FIXED``, and a function ``main``. Nothing else
lists the nodes: ``setup.py`` makes an executable of each module, ``docs/make_nodes.py`` a section
of the page, and the tests go through all of them.
"""

from __future__ import annotations

import importlib
from pathlib import Path

from binocular_recon.nodes.runtime.base_node import BaseNode


def node_names() -> list[str]:
    """Return the names of the nodes in alphabetical order; their executables have the same."""
    return sorted(path.stem for path in Path(__file__).parent.glob('*_node.py'))


def node_class(name: str) -> type[BaseNode]:
    """Return the class of a node by its name."""
    module = importlib.import_module(f'binocular_recon.nodes.{name}')
    (found,) = (
        member
        for member in vars(module).values()
        if isinstance(member, type) and getattr(member, 'NAME', '') == name
    )
    return found
