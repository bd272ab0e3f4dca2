# SPDX-License-Identifier: Apache-2.0
"""Settings of the documentation site, which ``make docs`` and rosdoc2 build with Sphinx.

The pages of the Python reference (``api/``) are written here from the names that each subpackage
exports, so a new name appears without being listed twice.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import pkgutil
import re
import typing
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import binocular_recon

# rosdoc2 copies this folder elsewhere, so the repository is found through the package
REPOSITORY = Path(binocular_recon.__file__).resolve().parents[1]
REFERENCE = Path(__file__).resolve().parent / 'api'
# Pages that show a file of the repository's root.
ROOT_FILES = {'changelog': 'CHANGELOG.rst', 'contributing': 'CONTRIBUTING.md'}

project = 'binocular_recon'
author = f'{project} maintainers'
copyright = author  # noqa: A001 - the name that Sphinx reads
version = release = binocular_recon.__version__

extensions = [
    'myst_parser',
    'sphinx.ext.autodoc',
    'sphinx.ext.napoleon',
    'sphinx.ext.viewcode',
]
exclude_patterns = ['_build']
exclude_patterns += ['__*', 'README.md', 'CHANGELOG.rst', 'CONTRIBUTING.md']  # added by rosdoc2
default_role = 'py:obj'
myst_heading_anchors = 3
autodoc_member_order = 'bysource'
toc_object_entries_show_parents = 'hide'
autodoc_typehints = 'none'  # docstrings state types, shapes and units
napoleon_custom_sections = [('Attributes', 'params_style')]  # `left, right : type` stays one line
napoleon_use_rtype = False

html_theme = 'furo' if importlib.util.find_spec('furo') else 'sphinx_rtd_theme'
html_title = f'{project} {release}'
html_static_path = ['_static']
html_css_files = ['site.css']
html_show_sphinx = False

# Nothing is fetched while the site is built.
rosdoc2_settings = {
    'override_theme': False,
    'enable_intersphinx': False,
    'automatically_extend_intersphinx_mapping': False,
}


def rooms() -> Iterator[ModuleType]:
    """Yield the package and its subpackages that export names, outer ones first."""
    found = pkgutil.walk_packages(binocular_recon.__path__, f'{project}.')
    names = [project, *(module.name for module in found if module.ispkg)]
    for name in sorted(names, key=lambda name: (name.count('.'), name)):
        if '._' not in name:
            room = importlib.import_module(name)
            if hasattr(room, '__all__'):
                yield room


def write_reference() -> dict[str, str]:
    """Write a page for each room; return the full name under which each name is documented.

    What several rooms export is documented once, in the outermost of them.
    """
    REFERENCE.mkdir(exist_ok=True)
    documented: dict[int, str] = {}
    names: dict[str, str] = {}
    pages = set()
    for room in rooms():
        # getattr also imports what is exported lazily, so that autodoc finds it in the room
        full = {
            name: documented.setdefault(id(getattr(room, name)), f'{room.__name__}.{name}')
            for name in room.__all__
            if not name.startswith('__')
        }
        names = full | names
        page = REFERENCE / f'{room.__name__}.rst'
        pages.add(page)
        _write(page, '\n'.join(_page(room, full)))
    for page in set(REFERENCE.glob('*.rst')) - pages:
        page.unlink()
    return names


def _write(page: Path, text: str) -> None:
    """Write a page unless it is unchanged: Sphinx reads again what is newer."""
    if not page.exists() or page.read_text(encoding='utf-8') != text:
        page.write_text(text, encoding='utf-8')


def _page(room: ModuleType, full: dict[str, str]) -> Iterator[str]:
    own = [name for name in full if full[name] == f'{room.__name__}.{name}']
    others = [f':py:obj:`~{full[name]}`' for name in full if name not in own]
    title = room.__name__.removeprefix(f'{project}.')
    yield from (title, '=' * len(title), '')
    yield from (f'.. automodule:: {room.__name__}', '   :no-members:', '')
    if others:
        yield from (f'Also exported here: {", ".join(others)}.', '')
    if own:
        yield from ('.. list-table::', '   :class: summary', '   :widths: auto', '')
        for name in own:
            yield f'   * - :py:obj:`~{full[name]}`'
            yield f'     - {_summary(room, name)}'
        yield ''
    for name in own:
        value = getattr(room, name)
        if inspect.isclass(value):
            kind = 'autoexception' if issubclass(value, Exception) else 'autoclass'
            members = ('   :members:', '   :special-members: __call__, __iter__')
            yield from (f'.. {kind}:: {full[name]}', *members, '')
        elif not _is_constant(value):
            yield from (f'.. autofunction:: {full[name]}', '')
        else:
            yield f'.. py:data:: {full[name]}'
            yield from ('', *(f'   {line}' for line in _comment(room, name)), '')


def _summary(room: ModuleType, name: str) -> str:
    value = getattr(room, name)
    constant = _is_constant(value)
    lines = _comment(room, name) if constant else (inspect.getdoc(value) or '').splitlines()
    return ' '.join(lines[: lines.index('')] if '' in lines else lines)


def _is_constant(value: Any) -> bool:
    """Return whether a name is a value or a type alias, which has a comment, not a docstring."""
    return not callable(value) or typing.get_origin(value) is not None


def _comment(room: ModuleType, name: str) -> list[str]:
    """Return the comment above a constant, in the module that defines it."""
    origins = {
        alias.name: node.module
        for node in ast.walk(ast.parse(inspect.getsource(room)))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    source = inspect.getsource(importlib.import_module(origins.get(name) or room.__name__))
    found = re.search(rf'((?:^#.*\n)*)^{name}\b.*=', source, re.MULTILINE)
    return [line.lstrip('#: ') for line in found[1].splitlines()] if found else []


def _show_root_file(_app: Any, page: str, source: list[str]) -> None:
    """Put a file of the repository's root in place of its page, and links to such files right."""
    text = source[0]
    if page in ROOT_FILES:
        text = (REPOSITORY / ROOT_FILES[page]).read_text(encoding='utf-8')
        text = re.sub(r'\]\((?!https?:|#)(docs/)?', lambda m: '](' if m[1] else '](../', text)
    for name, file in ROOT_FILES.items():
        text = text.replace(f'](../{file}', f']({name}{Path(file).suffix}')
    # what is not a page of the site is named
    source[0] = re.sub(r'\[([^]]*)\]\(\.\./([^)]*)\)', r'\1 (`\2`)', text)


def _find_by_last_name(app: Any, _env: Any, node: Any, content: Any) -> Any:
    """Resolve `Name` in a docstring to wherever the exported name is documented."""
    full = app.config.exported_names.get(node.get('reftarget'))
    if full is None or node.get('refdomain') != 'py':
        return None
    domain = app.env.domains['py']
    return domain.resolve_xref(app.env, node['refdoc'], app.builder, 'obj', full, node, content)


def setup(app: Any) -> None:
    """Write the reference and connect the functions above."""
    app.add_config_value('exported_names', write_reference(), '')
    app.connect('source-read', _show_root_file)
    app.connect('missing-reference', _find_by_last_name)
