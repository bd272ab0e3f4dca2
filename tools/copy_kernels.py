# SPDX-License-Identifier: Apache-2.0
"""Copy what is compiled of this package into another one's folder: copy_kernels.py PACKAGE.

A copy of the package finds it there and need not compile it again; where its kernels differ, it
does. Tests of installed packages are quick that way, and so is the first start of an image of a
container.
"""

from __future__ import annotations

import importlib
import shutil
import sys
from pathlib import Path

import binocular_recon

SOURCE = Path(binocular_recon.__file__).parent


def copy_kernels(package: Path) -> None:
    """Copy the compiled kernels of every folder into the ``__pycache__`` of its counterpart."""
    for source in sorted(SOURCE.rglob('_*_kernels.py')):
        module = source.relative_to(SOURCE.parent).with_suffix('')
        members = vars(importlib.import_module('.'.join(module.parts)))
        caches = {
            member.stats.cache_path
            for member in members.values()
            if hasattr(member, 'stats') and member.__module__ == '.'.join(module.parts)
        }
        target = package / source.parent.relative_to(SOURCE) / '__pycache__'
        for compiled in (
            file for cache in caches for file in Path(cache).glob(f'{source.stem}.*')
        ):
            target.mkdir(exist_ok=True)
            shutil.copy(compiled, target)


if __name__ == '__main__':
    copy_kernels(Path(sys.argv[1]))
