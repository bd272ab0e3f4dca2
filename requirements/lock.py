# SPDX-License-Identifier: Apache-2.0
"""Lock the environments: ``lock.py UV PYTHON...`` rewrites ``requirements/*.txt`` (``make lock``).

uv, an executable, resolves each environment for each CPython (``python3.10`` ...) from the ranges
in ``setup.py`` and the ``.in`` files; nothing is installed and no interpreter is needed.
Versions that differ between the interpreters get a marker. Each version carries the SHA-256 of
all its files, so that pip installs nothing else.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any, NamedTuple

FOLDER = Path(__file__).resolve().parent
# What ROS has wheels for. The hashes are those of all machines.
PLATFORM = 'x86_64-manylinux_2_28'
_EXTRAS = 'extras_require'

# Lock file: what it holds ('.' is what setup.py requires, '.[]' its extras for users), and the
# lock files whose versions it must agree with.
LOCKS: dict[str, tuple[list[str], list[str]]] = {
    'runtime': (['.', 'runtime.in'], []),
    'oldest': (['.', 'runtime.in', '-c', 'oldest.in'], []),
    'extras': (['.[]', 'extras.in'], ['runtime']),
    'oldest-extras': (['.[]', 'extras.in'], ['oldest']),
    'ros-kilted': (['ros-kilted.in'], ['runtime']),
    'ros-jazzy': (['ros-jazzy.in'], ['oldest']),
    'test': (['test.in'], ['runtime']),
    'dev': (['dev.in'], ['runtime', 'extras', 'test']),
    'docs': (['docs.in'], ['runtime', 'extras', 'test', 'dev']),
    'contrib': (['.', 'runtime.in', 'contrib.in'], ['runtime']),
    'lock': (['lock.in'], []),
    'colcon': (['colcon.in'], ['runtime', 'test']),
}


class Pin(NamedTuple):
    """A locked version, and the SHA-256 of each of its files."""

    version: str
    hashes: tuple[str, ...]


Pins = dict[str, Pin]


def ranges() -> dict[str, list[str]]:
    """Return what ``setup.py`` requires ('.'), and what its extras for users do ('.[]')."""
    tree = ast.parse((FOLDER.parent / 'setup.py').read_text(encoding='utf-8'))
    found: dict[str, Any] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Dict):
            for key, value in zip(node.keys, node.values, strict=True):
                if isinstance(key, ast.Constant) and key.value in ('install_requires', _EXTRAS):
                    found[key.value] = ast.literal_eval(value)
    extras = [one for name, each in found[_EXTRAS].items() for one in each if name != 'test']
    return {'.': found['install_requires'], '.[]': extras}


def resolve(uv: str, minor: str, requirements: list[str]) -> Pins:
    """Return every package that uv would install for ``requirements`` into CPython ``minor``."""
    command = [uv, 'pip', 'compile', '-q', '--generate-hashes', '--no-header', '--no-annotate']
    command += ['--python-version', minor, '--python-platform', PLATFORM]
    # empy (of the ROS wheels, pure Python) is the only one that offers no wheel
    command += ['--only-binary', ':all:', '--no-binary', 'empy']
    done = subprocess.run(
        [*command, *requirements], cwd=FOLDER, stdout=subprocess.PIPE, text=True, check=True
    )
    pins = {
        name: Pin(version, tuple(sorted(re.findall(r'--hash=sha256:([0-9a-f]{64})', rest))))
        for name, version, rest in re.findall(
            r'^([a-z0-9-]+)==(\S+)((?: \\\n    --hash=\S+)+)', done.stdout, re.MULTILINE
        )
    }
    if 'opencv-contrib-python-headless' in pins:
        pins.pop('opencv-python-headless', None)  # both own cv2/
    return pins


def lock(uv: str, minor: str) -> dict[str, Pins]:
    """Return the pins of each lock file under CPython ``minor``."""
    locked: dict[str, Pins] = {}
    required = ranges()
    for name, (requirements, others) in LOCKS.items():
        print(f'  {name}', flush=True)
        known = {package: pin for other in others for package, pin in locked[other].items()}
        with tempfile.TemporaryDirectory() as folder:
            constraints = Path(folder, 'known.txt')
            constraints.write_text(''.join(f'{p}=={pin.version}\n' for p, pin in known.items()))
            given: list[str] = []
            for word in requirements:
                if word in required:
                    project = Path(folder, f'{len(given)}.in')
                    project.write_text('\n'.join(required[word]))
                    given.append(str(project))
                else:
                    given.append(word)
            locked[name] = resolve(uv, minor, [*given, '-c', str(constraints)])
    return locked


def lines(per_python: dict[str, Pins]) -> list[str]:
    """Return requirement lines; a version that not all interpreters share carries a marker."""
    shared: dict[tuple[str, Pin], list[str]] = defaultdict(list)
    for minor, pins in per_python.items():
        for package, pin in pins.items():
            shared[package, pin].append(minor)
    text = []
    for (package, pin), minors in sorted(shared.items()):
        marker = (
            f' ; python_version in "{" ".join(minors)}"' if len(minors) < len(per_python) else ''
        )
        hashes = ''.join(f' \\\n    --hash=sha256:{digest}' for digest in pin.hashes)
        text.append(f'{package}=={pin.version}{marker}{hashes}')
    return text


def main(uv: str, minors: list[str]) -> None:
    """Write every lock file for the given interpreters."""
    locked: dict[str, dict[str, Pins]] = {}
    for minor in minors:
        print(f'CPython {minor}', flush=True)
        locked[minor] = lock(uv, minor)
    for name in LOCKS:
        head = f'# CPython {", ".join(locked)}; made by `make lock`, not by hand\n'
        body = lines({minor: pins[name] for minor, pins in locked.items()})
        Path(FOLDER, f'{name}.txt').write_text(head + ''.join(f'{line}\n' for line in body))


if __name__ == '__main__':
    main(str(Path(sys.argv[1]).absolute()), [name.removeprefix('python') for name in sys.argv[2:]])
