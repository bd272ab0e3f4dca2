# SPDX-License-Identifier: Apache-2.0
"""The progress bar."""

from __future__ import annotations

import io
import sys

import pytest

from binocular_recon.apps.progress import ProgressBar


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_is_drawn_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    for stream, seen in ((Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, 'stderr', stream)
        with ProgressBar(4, 'frames') as bar:
            bar.show(2)
            assert ('2 of 4 frames' in stream.getvalue()) is seen
            assert ('####' in stream.getvalue()) is seen
            bar.show(3)  # too soon to be drawn
            assert '3 of 4 frames' not in stream.getvalue()
        assert stream.getvalue().endswith('\r\033[K') is seen
