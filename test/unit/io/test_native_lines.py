# SPDX-License-Identifier: Apache-2.0
"""What native libraries write to standard error."""

from __future__ import annotations

import contextlib
import os

import cv2
import numpy as np
import pytest

from binocular_recon.errors import ImageError
from binocular_recon.io.image_files import decoded_image
from binocular_recon.io.native_lines import native_lines_held


def test_damaged_images_do_not_flood_standard_error(capfd: pytest.CaptureFixture[str]) -> None:
    image = np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)
    jpeg = cv2.imencode('.jpg', image)[1].tobytes()
    for place in range(900, 1000):
        damaged = jpeg[:place] + b'\xff\xd0' + jpeg[place + 2 :]
        with contextlib.suppress(ImageError):
            decoded_image(damaged, 'image')
    assert len(capfd.readouterr().err.splitlines()) <= 3


def test_only_native_lines_are_held(capfd: pytest.CaptureFixture[str]) -> None:
    for number in range(5):
        with native_lines_held():
            os.write(2, b'libpng warning: test %d\n' % number)
            os.write(2, b'a line of the node\n')
    lines = capfd.readouterr().err.splitlines()
    assert lines.count('a line of the node') == 5
    assert lines.count('libpng warning: test 0') == 1 and len(lines) == 6


def test_after_an_error_standard_error_is_as_before(capfd: pytest.CaptureFixture[str]) -> None:
    def fail() -> None:
        with native_lines_held():
            raise ValueError('a fault')

    with pytest.raises(ValueError, match='a fault'):
        fail()
    os.write(2, b'here\n')
    assert capfd.readouterr().err == 'here\n'
