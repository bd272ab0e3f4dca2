# SPDX-License-Identifier: Apache-2.0
"""Fill and read PointCloud2 messages."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from binocular_recon.errors import ImageError
from binocular_recon.io.messages.images import new_array
from binocular_recon.stereo.triangulation import Cloud

_UINT32, _FLOAT32 = 6, 7  # of sensor_msgs/PointField


# Positions of the fields in units of 4 bytes. Padded points have the layout of PCL and
# image_pipeline, with ours in positions that these leave unused.
_PADDED = {'rgb': 4, 'sigma_z': 5, 'sigma_x': 6, 'sigma_y': 7, 'validity': 3}
_PADDED_SIZE = 8
# Packed points hold what there is, in this order.
_PACKED = ('rgb', 'sigma_z', 'sigma_x', 'sigma_y', 'validity')


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
    """Fill a PointCloud2, organised like the cloud.

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
    names = {'rgb': colour, **cloud.sigmas_m, 'validity': validity}
    places, size = _layout([name for name in _PACKED if names.get(name) is not None], padding)
    height, width = cloud.sigma_z_m.shape
    data = new_array(message, 'data', (height, width, 4 * size))
    points = data.view(np.float32)
    points[..., :3] = cloud.points_xyz
    for name, sigma in cloud.sigmas_m.items():
        points[..., places[name]] = sigma
    if colour is not None:
        place = 4 * places['rgb']  # the number 0x00RRGGBB
        little = sys.byteorder == 'little'
        data[..., place + (not little) : place + 4 - little] = colour[..., :: 1 if little else -1]
    if validity is not None:
        points.view(np.uint32)[..., places['validity']] = validity
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


def _layout(names: Sequence[str], padding: bool) -> tuple[dict[str, int], int]:
    """Return the position of x, y, z and of each further field, and the size of a point."""
    first = dict(zip('xyz', range(3), strict=True))
    if padding and 'rgb' in names:
        return {**first, **{name: _PADDED[name] for name in names}}, _PADDED_SIZE
    rest = {name: 3 + i for i, name in enumerate(names)}
    return {**first, **rest}, 3 + len(names)


def read_cloud(
    message: Any,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], bool]:
    """Read points and their depths' standard deviations from a PointCloud2 of ours.

    Returns
    -------
    points_xyz : (H, W, 3) float32
        Metres; NaN = none.
    sigma_z_m : (H, W) float32
    with_calibration : bool
        Whether the standard deviations hold the share of the calibration.

    Raises
    ------
    ImageError
        If a field is missing, or the sizes do not fit.

    """
    offsets = {
        field.name: int(field.offset) for field in message.fields if field.datatype == _FLOAT32
    }
    needed = ('x', 'y', 'z', 'sigma_z')
    missing = [name for name in needed if name not in offsets]
    if missing:
        raise ImageError(
            f'the cloud has no field {", ".join(missing)} (float32); take points2 of'
            ' wls_filter_node or stereo_node'
        )
    height, width, step = int(message.height), int(message.width), int(message.point_step)
    size, row = len(message.data), int(message.row_step)
    if (
        max(offsets[name] for name in needed) + 4 > step
        or row < step * width
        or size < row * height
    ):
        raise ImageError(
            f'the cloud states {width}x{height} points of {step} bytes, but has {size} bytes; its'
            ' publisher is faulty'
        )
    order = '>' if message.is_bigendian else '<'
    layout = np.dtype(
        {
            'names': list(needed),
            'formats': [f'{order}f4'] * len(needed),
            'offsets': [offsets[name] for name in needed],
            'itemsize': step,
        }
    )
    lines = np.frombuffer(message.data, np.uint8, row * height).reshape(height, row)
    values = np.ascontiguousarray(lines[:, : step * width]).view(layout).reshape(height, width)
    points = np.stack([values[name].astype(np.float32) for name in 'xyz'], axis=-1)
    return points, values['sigma_z'].astype(np.float32), 'sigma_x' in offsets
