# SPDX-License-Identifier: Apache-2.0
"""The documentation says what the code does; `test_examples` runs what it shows."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import importlib.util
import inspect
import pkgutil
import re
import typing
from pathlib import Path
from typing import Any

import pytest
import yaml

import binocular_recon
from binocular_recon.cli.main import COMMANDS
from binocular_recon.config import PRESETS, ChainConfig, MatchConfig
from binocular_recon.io.calibrations import FORMATS
from binocular_recon.io.messages.encodings import ENCODINGS
from binocular_recon.lenses import LENSES
from binocular_recon.stereo.rectification import LARGEST_SIDE_PX
from test.conftest import REPOSITORY

PACKAGE = REPOSITORY / 'binocular_recon'
DOCS = REPOSITORY / 'docs'
PAGES = [REPOSITORY / 'README.md', REPOSITORY / 'CONTRIBUTING.md', *sorted(DOCS.glob('*.md'))]


def page(name: str) -> str:
    """Return the text of a page of docs/, or of the repository's root."""
    path = DOCS / name
    return (path if path.exists() else REPOSITORY / name).read_text()


def table(text: str, head: str) -> list[list[str]]:
    """Return the cells of the table whose first line begins with ``| head |``."""
    (found,) = re.findall(
        rf'^\| {re.escape(head)} \|.*\n\|[-| :]+\n((?:\|.*\n)+)', text, re.MULTILINE
    )
    return [
        [cell.strip() for cell in re.split(r'(?<!\\)\|', line)[1:-1]]
        for line in found.splitlines()
    ]


@pytest.mark.ros
def test_nodes_page_is_what_the_nodes_declare() -> None:
    spec = importlib.util.spec_from_file_location('make_nodes', DOCS / 'make_nodes.py')
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.PAGE.read_text() == module.page(), 'run make docs'


@pytest.mark.ros
def test_the_robot_page_states_the_defaults_of_real_parameters() -> None:
    from binocular_recon.nodes.runtime import options

    groups = [value for value in vars(options).values() if dataclasses.is_dataclass(value)]
    groups += [type(group) for group in vars(ChainConfig()).values()]
    text = page('robot.md')
    # what a group changes of the one that it is derived from is stated in words
    late = options.LateInputOptions()
    assert f'{late.queue_size} in `wls_filter_node`' in text
    defaults = {s.name: s.default for g in reversed(groups) for s in dataclasses.fields(g)}
    rows = table(text, 'parameter')
    assert len(rows) >= 5
    for names, stated, _ in rows:
        for name, value in zip(re.findall('`(.*?)`', names), stated.split(','), strict=True):
            default = defaults[name]
            shown = str(default).lower() if isinstance(default, (bool, str)) else f'{default:g}'
            assert value.strip() == shown, name
    (presets,) = (row[2] for row in rows if row[0] == '`preset`')
    assert all(f'`{preset}`' in presets for preset in PRESETS)


def test_the_limits_are_those_of_the_code() -> None:
    rows: dict[str, str] = dict(table(page('limits.md'), 'limit'))
    assert f'{LARGEST_SIDE_PX} px a side' in rows['images']
    assert f'{LARGEST_SIDE_PX} px a side' in page('README.md')
    assert rows['lenses'].split(', ') == list(LENSES)
    stated = re.sub(r'\(.*?\)', '', rows['encodings'].partition(';')[0])
    assert {name.strip() for name in stated.split(',')} == set(ENCODINGS)
    limits = {spec.name: spec.metadata for spec in dataclasses.fields(MatchConfig)}
    count, least = limits['disparity_range'], limits['min_disparity']
    assert rows['disparities'] == (
        f'2 to {count["maximum"]} (0: found from the images), the smallest within'
        f' {least["minimum"]} to {least["maximum"]} px'
    )


def test_the_survey_page_lists_all_commands() -> None:
    cells = ' '.join(row[0] for row in table(page('survey.md'), 'command'))
    assert {name.split()[0] for name in re.findall('`(.*?)`', cells)} == set(COMMANDS)


def test_the_calibrations_page_lists_all_formats() -> None:
    read, *_ = re.findall(r'(?:^\|.*\n)+', page('calibrations.md'), re.MULTILINE)
    assert [row.split('|')[1].strip() for row in read.splitlines()[2:]] == [
        one.NAME for one in FORMATS
    ]


def test_the_readme_is_short_and_leads_to_every_page() -> None:
    readme = page('README.md')
    (rows,) = re.findall(r'(?:^\|.*\n)+', readme, re.MULTILINE)
    head, _, *body = rows.splitlines()
    assert len(body) + 1 <= 6
    assert head.count('|') - 1 <= 5
    linked = set(re.findall(r'\]\(([^)#]*)', readme))
    pages = {f'docs/{path.name}' for path in DOCS.glob('*.md')}
    # these show files of the root, which are linked themselves
    pages -= {'docs/contributing.md', 'docs/changelog.md'}
    assert pages | {'CONTRIBUTING.md', 'CHANGELOG.rst', 'LICENSE', 'CITATION.cff'} <= linked


