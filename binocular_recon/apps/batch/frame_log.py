# SPDX-License-Identifier: Apache-2.0
"""``frames.jsonl``: a line of JSON for each pair as soon as it is done."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from binocular_recon.apps.summary_entries import LARGEST
from binocular_recon.io.files import complete_file, naming_errors
from binocular_recon.io.text_files import open_file

NAME = 'frames.jsonl'


class FrameLog:
    """Append a line for each pair to the log of a folder.

    Parameters
    ----------
    folder : Path
    earlier : list of dict
        What an earlier run has of the pairs that it did; its lines are kept if they are there.
        The file of another run is replaced with the first line.

    """

    def __init__(self, folder: Path, earlier: list[dict[str, Any]]) -> None:
        self._path, self._earlier = folder / NAME, earlier
        self._begun = False

    def add(self, entry: dict[str, Any]) -> None:
        """Append a line; raises a FileError if that is not possible."""
        if not self._begun:
            self._begin()
        with naming_errors(self._path), self._path.open('ab') as file:
            file.write(_line(entry))

    def _begin(self) -> None:
        lines: list[bytes] = []
        count = len(self._earlier)
        if count:
            with naming_errors(self._path):
                if self._path.exists():
                    with open_file(self._path) as file:
                        lines = file.read(LARGEST).splitlines(keepends=True)[:count]
        if len(lines) < count:
            lines = [_line(entry) for entry in self._earlier]
        with complete_file(self._path) as file:
            file.writelines(lines)
        self._begun = True


def _line(entry: dict[str, Any]) -> bytes:
    return json.dumps(entry, allow_nan=False).encode() + b'\n'
