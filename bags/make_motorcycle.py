#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Make the bag and the ground truth in this folder from the Middlebury images.

Needs a folder with left.png, right.png, disparity.pfm and visible.png of the scene Motorcycle at
quarter size (741x497); README.md gives their source.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

import numpy as np

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.io.bags.writer import BagWriter, write_pair
from binocular_recon.io.disparity_png import write_disparity_png
from binocular_recon.io.image_files import read_image_file, write_image_file
from binocular_recon.io.pfm import read_pfm

HERE = Path(__file__).resolve().parent

# calib.txt of the quarter-size scene; its images are already rectified.
FOCAL_PX = 999.421
LEFT_CX_PX, RIGHT_CX_PX, CY_PX = 294.182, 326.96, 252.932
BASELINE_M = 0.193001
WIDTH, HEIGHT = 741, 497

# Middlebury gives no time; any value except zero will do.
STAMP_NS = 1_400_000_000_000_000_000


def rig() -> StereoRig:
    """Return the calibration of the images."""
    cameras = []
    for cx_px, baseline_m in ((LEFT_CX_PX, 0.0), (RIGHT_CX_PX, BASELINE_M)):
        K = np.array([[FOCAL_PX, 0, cx_px], [0, FOCAL_PX, CY_PX], [0, 0, 1]])
        P = np.column_stack([K, [-FOCAL_PX * baseline_m, 0, 0]])
        cameras.append(Camera(WIDTH, HEIGHT, K, np.zeros(5), np.eye(3), P))
    return StereoRig(*cameras)


def make(scene: Path, output: Path) -> None:
    """Write ``motorcycle`` and ``motorcycle_truth`` to ``output``, replacing old ones."""
    bag, truth = output / 'motorcycle', output / 'motorcycle_truth'
    shutil.rmtree(bag, ignore_errors=True)
    pair = read_image_file(scene / 'left.png'), read_image_file(scene / 'right.png')
    with BagWriter(bag) as writer:
        write_pair(writer, rig(), pair, STAMP_NS)
    truth.mkdir(exist_ok=True)
    write_disparity_png(truth / 'disparity.png', read_pfm(scene / 'disparity.pfm'))
    write_image_file(truth / 'visible.png', read_image_file(scene / 'visible.png'))


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('scene', type=Path, help='folder of the scene')
    parser.add_argument(
        '--output', type=Path, default=HERE, help='folder to write to (%(default)s)'
    )
    arguments = parser.parse_args()
    make(arguments.scene, arguments.output)
