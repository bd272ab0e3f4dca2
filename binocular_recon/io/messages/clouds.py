# SPDX-License-Identifier: Apache-2.0
"""Fill PointCloud2 messages."""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from binocular_recon.io.messages.images import assign_array
from binocular_recon.stereo.triangulation import Cloud

_UINT32, _FLOAT32 = 6, 7  # of sensor_msgs/PointField


class _Layout(NamedTuple):
    """Size of a point and positions of its fields, in units of 4 bytes."""

    size: int
    rgb: int | None
    sigma_z: int


_PADDED = 8
# By (colour, padding); x y z come first. Padded points have the layout of PCL and image_pipeline,
# with sigma_z in a position that these leave unused.
_LAYOUTS = {
    (True, True): _Layout(8, 4, 5),
    (True, False): _Layout(5, 3, 4),
    (False, True): _Layout(4, None, 3),
    (False, False): _Layout(4, None, 3),
}


def fill_cloud(
    message: Any,
    cloud: Cloud,
    header: Any,
    point_field: type[Any],
    *,
    colour: npt.NDArray[np.uint8] | None = None,
    validity: npt.NDArray[np.uint8] | None = None,
    padding: bool = True,
) -> None:
    """Fill an organised PointCloud2.

    Parameters
    ----------
    message : sensor_msgs/PointCloud2
        Message to fill.
    cloud : Cloud
        Points, metres; NaN = none.
    header : std_msgs/Header
        Header of the left image: the cloud is in its frame.
    point_field : type
        sensor_msgs/PointField.
    colour : (H, W, 3) uint8, optional
        BGR of each point; without it the cloud has no ``rgb`` field.
    validity : (H, W) uint8, optional
        Bits of `Validity`; without it the cloud has no ``validity`` field.
    padding : bool
        Align points to 16 bytes as PCL does; otherwise fields are packed.

    """
    height, width = cloud.sigma_z_m.shape
    layout = _LAYOUTS[colour is not None, padding]
    # the fourth value of a padded point is free; packed points grow by one
    free = 3 if layout.size == _PADDED else layout.size
    size = max(layout.size, free + 1) if validity is not None else layout.size
    points = np.zeros((height, width, size), np.float32)
    points[..., :3] = cloud.points_xyz
    points[..., layout.sigma_z] = cloud.sigma_z_m
    places = {'x': 0, 'y': 1, 'z': 2, 'sigma_z': layout.sigma_z}
    if colour is not None and layout.rgb is not None:
        places['rgb'] = layout.rgb
        blue, green, red = (colour[..., channel].astype(np.uint32) for channel in range(3))
        points.view(np.uint32)[..., layout.rgb] = red << 16 | green << 8 | blue
    if validity is not None:
        places['validity'] = free
        points.view(np.uint32)[..., free] = validity
    message.header = header
    message.height, message.width = height, width
    message.fields = [
        point_field(
            name=name,
            offset=4 * place,
            datatype=_UINT32 if name == 'validity' else _FLOAT32,
            count=1,
        )
        for name, place in sorted(places.items(), key=lambda item: item[1])
    ]
    message.is_bigendian = sys.byteorder == 'big'
    message.point_step = 4 * size
    message.row_step = message.point_step * width
    message.is_dense = bool(np.isfinite(cloud.depth_m).all())
    assign_array(message, 'data', points)
