# SPDX-License-Identifier: Apache-2.0
"""What ``requirements/install.py`` does, with pip and venv replaced by a record of their calls."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

REQUIREMENTS = Path(__file__).resolve().parents[1] / 'requirements'
Update = Callable[..., list[str]]


@pytest.fixture
def script() -> ModuleType:
    """Return the script as a module."""
    spec = importlib.util.spec_from_file_location('install', REQUIREMENTS / 'install.py')
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def install(script: ModuleType, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return the script on a machine that ROS has wheels for and that no ROS is on."""
    monkeypatch.setattr(script, 'ros_wheels_fit', lambda: True)
    monkeypatch.setattr(script, 'system_ros', lambda: '')
    return script


@pytest.fixture
def update(install: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Update:
    """Return a function that updates an environment and returns what it ran, in short."""

    def update(*locks: str, fail: str = '', exact: bool = False) -> list[str]:
        ran: list[str] = []

        def run(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
            if 'venv' in command:
                (tmp_path / 'env' / 'bin').mkdir(parents=True)
                (tmp_path / 'env' / 'bin' / 'python').touch()
            ran.append('venv' if 'venv' in command else command[-1])
            if '--system-site-packages' in command:
                ran.append('with system packages')
            return subprocess.CompletedProcess(command, int(fail != '' and fail in command[-1]))

        monkeypatch.setattr(install.subprocess, 'run', run)
        install.update(tmp_path / 'env', list(locks), exact=exact)
        return ran

    return update


PROJECT = str(REQUIREMENTS.parent)


def test_first_call_makes_everything_and_second_nothing(update: Update) -> None:
    locks = ('runtime', 'ros-kilted', 'test')
    assert update(*locks) == ['venv', 'runtime.txt', PROJECT, 'ros-kilted.txt', 'test.txt']
    assert update(*locks) == []


def test_only_files_with_the_locked_hashes_are_installed(install: ModuleType) -> None:
    for name, arguments in install.steps(['runtime', 'ros-kilted', 'test'], ''):
        assert ('--require-hashes' in arguments) == (name != 'project')


def test_another_lock_is_added(update: Update) -> None:
    update('runtime')
    assert update('runtime', 'test') == ['test.txt']


def test_changed_lock_is_installed_again(
    update: Update, install: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    update('runtime', 'test')
    digest_of = install.digest_of
    monkeypatch.setattr(
        install, 'digest_of', lambda words: digest_of(words) + '2' * ('test.txt' in words)
    )
    assert update('runtime', 'test') == ['test.txt']


def test_a_new_node_is_installed(
    update: Update, install: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """`setup.py` makes an executable of each of their modules."""
    sources = tmp_path / 'sources'
    shutil.copytree(REQUIREMENTS, sources / 'requirements', ignore=lambda *_: ['__pycache__'])
    (sources / 'binocular_recon' / 'nodes').mkdir(parents=True)
    for name in ('setup.py', 'setup.cfg'):
        shutil.copy(REQUIREMENTS.parent / name, sources)
    monkeypatch.setattr(install, 'REPOSITORY', sources)
    update('runtime')
    assert update('runtime') == []
    (sources / 'binocular_recon' / 'nodes' / 'measure_node.py').touch()
    assert update('runtime') == [str(sources)]


def test_half_made_environment_is_made_again(update: Update) -> None:
    with pytest.raises(SystemExit, match='installing test failed'):
        update('runtime', 'test', fail='test.txt')
    assert update('runtime') == ['venv', 'runtime.txt', PROJECT]


def test_environment_of_another_python_is_kept_unless_one_is_asked_for(
    update: Update, install: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    update('runtime')
    monkeypatch.setattr(install, 'PYTHON', '3.99')
    assert update('runtime') == []
    assert update('runtime', exact=True)[0] == 'venv'


def test_installed_ros_is_used(
    update: Update, install: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(install, 'system_ros', lambda: 'jazzy')
    monkeypatch.setattr(install, 'system_numpy', lambda: ['numpy==1.26.4'])
    assert update('runtime', 'ros-kilted', 'test') == [
        'venv', 'with system packages', 'numpy==1.26.4', 'test.txt'
    ]  # fmt: skip


def test_without_ros_wheels_the_rest_is_installed(
    update: Update,
    install: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(install, 'ros_wheels_fit', lambda: False)
    assert update('runtime', 'ros-kilted', 'test') == ['venv', 'runtime.txt', PROJECT, 'test.txt']
    assert 'ROS 2 has no wheels for this machine' in capsys.readouterr().out


def test_unsupported_python_is_refused(
    update: Update, install: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(install, 'NEWEST', 9)
    with pytest.raises(SystemExit, match=r'takes one from 3\.10'):
        update('runtime')


@pytest.mark.parametrize(
    ('modules', 'distribution', 'expected'),
    [
        (set(), '', ''),
        ({'rclpy'}, 'jazzy', 'jazzy'),
        ({'rclpy', 'ros_wheels_bootstrapper'}, '', ''),
    ],
)
def test_ros_outside_of_wheels_is_found(
    script: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    modules: set[str],
    distribution: str,
    expected: str,
) -> None:
    monkeypatch.delenv('ROS_DISTRO', raising=False)
    if distribution:
        monkeypatch.setenv('ROS_DISTRO', distribution)
    monkeypatch.setattr(importlib.util, 'find_spec', lambda name: name in modules or None)
    assert script.system_ros() == expected


def test_sourced_ros_of_another_python_is_refused(
    script: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('ROS_DISTRO', 'jazzy')
    monkeypatch.setattr(importlib.util, 'find_spec', lambda _: None)
    with pytest.raises(SystemExit, match='cannot import its rclpy'):
        script.system_ros()
