# SPDX-License-Identifier: Apache-2.0
"""docs/numba.md lists every part of numba that the code uses and numba may change."""

from __future__ import annotations

import ast
import re
from collections import defaultdict

import pytest

from test.conftest import REPOSITORY

PACKAGE = REPOSITORY / 'binocular_recon'
PAGE = (REPOSITORY / 'docs' / 'numba.md').read_text()
# What numba's documentation offers to other packages.
PUBLIC = {'numba', 'numba.extending'}
# The names under which code generators get numba's objects.
GENERATOR_ARGUMENTS = {'context', 'manager'}


def imported_names(tree: ast.Module) -> set[tuple[str, str]]:
    """Return module and name of what comes from numba or llvmlite; of a whole module no name."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {(alias.name, '') for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {(node.module or '', alias.name) for alias in node.names}
    return {pair for pair in names if pair[0].split('.')[0] in {'numba', 'llvmlite'}}


def private_names(text: str) -> set[str]:
    """Return the private parts of numba and llvmlite that a module uses."""
    tree = ast.parse(text)
    imported = imported_names(tree)
    private = {(module, name) for module, name in imported if module not in PUBLIC}
    bases = {name for _, name in private}
    names = {f'{module}.{name}'.rstrip('.') for module, name in private}
    for node in ast.walk(tree) if imported else ():
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.value.id in GENERATOR_ARGUMENTS:
                names.add(f'{node.value.id}.{node.attr}')
            elif private and re.match('_(?!_)', node.attr):
                names.add(node.attr)
        elif isinstance(node, ast.ClassDef) and bases & {ast.unparse(b) for b in node.bases}:
            names |= _inherited(node)
        elif isinstance(node, ast.Call):
            names |= set(re.findall(r"^getattr\(.*, '(_\w+)', None\)$", ast.unparse(node)))
    return names


def _inherited(node: ast.ClassDef) -> set[str]:
    """Return what a class overrides or calls of its base."""
    methods = {item.name for item in node.body if isinstance(item, ast.FunctionDef)}
    called = {
        item.attr
        for item in ast.walk(node)
        if isinstance(item, ast.Attribute) and ast.unparse(item.value) in {'self', 'super()'}
    }
    return methods | called


def test_the_page_lists_what_the_code_uses() -> None:
    used = defaultdict(set)
    for path in PACKAGE.rglob('*.py'):
        for name in private_names(path.read_text()):
            used[name].add(path.relative_to(PACKAGE).as_posix())
    rows = re.findall(r'^\| `([\w.]+)` \| (.*?) \|', PAGE, re.MULTILINE)
    listed = {name: set(re.findall('`(.*?)`', files)) for name, files in rows}
    assert len(rows) == len(listed)
    assert listed == used


def test_the_page_names_tests_that_exist() -> None:
    named = re.findall(r'`(test/[\w/.]+\.py)(?:::(\w+))?`', PAGE)
    assert len(named) >= 4
    for file, test in named:
        assert f'def {test}' in (REPOSITORY / file).read_text(), file


@pytest.mark.parametrize(
    ('line', 'found'),
    [
        ('from numba import njit, types', set()),
        ('from numba.extending import intrinsic', set()),
        ('from numba.core import cgutils', {'numba.core.cgutils'}),
        ('import numba.core.ir', {'numba.core.ir'}),
        ('import numba\ndef f(context): context.cast(1)', {'context.cast'}),
        ("import numba\ngetattr(compiled, '_compiler', None)", {'_compiler'}),
        ('from numba.core.caching import Cache\nc._impl', {'numba.core.caching.Cache', '_impl'}),
        (
            'from numba.core.caching import Cache\nclass C(Cache):\n def save(self): self.load()',
            {'numba.core.caching.Cache', 'save', 'load'},
        ),
    ],
)
def test_private_names_are_recognised(line: str, found: set[str]) -> None:
    assert private_names(line) == found


def test_the_page_states_the_bound() -> None:
    (bound,) = re.findall(r"'numba>=[\d.]+,<([\d.]+)'", (REPOSITORY / 'setup.py').read_text())
    assert f'below {bound},' in PAGE
    assert f'numba=={bound}.*' in PAGE
