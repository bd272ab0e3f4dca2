# SPDX-License-Identifier: Apache-2.0
"""Files that come with the project but not in the package: configurations and bags."""

from __future__ import annotations

from pathlib import Path

from binocular_recon.errors import FileError


def shared_file(name: str) -> Path:
    """Return the path of a file or folder, in the repository or as installed.

    Parameters
    ----------
    name : str
        Relative to the repository's root, such as ``bags/motorcycle``.

    Raises
    ------
    FileError
        If it is in neither.

    """
    for above in Path(__file__).resolve().parents:
        for path in (above / name, above / 'share' / 'binocular_recon' / name):
            if path.exists():
                return path
    raise FileError(
        f'{name} is not installed; run this in the repository, or where the package is installed'
        ' with its shared files'
    )
