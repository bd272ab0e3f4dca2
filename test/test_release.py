# SPDX-License-Identifier: Apache-2.0
"""Source distribution and wheel: what they hold, and that what is installed from them works."""

from __future__ import annotations

import email
import json
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from importlib import metadata
from pathlib import Path, PurePosixPath

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

import binocular_recon
from test.conftest import REPOSITORY
from test.project_files import ADDED, tracked

pytestmark = pytest.mark.skipif(
    Version(metadata.version('setuptools')) < Version('70.1'),
    reason='setuptools before 70.1 leaves the making of wheels to another package',
)
RELEASE = f'binocular_recon-{binocular_recon.__version__}'
PIP = ['-m', 'pip', '--disable-pip-version-check']


def checkout(folder: Path) -> Path:
    """Copy what is under version control; nothing that was built before is there."""
    for path in tracked():
        copy = folder / path.relative_to(REPOSITORY)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, copy)
    return folder


def build_wheel(source: Path, folder: Path) -> Path:
    command = [sys.executable, *PIP, 'wheel', '-qq', '--no-deps', '--no-build-isolation']
    subprocess.run([*command, '-w', folder, source], check=True)
    (wheel,) = folder.glob('*.whl')
    return wheel


@pytest.fixture(scope='module')
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = checkout(tmp_path_factory.mktemp('tree'))
    code = 'from setuptools import build_meta; build_meta.build_sdist("dist")'
    subprocess.run([sys.executable, '-c', code], cwd=source, check=True, capture_output=True)
    return source / 'dist' / f'{RELEASE}.tar.gz'


@pytest.fixture(scope='module')
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = checkout(tmp_path_factory.mktemp('tree'))
    return build_wheel(source, tmp_path_factory.mktemp('wheel'))


def contents(wheel: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_sdist_holds_what_is_under_version_control(sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        members = [PurePosixPath(member.name) for member in archive if member.isfile()]
    assert {path.parts[0] for path in members} == {RELEASE}
    inside = {path.relative_to(RELEASE) for path in members}
    expected = {PurePosixPath(path.relative_to(REPOSITORY)) for path in tracked()}
    assert {path for path in inside if path.parts[0] not in ADDED} == expected


def test_wheel_holds_the_package_and_what_it_shares(wheel: Path) -> None:
    names = set(contents(wheel))
    data = PurePosixPath(f'{RELEASE}.data', 'data', 'share')
    shared = {'package.xml', 'bags', 'config', 'launch', 'rviz'}
    expected = {str(data / 'ament_index/resource_index/packages/binocular_recon')}
    for path in tracked():
        inside = PurePosixPath(path.relative_to(REPOSITORY))
        if inside.parts[0] in shared:
            expected.add(str(data / 'binocular_recon' / inside))
        elif inside.parts[0] == 'binocular_recon':
            expected.add(str(inside))
    info = f'{RELEASE}.dist-info/'
    assert {name for name in names if not name.startswith(info)} == expected
    assert f'{info}licenses/LICENSE' in names


def test_sdist_makes_the_same_wheel(sdist: Path, wheel: Path, tmp_path: Path) -> None:
    assert contents(build_wheel(sdist, tmp_path)) == contents(wheel)


def test_metadata_describe_the_package(wheel: Path) -> None:
    fields = email.message_from_bytes(contents(wheel)[f'{RELEASE}.dist-info/METADATA'])
    assert fields['Description-Content-Type'] == 'text/markdown'
    assert fields.get_payload() == (REPOSITORY / 'README.md').read_text()
    assert fields['License'] == 'Apache-2.0'
    assert fields['License-File'] == 'LICENSE'
    assert fields['Requires-Python'] == '>=3.10'
    assert 'Typing :: Typed' in fields.get_all('Classifier', [])


@pytest.fixture(scope='module')
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a new environment with the wheel, which finds its dependencies in this one."""
    folder = tmp_path_factory.mktemp('environment')
    subprocess.run([sys.executable, '-m', 'venv', folder], check=True)
    python = folder / 'bin' / 'python'
    subprocess.run([python, *PIP, 'install', '-qq', '--no-index', '--no-deps', wheel], check=True)
    (package,) = folder.glob('lib/python*/site-packages/binocular_recon')
    required = map(Requirement, metadata.requires('binocular_recon') or [])
    names = [requirement.name for requirement in required if requirement.marker is None]
    folders = {str(metadata.distribution(name).locate_file('')) for name in names}
    assert str(REPOSITORY) not in folders
    # only the folders: what an editable installation hooks into the start of Python stays away
    package.with_name('dependencies.pth').write_text(''.join(f'{path}\n' for path in folders))
    return folder


def run(environment: Path, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run the console command as a user does who has nothing of this run's environment."""
    own = {'PYTHONPATH', 'NUMBA_CACHE_DIR'}
    return subprocess.run(
        [environment / 'bin' / 'binocular-recon', *arguments],
        cwd=cwd,
        env={name: value for name, value in os.environ.items() if name not in own},
        capture_output=True,
        text=True,
        check=False,
    )


def test_command_is_installed(environment: Path, tmp_path: Path) -> None:
    done = run(environment, '--version', cwd=tmp_path)
    assert binocular_recon.__version__ in done.stdout
    assert (done.returncode, done.stderr) == (0, '')


@pytest.mark.timeout(600)  # all kernels are compiled if those of this run are not yet
def test_demo_runs_from_the_wheel(environment: Path, tmp_path: Path) -> None:
    (package,) = environment.glob('lib/python*/site-packages/binocular_recon')
    subprocess.run([sys.executable, REPOSITORY / 'tools' / 'copy_kernels.py', package], check=True)
    own = package / 'stereo' / '__pycache__'
    shutil.rmtree(own, ignore_errors=True)  # a few that it compiles itself
    done = run(environment, 'demo', '--output', 'results', cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / 'results' / 'summary.json').read_text())
    (frame,) = summary['frames']
    assert frame['density'] == 1
    assert summary['versions']['binocular_recon'] == binocular_recon.__version__
    assert summary['accuracy']['bad-2.0 %'] < 12
    assert (tmp_path / 'results' / '000000.ply').stat().st_size > 1_000_000
    assert list(own.glob('*.nbc')), 'it was the installed package that ran'