@pytest.mark.parametrize('path', PAGES, ids=lambda path: path.name)
def test_links_lead_somewhere(path: Path) -> None:
    text = re.sub(r'^```.*?^```', '', path.read_text(), flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r'\]\((?!https?:)([^)]*)\)', text):
        file, _, heading = target.partition('#')
        there = path.parent / file if file else path
        assert there.exists(), target
        if heading:
            headings = re.findall(r'^#+ (.*)', there.read_text(), re.MULTILINE)
            slugs = {re.sub(r'[^\w -]', '', h.lower()).replace(' ', '-') for h in headings}
            assert heading in slugs, target


@pytest.mark.parametrize('path', PAGES, ids=lambda path: path.name)
def test_named_files_and_targets_exist(path: Path) -> None:
    text = path.read_text()
    sources = [*PACKAGE.rglob('*.py'), *REPOSITORY.glob('*.py')]
    sources += [*REPOSITORY.glob('test/**/*.py'), *REPOSITORY.glob('tools/*.py')]
    for name in re.findall(r'`((?:\w+/)*\w+\.py)`', text):
        assert any(source.as_posix().endswith(f'/{name}') for source in sources), name
    for name in re.findall(r'`((?:\w+/)+)`', text):
        assert any((base / name).is_dir() for base in (REPOSITORY, PACKAGE)) or name in OUTPUTS
    for target in re.findall(r'`make ([a-z]\w*)', text):
        assert re.search(rf'^{target}\b.*:', page('Makefile'), re.MULTILINE), target


# Folders that a command or a tool makes.
OUTPUTS = {
    'OUTPUT/export/', 'api/', 'bag/', 'captures/', 'captures/dropped/', 'merged/',
    'out/', 'out/fuzz/', 'site/', 'stationA/', 'stationB/', 'stationC/',
    'rig/', 'rig/captures/dropped/', 'rig/previous/',
}  # fmt: skip


def test_a_newcomers_ten_questions_are_answered_by_files() -> None:
    rows = table(page('CONTRIBUTING.md'), 'question')
    assert len(rows) == 10
    for question, answer in rows:
        assert question.endswith('?')
        assert re.search(r'`[\w/]+(\.py|/)`', answer), question


def test_the_table_of_extensions_names_registries_that_exist() -> None:
    rows = table(page('CONTRIBUTING.md'), 'add')
    assert len(rows) == 7
    for what, _, registry, test in rows:
        for file in re.findall(r'`([\w/]+\.py)`', registry):
            source = (PACKAGE / file).read_text()
            for name in re.findall(r'`([A-Z_]{4,}|\w+(?=\())', registry):
                assert re.search(rf'^(def |class )?{name}\b', source, re.MULTILINE), (
                    f'{what}: {name}'
                )
        for path in re.findall(r'`(test/[\w/.]+)`', test):
            assert (REPOSITORY / path).exists(), path


def test_the_glossary_names_what_is_in_the_code() -> None:
    words = set()
    for path in PACKAGE.rglob('*.py'):
        words |= set(re.findall(r'\w+', path.read_text()))
    rows = [row for row in table(page('glossary.md'), 'term') if any(row[1:])]
    terms = [row[0] for row in rows]
    assert len(terms) == len(set(terms))
    named = {name for row in rows for name in re.findall(r'`(\w+)`', row[3])}
    assert len(named) > 50
    assert not named - words


def rooms() -> list[Any]:
    """Return the package and its subpackages that export names."""
    found = pkgutil.walk_packages(binocular_recon.__path__, 'binocular_recon.')
    names = [module.name for module in found if module.ispkg and '._' not in module.name]
    modules = [importlib.import_module(name) for name in ['binocular_recon', *names]]
    return [module for module in modules if hasattr(module, '__all__')]


@pytest.mark.parametrize('room', rooms(), ids=lambda room: room.__name__)
def test_every_public_name_is_documented(room: Any) -> None:
    for name in room.__all__:
        value = getattr(room, name)
        if callable(value) and typing.get_origin(value) is None:
            text = inspect.getdoc(value) or ''
            # what dataclass and object give every class
            assert not text.startswith(f'{name}('), name
            assert len(text.split()) > 3, name
        elif not name.startswith('__'):
            tree = ast.parse(inspect.getsource(room))
            (origin,) = (
                str(node.module)
                for node in ast.walk(tree)
                if isinstance(node, ast.ImportFrom) and name in {one.name for one in node.names}
            )
            source = inspect.getsource(importlib.import_module(origin))
            assert re.search(rf'^#.*\n{name}\b.*=', source, re.MULTILINE), name


def test_rosdoc2_builds_the_site_of_docs() -> None:
    head, settings = yaml.safe_load_all((REPOSITORY / 'rosdoc2.yaml').read_text())
    assert head == {'type': 'rosdoc2 config', 'version': 1}
    (builder,) = settings['builders']
    assert (REPOSITORY / builder['sphinx']['sphinx_sourcedir'] / 'conf.py').is_file()
