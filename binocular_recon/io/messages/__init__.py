# SPDX-License-Identifier: Apache-2.0
"""Convert ROS messages to arrays, cameras and rigs, and back, without ROS.

The functions only read and set attributes, so they serve messages of rclpy and of bags alike.
`images`, `camera_infos`, `disparities` and `clouds` hold one message type each.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.io.messages.camera_infos import (
        camera_from_message,
        fill_camera_info,
        rig_from_messages,
    )
    from binocular_recon.io.messages.clouds import fill_cloud
    from binocular_recon.io.messages.disparities import (
        DisparityMap,
        fill_disparity,
        read_disparity,
    )
    from binocular_recon.io.messages.images import DecodedImage, fill_image, read_image, stamp_ns

__all__ = [
    'DecodedImage',
    'DisparityMap',
    'camera_from_message',
    'fill_camera_info',
    'fill_cloud',
    'fill_disparity',
    'fill_image',
    'read_disparity',
    'read_image',
    'rig_from_messages',
    'stamp_ns',
]

__getattr__ = lazy_exports(__name__, __file__)
