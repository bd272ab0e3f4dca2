# SPDX-License-Identifier: Apache-2.0
"""Clouds as LAS 1.4 and LAZ: point format 7, sigmas and validity as extra bytes.

Source: LAS specification 1.4 R15 (ASPRS), sections 2.4 and 2.6.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon import __version__
from binocular_recon.camera import FloatArray
from binocular_recon.errors import FileError, shortened
from binocular_recon.io.exports.point_table import WHOLE, PointChunk, PointTable
from binocular_recon.io.exports.reference_system import reference_system
from binocular_recon.io.files import complete_file
from binocular_recon.machine import optional_package

# Steps of the coordinates, m: far below 1 mm, and 2^31 of them reach 200 km.
_STEP_M = 1e-4
_REACH = 2**31 - 1
# 16-bit colour from 8-bit: 255 becomes 65535.
_COLOUR_16 = 257
_SIGMA_TEXT = 'one standard deviation, m'
_TEXTS = {'validity': '1 measured, 2 filled', 'count': 'averaged images or stations'}
_FORMAT, _VERSION = 7, '1.4'


def write_las(path: Path, table: PointTable) -> None:
    """Write points; compressed if the suffix is ``.laz``.

    Parameters
    ----------
    path : Path
        File to write; its folder must exist.
    table : PointTable

    Raises
    ------
    DependencyError
        If laspy, or lazrs or pyproj where they are needed, is not installed.
    ConfigError
        If the coordinate reference system of the points is unknown.
    FileError
        If the file cannot be written.

    """
    laspy = optional_package('laspy', 'LAS and LAZ files')
    compressed = path.suffix.lower() == '.laz'
    if compressed:
        optional_package('lazrs', 'LAZ files')
    header = _header(laspy, table, *table.bounds())
    try:
        with (
            complete_file(path) as file,
            laspy.open(
                file, mode='w', header=header, do_compress=compressed, closefd=False
            ) as writer,
        ):
            for chunk in table.chunks():
                writer.write_points(_record(laspy, header, chunk))
    except laspy.errors.LaspyException as error:
        raise FileError(f'{path} cannot be written: {shortened(error)}') from error


def _record(laspy: Any, header: Any, chunk: PointChunk) -> Any:
    record = laspy.ScaleAwarePointRecord.zeros(len(chunk.xyz), header=header)
    record.x, record.y, record.z = chunk.xyz.T
    record.red, record.green, record.blue = chunk.rgb.T.astype(np.uint16) * _COLOUR_16
    record.return_number = record.number_of_returns = np.ones(len(chunk.xyz), np.uint8)
    for name, values in chunk.scalars.items():
        record[name] = values
    return record


def _header(laspy: Any, table: PointTable, low: FloatArray, high: FloatArray) -> Any:
    header = laspy.LasHeader(point_format=_FORMAT, version=_VERSION)
    header.offsets = np.floor(low)
    step = np.maximum(_STEP_M, 10.0 ** np.ceil(np.log10(np.maximum(high - low, 1) / _REACH)))
    header.scales = step
    header.generating_software = f'binocular_recon {__version__}'
    header.system_identifier = 'stereo rig'
    for name in table.scalar_names:
        kind = WHOLE.get(name, np.dtype(np.float32)).str[1:]
        text = _TEXTS.get(name, _SIGMA_TEXT)
        header.add_extra_dim(laspy.ExtraBytesParams(name, kind, description=text))
    text = f'{"; ".join(table.frame_lines)}; standard deviations hold the share of {table.shares}'
    header.vlrs.append(
        laspy.VLR('LASF_Spec', 3, 'text area description', text.encode()[:65535] + b'\0')
    )
    if table.crs:
        header.add_crs(reference_system(table.crs))
    return header
