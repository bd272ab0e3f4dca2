# SPDX-License-Identifier: Apache-2.0
"""Read and write files, bags and ROS messages.

Each module here is one file format: `calibration_yaml` and `calibration_json`, `image_files`,
`pfm`, `disparity_png`, `ply`; `disparity_files` reads any disparity map. All write through
`files`, so that a file is either complete or absent. `calibrations` reads those of other programs,
`bags` reads and writes recordings, `messages` converts ROS messages. None of them needs ROS. The
files of each frame are chosen in `apps.frame_formats`.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.io.calibration_yaml import read_camera, read_rig, write_camera, write_rig
    from binocular_recon.io.disparity_files import read_disparity_file
    from binocular_recon.io.disparity_png import read_disparity_png, write_disparity_png
    from binocular_recon.io.image_files import read_image_file, write_image_file
    from binocular_recon.io.pfm import read_pfm, write_pfm
    from binocular_recon.io.ply import write_ply

__all__ = [
    'read_camera',
    'read_disparity_file',
    'read_disparity_png',
    'read_image_file',
    'read_pfm',
    'read_rig',
    'write_camera',
    'write_disparity_png',
    'write_image_file',
    'write_pfm',
    'write_ply',
    'write_rig',
]

__getattr__ = lazy_exports(__name__, __file__)
