# SPDX-License-Identifier: Apache-2.0
"""Bring an environment up to date: ``install.py [--exact] ENVIRONMENT LOCK...`` (see Makefile).

``LOCK`` names lock files of this folder; pip installs only files with the hashes in them. The
environment records what is in it, so that a second call does nothing. The record is away while
something is being installed: an environment that was left half made has none and is made again.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import importlib.metadata
import importlib.util
import json
import os
import platform
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
REPOSITORY = FOLDER.parent
OLDEST, NEWEST = 10, 13  # CPython 3.x
PYTHON = '{}.{}'.format(*sys.version_info)


def main() -> None:
    """Update one environment; two calls at the same time wait for each other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        '--exact', action='store_true', help='make an environment of another Python again'
    )
    parser.add_argument('environment')
    parser.add_argument('locks', nargs='+')
    args = parser.parse_args()
    with Path(REPOSITORY, f'{args.environment}.lock').open('w') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        update(REPOSITORY / args.environment, args.locks, exact=args.exact)


def update(folder: Path, locks: list[str], *, exact: bool) -> None:
    """Install into ``folder`` what is missing of ``locks``; create it first if it must be."""
    record = folder / 'installed.json'
    installed: dict[str, str] = {}
    with suppress(FileNotFoundError):
        installed = json.loads(record.read_text())
    made = {'folder': str(folder), 'ros': system_ros(), 'python': PYTHON}
    fixed = made if exact else {'folder': made['folder'], 'ros': made['ros']}
    if not (fixed.items() <= installed.items() and (folder / 'bin' / 'python').exists()):
        create(folder, made['ros'])
        installed = made
    for name, arguments in steps(locks, made['ros']):
        digest = digest_of(arguments)
        if installed.get(name) == digest:
            continue
        say(folder, name)
        record.unlink(missing_ok=True)
        pip = [str(folder / 'bin' / 'python'), '-m', 'pip', '--disable-pip-version-check']
        # What is imported is compiled then; compiling all of it takes half of the installation.
        command = [*pip, 'install', '-qq', '--no-compile', *arguments]
        done = subprocess.run(command, cwd=FOLDER, check=False)
        if done.returncode:
            sys.exit(f'{folder.name}: installing {name} failed; the lines above say why')
        installed[name] = digest
        record.with_suffix('.part').write_text(json.dumps(installed, indent=1))
        record.with_suffix('.part').replace(record)


def system_ros() -> str:
    """Return the distribution of the ROS that this Python finds outside of wheels, or ''."""
    if importlib.util.find_spec('rclpy') and not importlib.util.find_spec(
        'ros_wheels_bootstrapper'
    ):
        return os.environ.get('ROS_DISTRO', 'unknown')
    if 'ROS_DISTRO' in os.environ:
        sys.exit(
            f'ROS {os.environ["ROS_DISTRO"]} is sourced, but {sys.executable} (CPython {PYTHON})'
            ' cannot import its rclpy; name the Python it is made for'
            ' (make setup PYTHON=/usr/bin/python3), or unset ROS_DISTRO and PYTHONPATH to have'
            ' ROS installed from wheels'
        )
    return ''


def create(folder: Path, ros: str) -> None:
    """Make an empty environment, in place of what is there."""
    if not (3, OLDEST) <= sys.version_info[:2] <= (3, NEWEST):
        sys.exit(
            f'{sys.executable} is CPython {PYTHON}; it takes one from 3.{OLDEST} to 3.{NEWEST},'
            f' for instance: make setup PYTHON=python3.{NEWEST - 1}'
        )
    say(folder, f'CPython {PYTHON}' + (f' with ROS 2 {ros} of this machine' if ros else ''))
    shutil.rmtree(folder, ignore_errors=True)
    site = ['--system-site-packages'] if ros else []
    venv = [sys.executable, '-m', 'venv', *site, str(folder)]
    if subprocess.run(venv, check=False).returncode:
        sys.exit(f'{sys.executable} has no venv with pip; on Ubuntu: apt install python3-venv')


def steps(locks: list[str], ros: str) -> list[tuple[str, list[str]]]:
    """Return name and pip's arguments of each step that leads to an environment with ``locks``."""
    project = ['--no-deps', '--no-build-isolation', '--editable', str(REPOSITORY)]
    result: list[tuple[str, list[str]]] = []
    for lock in locks:
        arguments = ['--no-deps', '--no-build-isolation', '--require-hashes']
        arguments += ['--requirement', f'{lock}.txt']
        if lock == 'runtime' and ros:
            # The messages of an installed ROS are compiled for the numpy beside them.
            result.append(('project', ['--editable', str(REPOSITORY), *system_numpy()]))
        elif lock in ('runtime', 'oldest', 'contrib'):
            result += [(lock, arguments), ('project', project)]
        elif not lock.startswith('ros-') or (ros_wheels_fit() and not ros):
            result.append((lock, arguments))
        elif not ros:
            print(f'ROS 2 has no wheels for this machine ({sys.platform}, {platform.machine()})')
    return result


def system_numpy() -> list[str]:
    """Return the requirement that keeps the numpy that this Python has."""
    with suppress(importlib.metadata.PackageNotFoundError):
        return [f'numpy=={importlib.metadata.version("numpy")}']
    return []


def ros_wheels_fit() -> bool:
    """Return whether the machine is of the one kind that ROS has wheels for."""
    return platform.machine() == 'x86_64' and platform.libc_ver()[0] == 'glibc'


def digest_of(arguments: list[str]) -> str:
    """Return a digest of what a step would install: its arguments and the files they name.

    For the project they are `setup.py` and the modules that it makes executables of.
    """
    files = [f'requirements/{word}' for word in arguments if word.endswith('.txt')]
    nodes: list[str] = []
    if '--editable' in arguments:
        files += ['setup.py', 'setup.cfg']
        nodes = sorted(path.name for path in REPOSITORY.glob('binocular_recon/nodes/*_node.py'))
    text = ' '.join([*arguments, *nodes])
    text += ''.join(Path(REPOSITORY, name).read_text() for name in files)
    return hashlib.sha256(text.encode()).hexdigest()


def say(folder: Path, what: str) -> None:
    """Tell a person who waits what is being done."""
    print(f'{folder.name}: {what}', flush=True)


if __name__ == '__main__':
    main()
