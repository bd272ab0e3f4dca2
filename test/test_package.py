# SPDX-License-Identifier: Apache-2.0
"""The package's papers agree with each other and with its code."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

import binocular_recon

REPOSITORY = Path(__file__).resolve().parents[1]
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
    'python3-numba': 'numba',
    'python3-numpy': 'numpy',
    'python3-opencv': 'opencv-python-headless',
    'python3-rosbags-pip': 'rosbags',
    'python3-scipy': 'scipy',
    'python3-yaml': 'PyYAML',
}
MODULE_NAMES = {
    'cv2': 'python3-opencv',
    'llvmlite': 'python3-numba',  # the part of it that writes intrinsics
    'rosbags': 'python3-rosbags-pip',
    'yaml': 'python3-yaml',
}
SHARED = ['bags', 'config', 'launch', 'rviz']
PYTHONS = ['3.10', '3.11', '3.12', '3.13']


def tracked() -> list[Path]:
    """Return the files under version control, or all that an unpacked release holds."""
    if (REPOSITORY / '.git').exists():
        command = ['git', 'ls-files', '-z', '--cached', '--others', '--exclude-standard']
        names = subprocess.run(command, cwd=REPOSITORY, capture_output=True, check=True).stdout
        paths = [REPOSITORY / name for name in names.decode().split('\0') if name]
    else:
        paths = [p for p in REPOSITORY.rglob('*') if '__pycache__' not in p.parts]
    return [path for path in paths if path.is_file()]


def exec_depends() -> dict[str, ET.Element]:
    """Return the run-time dependencies of package.xml by their key."""
    return {element.text or '': element for element in MANIFEST.iter('exec_depend')}


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


def test_the_readme_installs_what_ubuntu_lacks() -> None:
    readme = (REPOSITORY / 'README.md').read_text()
    (skipped,) = re.findall(r"--skip-keys '(.*)'", readme)
    (installed,) = re.findall(r'^venv/bin/pip install (.*?) +#', readme, re.MULTILINE)
    *packages, numpy = (Requirement(word.strip("'")) for word in installed.split())
    assert {package.name for package in packages} == {ROSDEP[key] for key in skipped.split()}
    assert {str(package) for package in packages} <= set(map(str, REQUIRED))
    assert str(numpy) == 'numpy<2'


def test_setup_and_manifest_list_the_same() -> None:
    assert {requirement.name for requirement in REQUIRED} == set(ROSDEP.values())
    keys = {key for key in exec_depends() if key.startswith('python3-')}
    assert keys == set(ROSDEP)


def test_dependencies_are_those_imported() -> None:
    imported = set()
    for path in [*PACKAGE.rglob('*.py'), *(REPOSITORY / 'launch').glob('*.py')]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                imported.add((node.module or '').split('.')[0])
    imported -= {'binocular_recon', *sys.stdlib_module_names}
    keys = {MODULE_NAMES.get(n, f'python3-{n}' if n in ROSDEP.values() else n) for n in imported}
    assert keys == set(exec_depends())


def test_executables_are_the_nodes_and_the_command_line() -> None:
    scripts = INSTALLED.entry_points.select(group='console_scripts')
    declared = {script.name: script.value for script in scripts}
    mains = {
        path.stem: f'binocular_recon.nodes.{path.stem}:main'
        for path in (PACKAGE / 'nodes').glob('*_node.py')
    }
    assert {'rectify_node', 'match_node', 'wls_filter_node', 'calibration_node'} <= set(mains)
    commands = {
        'binocular-recon': 'binocular_recon.cli.main:main',
        'play_bag': 'binocular_recon.cli.play:main',
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
    for line in (REPOSITORY / 'requirements' / f'{name}.txt').read_text().splitlines():
        if line.startswith('#'):
            continue
        requirement = Requirement(line)
        (pin,) = requirement.specifier
        assert pin.operator == '=='
        if requirement.marker is None or requirement.marker.evaluate({'python_version': python}):
            assert requirement.name not in pins
            pins[requirement.name] = Version(pin.version)
    return pins


@pytest.mark.parametrize('python', PYTHONS)
@pytest.mark.parametrize('name', ['runtime', 'oldest'])
def test_locks_fit_the_ranges(name: str, python: str) -> None:
    pins = locked(name, python)
    for requirement in REQUIRED:
        assert requirement.specifier.contains(pins[requirement.name.lower()])


@pytest.mark.parametrize('python', PYTHONS[:3])
def test_oldest_lock_is_of_the_oldest_in_range(python: str) -> None:
    pins = locked('oldest', python)
    assert (pins['numpy'], pins['scipy']) == (Version('1.26.4'), Version('1.11.4'))
    for name in ('opencv-python-headless', 'scipy', 'numba'):
        (required,) = (r for r in REQUIRED if r.name == name)
        (lowest,) = (s.version for s in required.specifier if s.operator == '>=')
        assert pins[name] == Version(lowest)


def test_contrib_has_one_opencv() -> None:
    for python in PYTHONS:
        pins = locked('contrib', python)
        assert 'opencv-contrib-python-headless' in pins
        assert 'opencv-python-headless' not in pins


def test_wheel_holds_the_whole_package(tmp_path: Path) -> None:
    pytest.importorskip('pip')
    if Version(metadata.version('setuptools')) < Version('70.1'):
        pytest.skip('setuptools before 70.1 leaves the making of wheels to another package')
    for name in ('binocular_recon', 'resource', *SHARED):
        if (REPOSITORY / name).is_dir():
            ignore = shutil.ignore_patterns('__pycache__')
            shutil.copytree(REPOSITORY / name, tmp_path / 'source' / name, ignore=ignore)
    for name in ('package.xml', 'setup.py', 'setup.cfg', 'LICENSE'):
        shutil.copy(REPOSITORY / name, tmp_path / 'source')
    command = [sys.executable, '-m', 'pip', 'wheel', '-qq', '--no-deps', '--no-build-isolation']
    subprocess.run([*command, '-w', tmp_path, tmp_path / 'source'], check=True)

    (wheel,) = tmp_path.glob('*.whl')
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        archive.extractall(tmp_path / 'site')
    source = tmp_path / 'source'
    files = [path for path in (source / 'binocular_recon').rglob('*') if path.is_file()]
    assert {str(path.relative_to(source)) for path in files} <= names
    assert not [name for name in names if name.startswith('test')]
    data = f'binocular_recon-{binocular_recon.__version__}.data/data/share'
    assert f'{data}/ament_index/resource_index/packages/binocular_recon' in names
    for path in tracked():
        inside = path.relative_to(REPOSITORY)
        if inside.parts[0] in {'package.xml', *SHARED}:
            assert f'{data}/binocular_recon/{inside}' in names

    done = subprocess.run(
        [sys.executable, '-m', 'binocular_recon', '--help'],
        cwd=tmp_path / 'site',
        capture_output=True,
        text=True,
        check=True,
    )
    assert 'reconstruct' in done.stdout
