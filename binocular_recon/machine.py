# SPDX-License-Identifier: Apache-2.0
"""The machine and the software that a result depends on, and packages that may be missing."""

from __future__ import annotations

import importlib
import platform
from datetime import datetime, timezone
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numba
import numpy as np
import scipy

from binocular_recon import __version__
from binocular_recon._jit import thread_count
from binocular_recon.errors import DependencyError, shortened

# The extra that installs each package.
EXTRAS = {
    'av': 'video',
    'distributed': 'cluster',
    'laspy': 'survey',
    'lazrs': 'survey',
    'onnxruntime': 'onnx',
    'pye57': 'e57',
    'small_gicp': 'merge',
    'pyproj': 'survey',
    'viser': 'view',
    'websockets': 'view',
}


def peak_bytes() -> int | None:
    """Return the peak memory of this process so far, or None where the system does not report it.

    Not from getrusage: after vfork, its ru_maxrss starts at the parent's peak.
    """
    try:
        status = Path('/proc/self/status').read_text(encoding='ascii')
    except OSError:
        return None
    peaks = (line.split()[1] for line in status.splitlines() if line.startswith('VmHWM:'))
    return next((1024 * int(peak) for peak in peaks), None)


def now_text() -> str:
    """Return the time now, UTC, to the second, as files state it (ISO 8601)."""
    return datetime.now(timezone.utc).isoformat(timespec='seconds')


def machine_facts() -> dict[str, Any]:
    """Return what a timing depends on: processor, cores and versions."""
    return {
        'processor': _processor(),
        'cores': thread_count(),
        'opencv_threads': cv2.getNumThreads(),
        'ximgproc': hasattr(cv2, 'ximgproc'),
        'versions': {
            'binocular_recon': __version__,
            'python': platform.python_version(),
            'numpy': np.__version__,
            'scipy': scipy.__version__,
            'numba': numba.__version__,
            'opencv': cv2.__version__,
        },
    }


def _processor() -> str:
    try:
        with Path('/proc/cpuinfo').open(encoding='utf-8') as file:
            for line in file:
                if line.startswith('model name'):
                    return line.partition(':')[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def optional_package(name: str, purpose: str) -> ModuleType:
    """Import a package of an extra.

    Parameters
    ----------
    name : str
        One of `EXTRAS`.
    purpose : str
        What it is needed for, such as ``LAZ files``, for the error.

    Raises
    ------
    DependencyError
        If it cannot be imported.

    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == name
        reason = 'is not installed' if missing else f'cannot be imported: {shortened(error)}'
        raise DependencyError(
            f'{purpose} need the package {name}, which {reason}; install it with'
            f" pip install 'binocular_recon[{EXTRAS[name]}]'"
        ) from error
