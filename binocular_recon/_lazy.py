# SPDX-License-Identifier: Apache-2.0
"""Public names of a package, imported on first use (SPEC 1 of Scientific Python).

``from binocular_recon import read_rig`` does not load compilers and solvers that it never calls,
and a node loads only what it uses.
"""

from __future__ import annotations

import ast
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any


def lazy_exports(package: str, file: str) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package that imports its public names on first use.

    The names are those that the package's ``__init__.py`` imports under ``if TYPE_CHECKING:``:
    one list for type checkers, readers and this function.

    Parameters
    ----------
    package : str
        ``__name__`` of the package.
    file : str
        Its ``__file__``.

    """
    origins = {
        alias.asname or alias.name: node.module or ''
        for block in ast.parse(Path(file).read_text(encoding='utf-8')).body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }

    def get(name: str) -> Any:
        if name not in origins:
            raise AttributeError(f'module {package!r} has no attribute {name!r}')
        value = getattr(importlib.import_module(origins[name]), name)
        vars(importlib.import_module(package))[name] = value
        return value

    return get
