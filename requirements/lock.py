# SPDX-License-Identifier: Apache-2.0
"""Lock the environments: ``lock.py PYTHON...`` rewrites ``requirements/*.txt`` (``make lock``).

Each interpreter's own pip resolves each environment from the ranges in ``setup.py`` and the
``.in`` files; nothing is installed. Versions that differ between the interpreters get a marker.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
PROJECT = 'binocular-recon'

# Lock file: what it holds, and the lock files whose versions it must agree with.
LOCKS: dict[str, tuple[list[str], list[str]]] = {
    'runtime': (['.', 'setuptools'], []),
    'oldest': (['.', 'setuptools', '-c', 'oldest.in'], []),
    'ros-kilted': (['-r', 'ros-kilted.in'], ['runtime']),
    'ros-jazzy': (['-r', 'ros-jazzy.in'], ['oldest']),
    'test': (['-r', 'test.in'], ['runtime']),
    'dev': (['-r', 'dev.in'], ['runtime', 'test']),
    'docs': (['-r', 'docs.in'], ['runtime', 'test', 'dev']),
    'contrib': (['.', 'setuptools', 'opencv-contrib-python-headless'], ['runtime']),
    'colcon': (['-r', 'colcon.in'], ['runtime', 'test']),
}

Versions = dict[str, str]


def resolve(python: str, requirements: list[str]) -> Versions:
    """Return the version of every package that pip would install for ``requirements``."""
    command = [python, '-m', 'pip', 'install', '-qq', '--dry-run', '--ignore-installed']
    # empy (of the ROS wheels, pure Python) is the only one that offers no wheel
    command += ['--only-binary', ':all:', '--no-binary', 'empy', '--report', '-']
    command += [str(FOLDER.parent) if word == '.' else word for word in requirements]
    done = subprocess.run(command, cwd=FOLDER, stdout=subprocess.PIPE, check=True)
    report = json.loads(done.stdout[done.stdout.index(b'{') :])
    packages = (item['metadata'] for item in report['install'])
    versions = {re.sub(r'[-_.]+', '-', p['name']).lower(): p['version'] for p in packages}
    versions.pop(PROJECT, None)
    if 'opencv-contrib-python-headless' in versions:
        versions.pop('opencv-python-headless', None)  # both own cv2/
    return versions


def lock(python: str) -> dict[str, Versions]:
    """Return the versions of each lock file under ``python``."""
    locked: dict[str, Versions] = {}
    for name, (requirements, others) in LOCKS.items():
        print(f'  {name}', flush=True)
        known = {p: v for other in others for p, v in locked[other].items()}
        with tempfile.TemporaryDirectory() as folder:
            constraints = Path(folder, 'known.txt')
            constraints.write_text(''.join(f'{p}=={v}\n' for p, v in known.items()))
            locked[name] = resolve(python, [*requirements, '-c', str(constraints)])
    return locked


def lines(per_python: dict[str, Versions]) -> list[str]:
    """Return requirement lines; a version that not all interpreters share carries a marker."""
    pins: dict[tuple[str, str], list[str]] = defaultdict(list)
    for minor, versions in per_python.items():
        for package, version in versions.items():
            pins[package, version].append(minor)
    text = []
    for (package, version), minors in sorted(pins.items()):
        marker = (
            f' ; python_version in "{" ".join(minors)}"' if len(minors) < len(per_python) else ''
        )
        text.append(f'{package}=={version}{marker}')
    return text


def main(pythons: list[str]) -> None:
    """Write every lock file from the given interpreters."""
    os.environ['PIP_DISABLE_PIP_VERSION_CHECK'] = '1'
    locked: dict[str, dict[str, Versions]] = {}
    for python in pythons:
        query = 'import sys; print("%d.%d" % sys.version_info[:2])'
        minor = subprocess.run(
            [python, '-c', query], capture_output=True, text=True, check=True
        ).stdout.strip()
        print(f'CPython {minor}', flush=True)
        locked[minor] = lock(python)
    for name in LOCKS:
        head = f'# CPython {", ".join(locked)}; made by `make lock`, not by hand\n'
        body = lines({minor: versions[name] for minor, versions in locked.items()})
        Path(FOLDER, f'{name}.txt').write_text(head + ''.join(f'{line}\n' for line in body))


if __name__ == '__main__':
    main(sys.argv[1:])
