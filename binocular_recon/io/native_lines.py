# SPDX-License-Identifier: Apache-2.0
"""What libjpeg, libpng, libtiff and OpenCV write to standard error, kept from flooding it."""

from __future__ import annotations

import contextlib
import os
import re
import threading
from collections.abc import Iterator

# How the lines of these libraries begin; those of other threads pass.
_NATIVE = re.compile(
    rb'libpng |Corrupt JPEG|Premature end of|Invalid SOS|Unsupported marker|Bogus|Application'
    rb' transferred|\[ *(WARN|ERROR|INFO|DEBUG)|OpenCV|TIFF|JPEG|GRFMT|imread|imdecode'
)
_NUMBER = re.compile(rb'0x[0-9a-f]+|\d+')
# Kinds of lines that are remembered.
_KINDS = 100
_STDERR = 2
# Of the lines of one block so much is read.
_MOST_BYTES = 1_000_000

_lock = threading.Lock()
_seen: set[bytes] = set()


@contextlib.contextmanager
def native_lines_held() -> Iterator[list[str] | None]:
    """Let each kind of native line appear once, however many damaged images are decoded.

    Lines that differ only in numbers are of one kind. Without a standard error, or where the
    system gives no more files, nothing is held.

    Yields
    ------
    lines : list of str or None
        At the end, the native lines that were written; None where nothing is held.

    """
    lines: list[str] = []
    with _lock, contextlib.ExitStack() as undo:
        try:
            stderr = os.dup(_STDERR)
            undo.callback(os.close, stderr)
            held = os.memfd_create('native lines')
            undo.callback(os.close, held)
        except OSError:
            yield None
            return
        os.dup2(held, _STDERR)
        try:
            yield lines
        finally:
            os.dup2(stderr, _STDERR)
            if os.fstat(held).st_size:
                os.lseek(held, 0, os.SEEK_SET)
                lines += _pass_on(os.read(held, _MOST_BYTES))


def _pass_on(text: bytes) -> list[str]:
    """Write the lines that are not native, and those of a new kind; return the native ones."""
    natives = []
    for line in text.splitlines(keepends=True):
        native, kind = _NATIVE.match(line), _NUMBER.sub(b'#', line.strip())
        if native:
            natives.append(line.decode(errors='replace').strip())
        if kind in _seen:
            continue
        if native:
            if len(_seen) >= _KINDS:
                _seen.clear()
            _seen.add(kind)
        with contextlib.suppress(OSError):
            os.write(_STDERR, line)
    return natives
