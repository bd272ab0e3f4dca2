# SPDX-License-Identifier: Apache-2.0
"""The files of the project, for tests that read all of them."""

from __future__ import annotations

import subprocess
from pathlib import Path

from test.conftest import REPOSITORY

PYTHONS = ['3.10', '3.11', '3.12', '3.13']
# What setuptools adds to a source distribution, and what make and the tools add to a folder.
ADDED = {'PKG-INFO', 'binocular_recon.egg-info'}
MADE = {'build', 'dist', 'install', 'log', 'out', 'docs/_build', 'docs/api'}
CACHES = {'__pycache__', '.mypy_cache', '.pytest_cache', '.ruff_cache'}


def tracked() -> list[Path]:
    """Return the files under version control, or all that an unpacked release holds."""
    if (REPOSITORY / '.git').exists():
        command = ['git', 'ls-files', '-z', '--cached', '--others', '--exclude-standard']
        names = subprocess.run(command, cwd=REPOSITORY, capture_output=True, check=True).stdout
        paths = [REPOSITORY / name for name in names.decode().split('\0') if name]
    else:
        paths = [p for p in REPOSITORY.rglob('*') if not _is_made(p.relative_to(REPOSITORY))]
    return [path for path in paths if path.is_file()]


def _is_made(path: Path) -> bool:
    """Return whether a file was made by tools and is not part of the project."""
    beginnings = {path.parts[0], '/'.join(path.parts[:2])}
    made = not beginnings.isdisjoint(ADDED | MADE) or path.parts[0].startswith('.venv')
    return made or not CACHES.isdisjoint(path.parts)


def project_texts() -> dict[str, str]:
    """Return the content of every text file of the project by its path, with forward slashes."""
    seeds = REPOSITORY / 'test' / 'fuzz' / 'seeds'  # damaged on purpose
    contents = {path: path.read_bytes() for path in tracked() if seeds not in path.parents}
    return {
        path.relative_to(REPOSITORY).as_posix(): content.decode()
        for path, content in contents.items()
        if b'\0' not in content[:8000]
    }
