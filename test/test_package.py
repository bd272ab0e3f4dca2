# SPDX-License-Identifier: Apache-2.0
"""The package's papers agree with each other and with its code."""

from __future__ import annotations

import ast
import re
import runpy
import sys
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

import binocular_recon
from test.conftest import REPOSITORY
from test.project_files import PYTHONS, tracked

PACKAGE = REPOSITORY / 'binocular_recon'
MANIFEST = ET.parse(REPOSITORY / 'package.xml').getroot()
# the installed one, not what an earlier build may have left beside the sources
INSTALLED = next(
    distribution
    for distribution in metadata.distributions(name='binocular_recon')
    if Path(str(distribution.locate_file(''))).resolve() != REPOSITORY
)
REQUIRED = [r for r in map(Requirement, INSTALLED.requires or []) if r.marker is None]

# rosdep's key and the name on the package index; what setup.py lists, package.xml lists too.
ROSDEP = {
    'python3-lz4': 'lz4',
    'python3-numba': 'numba',
    'python3-numpy': 'numpy',
    'python3-opencv': 'opencv-python-headless',
    'python3-rosbags-pip': 'rosbags',
    'python3-scipy': 'scipy',
    'python3-yaml': 'PyYAML',
}
TEST_ROSDEP = {
    'python3-packaging': 'packaging',
    'python3-pytest': 'pytest',
    'python3-pytest-timeout': 'pytest-timeout',
}
MODULE_NAMES = {
    'cv2': 'python3-opencv',
    'llvmlite': 'python3-numba',  # the part of it that writes intrinsics
    'rosbags': 'python3-rosbags-pip',
    'yaml': 'python3-yaml',
}


def exec_depends() -> dict[str, ET.Element]:
    """Return the run-time dependencies of package.xml by their key."""
    return {element.text or '': element for element in MANIFEST.iter('exec_depend')}


def rosdep_key(module: str) -> str:
    """Return the key of the package that a module is imported from."""
    names = {*ROSDEP.values(), *TEST_ROSDEP.values()}
    return MODULE_NAMES.get(module, f'python3-{module}' if module in names else module)


