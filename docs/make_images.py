# SPDX-License-Identifier: Apache-2.0
"""Write the README's images from the results of `demo`: ``make_images.py FOLDER``."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2

from binocular_recon.io.image_files import read_image_file

IMAGES = Path(__file__).with_name('images')

if __name__ == '__main__':
    for name in ('cloud', 'disparity'):
        image = read_image_file(Path(sys.argv[1], f'000000_{name}.png'))
        path = IMAGES / f'demo_{name}.jpg'
        cv2.imwrite(str(path), image, [cv2.IMWRITE_JPEG_QUALITY, 85])
