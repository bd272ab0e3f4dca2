# SPDX-License-Identifier: Apache-2.0
"""Write the images of README and docs from the results of both demos.

``make_images.py DEMO SURVEY``, the folders of `demo` and of `demo --survey`. The image of the
report needs Chromium; without it the one that is there stays.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

from binocular_recon.images import ByteImage, to_bgr8
from binocular_recon.io.image_files import read_image_file

IMAGES = Path(__file__).with_name('images')
# Width of an image of the docs, and size of the browser's window, px.
WIDTH, WINDOW = 800, (1100, 1600)
BROWSERS = ('chromium', 'chromium-browser', 'google-chrome')


def read(path: Path) -> ByteImage:
    """Return an image, (H, W, 3) uint8."""
    return to_bgr8(read_image_file(path))


def write(name: str, image: ByteImage, width: int | None = None) -> None:
    """Write an image of the docs as JPEG, no wider than ``width``."""
    if width and image.shape[1] > width:
        size = width, round(image.shape[0] * width / image.shape[1])
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    quality = [cv2.IMWRITE_JPEG_QUALITY, 85 if width is None else 75]
    cv2.imwrite(str(IMAGES / f'{name}.jpg'), image, quality)


def pair(folder: Path, left: str, right: str) -> ByteImage:
    """Return two images side by side."""
    return np.hstack([read(folder / left), read(folder / right)])


def page(path: Path) -> ByteImage | None:
    """Return how a browser shows the top of a page, None without a browser."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder, 'page.png')
        options = [
            '--headless', '--no-sandbox', '--use-angle=swiftshader', '--hide-scrollbars',
            '--enable-unsafe-swiftshader', '--virtual-time-budget=8000',
            '--window-size={},{}'.format(*WINDOW), f'--screenshot={shot}',
        ]  # fmt: skip
        command = [browser, *options, path.resolve().as_uri()]
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        return read(shot)


def main(demo: Path, survey: Path) -> None:
    """Write all images."""
    for name in ('cloud', 'disparity'):
        write(f'demo_{name}', read(demo / f'000000_{name}.png'))
    cloud = survey / 'cloud'
    shutil.copy(survey / 'rods.svg', IMAGES / 'survey_rods.svg')
    write('survey_board', pair(survey / 'captures', 'left_01.png', 'right_01.png'), WIDTH)
    write('survey_pair', pair(cloud, '000000_left.png', '000000_right.png'), WIDTH)
    write('survey_cloud', read(cloud / '000000_cloud.png'), WIDTH)
    measured = read(cloud / 'measured_000000.png')
    height, width = measured.shape[:2]
    part = measured[round(0.38 * height) : round(0.76 * height), round(0.1 * width) :]
    write('survey_measured', part, WIDTH)
    shown = page(cloud / 'report.html')
    if shown is not None:
        write('survey_report', shown, WIDTH)


if __name__ == '__main__':
    main(*map(Path, sys.argv[1:3]))
