# SPDX-License-Identifier: Apache-2.0
"""Other programs as peers: a command that takes two images and writes a disparity file."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import signal
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np

from binocular_recon.errors import BinocularReconError, ConfigError, plain_text
from binocular_recon.evaluation.accuracy.methods import Method, MethodResult, PeerError
from binocular_recon.images import Image
from binocular_recon.io.disparity_files import read_disparity_file

TIMEOUT_S = 600.0
_NEEDED = ('{left}', '{right}', '{output}')
_OUTPUT = re.compile(r'\{output\}(\.\w+)?')
_INPUT = re.compile(r'\{(left|right|range)\}')
# Characters at the end of what a program says on stderr among which its last line is looked for.
_SAID = 4096


@dataclass(frozen=True)
class ExternalPeer:
    """A program that matches a pair of image files.

    Attributes
    ----------
    name : str
        Name in tables.
    command : str
        The program and its arguments, quoted as for a shell, which does not take part.
        ``{left}``, ``{right}`` are the images (PNG), ``{range}`` the number of disparities to
        search, from 0; ``{output}`` is the file to write, a PFM unless an ending follows it:
        ``{output}.png``, ``.tiff``, ``.npy`` (`read_disparity_file`). If none of the files is
        named, all three follow at the end.
    timeout_s : float
        A run that takes longer is stopped.

    Raises
    ------
    ConfigError
        If the name does not fit into a table, or the command cannot be split, is empty or names
        some of the files only.

    """

    name: str
    command: str
    timeout_s: float = TIMEOUT_S

    def __post_init__(self) -> None:
        """Check name and command."""
        if '|' in self.name or not self.name.isprintable():
            raise ConfigError(f'the name of a peer is a cell of a table, got {self.name!r}')
        _ = self._words

    @property
    def _words(self) -> list[str]:
        try:
            words = shlex.split(self.command)
        except ValueError as error:
            raise ConfigError(f'peer {self.name}: {self.command!r}: {error}') from None
        if not words or not self.name:
            raise ConfigError(
                f'a peer is NAME=COMMAND, such as "SPS=spsstereo {{left}} {{right}} {{output}}",'
                f' got {f"{self.name}={self.command}"!r}'
            )
        missing = [name for name in _NEEDED if not any(name in word for word in words)]
        if len(missing) == len(_NEEDED):
            return words + list(_NEEDED)
        if missing:
            raise ConfigError(
                f'peer {self.name}: the command lacks {" and ".join(missing)}; name all of'
                f' {", ".join(_NEEDED)} or none'
            )
        return words

    def method(self) -> Method:
        """Return the program as a method; its time is that of the process, with its files.

        What it writes below 0 px counts as no disparity. A run raises a `PeerError` if the
        program cannot be started, fails, takes too long, or leaves no map of the images' size.
        """
        return Method(self.name, self._prepare)

    def _prepare(
        self, left: Image, right: Image, disparity_range: int
    ) -> Callable[[], MethodResult]:
        words = self._words
        images = {side: _png(image) for side, image in (('left', left), ('right', right))}
        found = next(match for word in words if (match := _OUTPUT.search(word)))
        output_name = f'disparity{found[1] or ".pfm"}'

        def run() -> MethodResult:
            # a new folder for each run: an old result must not pass for this run's
            with tempfile.TemporaryDirectory(prefix='binocular_recon_peer_') as folder:
                output = Path(folder, output_name)
                values = {'range': str(disparity_range)}
                for side, data in images.items():
                    path = Path(folder, f'{side}.png')
                    path.write_bytes(data)
                    values[side] = str(path)
                self._execute([_filled_in(word, values, output) for word in words])
                return MethodResult(self._read(output, left.shape[:2]))

        return run

    def _execute(self, words: list[str]) -> None:
        with tempfile.TemporaryFile() as said:
            try:
                process = subprocess.Popen(
                    words,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=said,
                    start_new_session=True,
                )
            except (OSError, ValueError) as error:
                reason = getattr(error, 'strerror', None) or error
                raise PeerError(f'{words[0]} cannot be started: {reason}') from error
            try:
                status = process.wait(self.timeout_s)
            except subprocess.TimeoutExpired:
                raise PeerError(f'stopped after {self.timeout_s:g} s') from None
            finally:  # also at an interruption; what it started ends with it
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            if status:
                raise PeerError(f'{_ending(status)}: {_last_line(said)}')

    @staticmethod
    def _read(output: Path, size: tuple[int, ...]) -> Image:
        if not output.exists():
            raise PeerError(f'wrote no {output.name}')
        try:
            disparity_px = read_disparity_file(output)
        except BinocularReconError as error:
            raise PeerError(str(error).replace(str(output), output.name)) from error
        if disparity_px.shape != size:
            raise PeerError(
                f'{output.name} is {disparity_px.shape[1]}x{disparity_px.shape[0]} px, the images'
                f' are {size[1]}x{size[0]} px'
            )
        return np.where(disparity_px >= 0, disparity_px, np.float32(np.nan))


def external_peer(text: str, timeout_s: float = TIMEOUT_S) -> ExternalPeer:
    """Return the peer of ``NAME=COMMAND``; raises a ConfigError if it is none."""
    name, _, command = text.partition('=')
    return ExternalPeer(name.strip(), command.strip(), timeout_s)


def _png(image: Image) -> bytes:
    encoded: Image = cv2.imencode('.png', image)[1]
    return encoded.tobytes()


def _filled_in(word: str, values: dict[str, str], output: Path) -> str:
    """Return a word of the command with its placeholders replaced."""
    word = _OUTPUT.sub(lambda _: str(output), word)
    return _INPUT.sub(lambda found: values[found[1]], word)


def _ending(status: int) -> str:
    if status > 0:
        return f'failed with status {status}'
    with contextlib.suppress(ValueError):
        return f'was ended by {signal.Signals(-status).name}'
    return f'was ended by signal {-status}'


def _last_line(said: BinaryIO) -> str:
    said.seek(max(said.seek(0, os.SEEK_END) - _SAID, 0))
    lines = said.read().decode(errors='replace').strip().splitlines()
    return plain_text(lines[-1].strip())[:200] if lines else 'it said nothing'
