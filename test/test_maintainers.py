# SPDX-License-Identifier: Apache-2.0
"""Who maintains the project, and where it lives, is set in MAINTAINERS.md and nowhere else."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import pytest
import yaml

import binocular_recon
from test.conftest import REPOSITORY
from test.project_files import project_texts

TOOL = SimpleNamespace(**runpy.run_path(str(REPOSITORY / 'tools' / 'maintainers.py')))
FACTS = TOOL.facts()
FILLED = {
    'maintainer': 'Ada & Co',
    'e-mail': 'ada@rods.invalid',
    'repository': 'https://rods.invalid/repository',
    'issues': 'https://rods.invalid/issues',
    'documentation': 'https://rods.invalid/docs',
}
STATED_IN = {
    'MAINTAINERS.md',
    'package.xml',
    'CITATION.cff',
    'tools/maintainers.py',  # the address under .invalid
    'test/test_maintainers.py',
}


def test_fields_are_set_or_empty() -> None:
    assert list(FACTS) == list(FILLED)
    assert FACTS['maintainer']
    assert not FACTS['e-mail'] or re.fullmatch(r'[\w.+-]+@[\w-]+(\.[\w-]+)+', FACTS['e-mail'])
    for field in ('repository', 'issues', 'documentation'):
        assert not FACTS[field] or re.fullmatch(r'https://[^\s"|]+[^\s"|/]', FACTS[field])


@pytest.mark.parametrize('name', ['package.xml', 'CITATION.cff'])
def test_files_repeat_the_table(name: str) -> None:
    text = (REPOSITORY / name).read_text()
    assert TOOL.FILES[name](text, FACTS) == text, 'run make maintainers'


def test_no_other_file_states_a_fact() -> None:
    """No other file has a mail address of anybody, or an address of the project."""
    mail = re.compile(r'(?<![\w.+-])[\w.+-]+@[\w-]+(?:\.[\w-]+)*\.[a-z]{2,}\b')
    addresses = [value for field, value in FACTS.items() if field != 'maintainer' and value]
    found = {
        name: [*mail.findall(text), *(address for address in addresses if address in text)]
        for name, text in project_texts().items()
        if name not in STATED_IN
    }
    assert not {name: stated for name, stated in found.items() if stated}


def test_the_address_that_the_schema_asks_for_cannot_exist() -> None:
    """RFC 2606 keeps ``.invalid`` free; it is there until MAINTAINERS.md has a real address."""
    maintainer = ET.parse(REPOSITORY / 'package.xml').getroot().find('maintainer')
    assert maintainer is not None
    assert maintainer.text == FACTS['maintainer']
    assert maintainer.get('email') == (FACTS['e-mail'] or 'maintainers@binocular-recon.invalid')


def test_a_filled_table_reaches_the_manifest() -> None:
    manifest = TOOL.manifest((REPOSITORY / 'package.xml').read_text(), FILLED)
    root = ET.fromstring(manifest)
    maintainer = root.find('maintainer')
    assert maintainer is not None
    assert (maintainer.text, maintainer.get('email')) == ('Ada & Co', 'ada@rods.invalid')
    assert {url.get('type'): url.text for url in root.iter('url')} == {
        'website': 'https://rods.invalid/docs',
        'repository': 'https://rods.invalid/repository',
        'bugtracker': 'https://rods.invalid/issues',
    }
    # the schema gives an order: addresses follow the licence
    tags = [element.tag for element in root]
    assert tags[3:8] == ['maintainer', 'license', 'url', 'url', 'url']
    assert TOOL.manifest(manifest, FILLED) == manifest
    assert TOOL.manifest(manifest, FACTS) == (REPOSITORY / 'package.xml').read_text()


def test_a_filled_table_reaches_the_citation() -> None:
    text = TOOL.citation((REPOSITORY / 'CITATION.cff').read_text(), FILLED)
    citation = yaml.safe_load(text)
    assert citation['authors'] == [{'name': 'Ada & Co'}]
    assert citation['repository-code'] == 'https://rods.invalid/repository'
    assert citation['url'] == 'https://rods.invalid/docs'
    assert TOOL.citation(text, FILLED) == text
    assert TOOL.citation(text, FACTS) == (REPOSITORY / 'CITATION.cff').read_text()


def test_a_filled_table_reaches_the_metadata(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = ''.join(f'| {field} | {value} |\n' for field, value in FILLED.items())
    (tmp_path / 'MAINTAINERS.md').write_text(f'| field | value |\n|---|---|\n{rows}')
    (tmp_path / 'setup.py').write_text((REPOSITORY / 'setup.py').read_text())
    (tmp_path / 'README.md').write_text('![a](docs/a.jpg) [b](docs/b.md) [c](#c) <https://d.e>')
    monkeypatch.chdir(tmp_path)
    arguments = runpy.run_path('setup.py')['arguments']()
    assert arguments['maintainer'] == 'Ada & Co'
    assert arguments['maintainer_email'] == 'ada@rods.invalid'
    assert arguments['project_urls'] == {
        'Source': 'https://rods.invalid/repository',
        'Issues': 'https://rods.invalid/issues',
        'Documentation': 'https://rods.invalid/docs',
    }
    # an index shows the README, but has no files beside it
    assert arguments['long_description'] == (
        '![a](https://rods.invalid/repository/raw/HEAD/docs/a.jpg)'
        ' [b](https://rods.invalid/repository/blob/HEAD/docs/b.md) [c](#c) <https://d.e>'
    )


def test_the_citation_is_of_the_newest_release() -> None:
    citation = yaml.safe_load((REPOSITORY / 'CITATION.cff').read_text())
    assert citation['cff-version'] == '1.2.0'
    assert {'message', 'title', 'authors'} <= set(citation)
    assert citation['version'] == binocular_recon.__version__
    released = f'{citation["version"]} ({citation["date-released"]})\n'
    assert released in (REPOSITORY / 'CHANGELOG.rst').read_text()
    assert citation['license'] == 'Apache-2.0'