def imports(path: Path) -> set[str]:
    """Return the outermost package of everything that a module imports."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split('.')[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add((node.module or '').split('.')[0])
    return names


def test_versions_agree() -> None:
    changelog = (REPOSITORY / 'CHANGELOG.rst').read_text()
    newest = re.search(r'^(\d+\.\d+\.\d+) \(\d{4}-\d{2}-\d{2}\)\n-+$', changelog, re.MULTILINE)
    assert newest is not None
    assert binocular_recon.__version__ == newest[1]
    assert binocular_recon.__version__ == MANIFEST.findtext('version')
    assert binocular_recon.__version__ == INSTALLED.version


def test_manifest_is_of_format_3() -> None:
    assert MANIFEST.tag == 'package'
    assert MANIFEST.get('format') == '3'
    assert MANIFEST.findtext('name') == 'binocular_recon'
    assert MANIFEST.findtext('license') == 'Apache-2.0'
    assert MANIFEST.findtext('export/build_type') == 'ament_python'
    assert MANIFEST.findtext('description') == INSTALLED.metadata['Summary']
    assert re.fullmatch(r'[\w.-]+@[\w-]+(\.[\w-]+)+', MANIFEST.find('maintainer').get('email'))  # type: ignore[union-attr, arg-type]
    order = ['name', 'version', 'description', 'maintainer', 'license']
    assert [element.tag for element in MANIFEST][: len(order)] == order


@pytest.mark.parametrize('key', sorted(ROSDEP))
def test_ranges_of_setup_and_manifest_agree(key: str) -> None:
    (required,) = (r for r in REQUIRED if r.name == ROSDEP[key])
    ranges = {specifier.operator: Version(specifier.version) for specifier in required.specifier}
    declared = exec_depends()[key]
    # the fourth number of an OpenCV wheel is the build's, which apt's versions lack
    lowest = '.'.join(map(str, ranges.pop('>=').release[:3]))
    assert Version(declared.get('version_gte', '')) == Version(lowest)
    upper = declared.get('version_lt')
    assert ranges == ({'<': Version(upper)} if upper else {})


def test_the_documentation_installs_what_ubuntu_lacks() -> None:
    page = (REPOSITORY / 'docs' / 'install.md').read_text()
    (skipped,) = re.findall(r"--skip-keys '(.*)'", page)
    (installed,) = re.findall(r'^venv/bin/pip install (.*?) +#', page, re.MULTILINE)
    *packages, numpy = (Requirement(word.strip("'")) for word in installed.split())
    assert {package.name for package in packages} == {ROSDEP[key] for key in skipped.split()}
    assert {str(package) for package in packages} <= set(map(str, REQUIRED))
    assert str(numpy) == 'numpy<2'


def test_setup_and_manifest_list_the_same() -> None:
    assert {requirement.name for requirement in REQUIRED} == set(ROSDEP.values())
    keys = {key for key in exec_depends() if key.startswith('python3-')}
    assert keys == set(ROSDEP)


def test_dependencies_of_the_tests_are_declared_alike() -> None:
    extra = {'extra': 'test'}
    required = [r for r in map(Requirement, INSTALLED.requires or []) if r.marker is not None]
    names = {r.name for r in required if r.marker is not None and r.marker.evaluate(extra)}
    assert names == set(TEST_ROSDEP.values())
    assert set((REPOSITORY / 'requirements' / 'test.in').read_text().split()) == names
    assert all(names <= set(locked('test', python)) for python in PYTHONS)
    keys = {element.text or '' for element in MANIFEST.iter('test_depend')}
    assert {key for key in keys if key.startswith('python3-')} == set(TEST_ROSDEP)


def test_tests_import_what_is_declared() -> None:
    imported = {name for path in (REPOSITORY / 'test').rglob('*.py') for name in imports(path)}
    imported -= {'binocular_recon', 'test', *sys.stdlib_module_names}
    declared = {element.text for element in MANIFEST.iter('test_depend')} | set(exec_depends())
    assert {rosdep_key(name) for name in imported} <= declared


def test_dependencies_are_those_imported() -> None:
    paths = [*PACKAGE.rglob('*.py'), *(REPOSITORY / 'launch').glob('*.py')]
    imported = {name for path in paths for name in imports(path)}
    imported -= {'binocular_recon', *sys.stdlib_module_names}
    assert {rosdep_key(name) for name in imported} == set(exec_depends())


def test_pythons_are_the_same_everywhere() -> None:
    prefix = 'Programming Language :: Python :: 3.'
    classifiers = INSTALLED.metadata.get_all('Classifier', [])
    named = [name.rpartition(' ')[2] for name in classifiers if name.startswith(prefix)]
    assert named == PYTHONS
    assert INSTALLED.metadata['Requires-Python'] == f'>={PYTHONS[0]}'
    (makefile,) = re.findall(
        r'^PYTHONS \?= (.*)$', (REPOSITORY / 'Makefile').read_text(), re.MULTILINE
    )
    assert makefile.split() == [f'python{python}' for python in PYTHONS]
    script = runpy.run_path(str(REPOSITORY / 'requirements' / 'install.py'))
    assert [f'3.{script["OLDEST"]}', f'3.{script["NEWEST"]}'] == [PYTHONS[0], PYTHONS[-1]]


def test_executables_are_the_nodes_and_the_command_line() -> None:
    scripts = INSTALLED.entry_points.select(group='console_scripts')
    declared = {script.name: script.value for script in scripts}
    mains = {
        path.stem: f'binocular_recon.nodes.executables:{path.stem}'
        for path in (PACKAGE / 'nodes').glob('*_node.py')
    }
    assert {'rectify_node', 'match_node', 'wls_filter_node', 'calibration_node'} <= set(mains)
    commands = {
        'binocular-recon': 'binocular_recon.cli.main:main',
        'play_bag': 'binocular_recon.cli.clouds.play:main',
    }
    assert declared == mains | commands


def test_every_module_states_its_licence() -> None:
    modules = [path for path in tracked() if path.suffix == '.py']
    assert len(modules) > 20
    without = [
        str(path.relative_to(REPOSITORY))
        for path in modules
        if '# SPDX-License-Identifier: Apache-2.0\n' not in path.read_text()[:100]
    ]
    assert not without


def test_no_file_names_a_machine_or_an_index() -> None:
    pattern = re.compile(
        rb'(?<![\w.])/(?:root|work|home/(?!me/)\w+|opt/(?!ros\b))/'
        rb'|pythonhosted|pypi\.org/simple|--(?:extra-)?index-url|--find-links'
    )
    found = []
    for path in tracked():
        content = b'' if path == Path(__file__) else path.read_bytes()
        if b'\0' not in content[:8000]:
            found += [f'{path.name}: {match[0].decode()}' for match in pattern.finditer(content)]
    assert not found


def locked(name: str, python: str) -> dict[str, Version]:
    """Return the versions that a lock file pins for one CPython."""
    pins = {}
    text = (REPOSITORY / 'requirements' / f'{name}.txt').read_text()
    for line in text.replace(' \\\n', '').splitlines():
        if line.startswith('#'):
            continue
        pin, *hashes = line.split('    --hash=')
        assert hashes and all(re.fullmatch('sha256:[0-9a-f]{64}', one) for one in hashes), pin
        requirement = Requirement(pin)
        (version,) = requirement.specifier
        assert version.operator == '=='
        if requirement.marker is None or requirement.marker.evaluate({'python_version': python}):
            assert requirement.name not in pins
            pins[requirement.name] = Version(version.version)
    return pins


@pytest.mark.parametrize('python', PYTHONS)
def test_every_locked_version_has_hashes(python: str) -> None:
    for path in (REPOSITORY / 'requirements').glob('*.txt'):
        assert locked(path.stem, python), path


@pytest.mark.parametrize('python', PYTHONS)
@pytest.mark.parametrize('name', ['runtime', 'oldest'])
def test_locks_fit_the_ranges(name: str, python: str) -> None:
    pins = locked(name, python)
    for requirement in REQUIRED:
        assert requirement.specifier.contains(pins[requirement.name.lower()])


@pytest.mark.parametrize('python', PYTHONS)
@pytest.mark.parametrize('name', ['extras', 'oldest-extras'])
def test_locks_of_the_extras_fit_their_ranges(name: str, python: str) -> None:
    base = 'oldest' if name.startswith('oldest') else 'runtime'
    pins, others = locked(name, python), locked(base, python)
    listed = map(Requirement, INSTALLED.requires or [])
    users = [r for r in listed if r.marker and not r.marker.evaluate({'extra': 'test'})]
    assert len(users) >= 9
    for requirement in users:
        assert requirement.specifier.contains(pins[canonicalize_name(requirement.name)])
    assert pins['numpy'] == others['numpy']


@pytest.mark.parametrize('python', PYTHONS[:3])
def test_oldest_lock_is_of_the_oldest_in_range(python: str) -> None:
    pins = locked('oldest', python)
    assert (pins['numpy'], pins['scipy']) == (Version('1.26.4'), Version('1.11.4'))
    for name in ('opencv-python-headless', 'scipy', 'numba'):
        (required,) = (r for r in REQUIRED if r.name == name)
        (lowest,) = (s.version for s in required.specifier if s.operator == '>=')
        assert pins[name] == Version(lowest)


@pytest.mark.parametrize('python', PYTHONS)
def test_numba_is_bounded_by_the_newest_that_was_tried(python: str) -> None:
    """Its private parts are used (docs/numba.md): the next minor version may lack them."""
    (required,) = (r for r in REQUIRED if r.name == 'numba')
    (below,) = (s.version for s in required.specifier if s.operator == '<')
    newest = locked('runtime', python)['numba']
    assert Version(below) == Version(f'{newest.major}.{newest.minor + 1}')


def test_contrib_has_one_opencv() -> None:
    for python in PYTHONS:
        pins = locked('contrib', python)
        assert 'opencv-contrib-python-headless' in pins
        assert 'opencv-python-headless' not in pins
