# SPDX-License-Identifier: Apache-2.0
"""A folder that `merge` made of several stations: what is in it, and how it is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from binocular_recon.apps.summary_entries import STATIONS, SUMMARY
from binocular_recon.errors import FileError
from binocular_recon.io.text_files import read_json

# Its clouds are called so.
CLOUD = 'cloud'
# Stations are named whose surfaces are off by more than this many sigmas (RMS).
MOST_OFF_SIGMAS = 1.5
_REMEDY = 'merge the stations again'


def is_of_stations(folder: Path) -> bool:
    """Return whether a folder holds the cloud of several stations, and no frames."""
    return (folder / STATIONS).exists() and not (folder / SUMMARY).exists()


def read_stations(folder: Path) -> dict[str, Any]:
    """Return the content of ``stations.json``; raises a FileError if it cannot be read."""
    path = folder / STATIONS
    content = read_json(path, _REMEDY)
    entries = content.get('stations') if isinstance(content, dict) else None
    if not isinstance(content, dict) or not isinstance(entries, list) or not entries:
        raise FileError(f'{path} does not list stations; {_REMEDY}')
    if 'tied' not in content:
        raise FileError(f'{path} is of an older version; {_REMEDY}')
    return content
