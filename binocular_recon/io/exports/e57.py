# SPDX-License-Identifier: Apache-2.0
"""Clouds as E57 (ASTM E2807): one scan with colour, sigmas and validity.

Coordinates are in double precision. The standard has no field for standard deviations, so
``intensity``, which every reader shows, holds sigma_z, and all of them are in an extension.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon import __version__
from binocular_recon.errors import FileError
from binocular_recon.io.exports.point_table import CHUNK, WHOLE, PointChunk, PointTable
from binocular_recon.io.exports.reference_system import wkt_of
from binocular_recon.io.files import complete_files
from binocular_recon.machine import optional_package

_PREFIX, _URI = 'sd', 'urn:binocular_recon:e57:standard-deviations:1'
_DESCRIPTION = (
    'intensity is sigma_z, one standard deviation in metres; sd:sigma_x, sd:sigma_y, sd:sigma_z'
    ' likewise; sd:validity: 1 measured, 2 filled; sd:count: averaged images or stations'
)
_XYZ = ('cartesianX', 'cartesianY', 'cartesianZ')
_RGB = ('colorRed', 'colorGreen', 'colorBlue')


def write_e57(path: Path, table: PointTable) -> None:
    """Write points.

    Parameters
    ----------
    path : Path
        File to write; its folder must exist.
    table : PointTable

    Raises
    ------
    DependencyError
        If pye57, or pyproj where it is needed, is not installed.
    ConfigError
        If the coordinate reference system of the points is unknown.
    FileError
        If the file cannot be written.

    """
    lib = optional_package('pye57', 'E57 files').libe57
    with complete_files(path.parent) as parts:
        part = parts / path.name
        try:
            str(part).encode()
        except UnicodeEncodeError:
            raise FileError(
                f'{path} cannot be written: E57 needs a path in UTF-8; choose another folder'
            ) from None
        try:
            with closing(lib.ImageFile(str(part), 'w')) as file:
                _Scan(lib, file, table).write()
        except lib.E57Exception as error:
            reason = str(error).partition('****')[0].strip()  # then where in the library
            raise FileError(
                f'{path} cannot be written: {reason}; free some space or write to another disk'
            ) from error


class _Scan:
    """One scan of a file that is being written."""

    def __init__(self, lib: Any, file: Any, table: PointTable) -> None:
        self._lib, self._file, self._table = lib, file, table
        self._low, self._high = table.bounds()

    def write(self) -> None:
        lib, file, table = self._lib, self._file, self._table
        file.extensionsAdd('', lib.E57_V1_0_URI)
        file.extensionsAdd(_PREFIX, _URI)
        root = file.root()
        for name, value in {
            'formatName': 'ASTM E57 3D Imaging Data File',
            'guid': self._guid('file'),
            'versionMajor': lib.E57_FORMAT_MAJOR,
            'versionMinor': lib.E57_FORMAT_MINOR,
            'e57LibraryVersion': f'binocular_recon {__version__}',
            'coordinateMetadata': wkt_of(table.crs),
        }.items():
            root.set(name, self._node(value))
        scans = lib.VectorNode(file, True)
        root.set('data3D', scans)
        root.set('images2D', lib.VectorNode(file, True))
        scan = self._structure(
            {'guid': self._guid('scan'), 'name': 'cloud', 'description': self._description()}
        )
        scan.set('cartesianBounds', self._structure(self._bounds()))
        scan.set(
            'colorLimits',
            self._structure({f'{name}{end}': value for name in _RGB for end, value in _LIMITS}),
        )
        points = lib.CompressedVectorNode(file, self._prototype(), lib.VectorNode(file, True))
        scan.set('points', points)
        scans.append(scan)
        self._write_points(points)

    def _description(self) -> str:
        table = self._table
        shares = f'standard deviations hold the share of {table.shares}'
        return '; '.join([*table.frame_lines, _DESCRIPTION, shares])

    def _guid(self, what: str) -> str:
        """Return a GUID that is the same for the same points."""
        digest = hashlib.sha256(what.encode())
        for chunk in self._table.chunks():
            digest.update(chunk.xyz.tobytes())
            break
        digest.update(np.r_[self._low, self._high, len(self._table)].tobytes())
        return f'{{{uuid.UUID(bytes=digest.digest()[:16], version=4)}}}'

    def _bounds(self) -> dict[str, float]:
        return {
            f'{axis}{end}': float(values[i])
            for end, values in (('Minimum', self._low), ('Maximum', self._high))
            for i, axis in enumerate('xyz')
        }

    def _node(self, value: str | float) -> Any:
        if isinstance(value, str):
            return self._lib.StringNode(self._file, value)
        if isinstance(value, int):
            return self._lib.IntegerNode(self._file, value)
        return self._lib.FloatNode(self._file, value)

    def _structure(self, values: dict[str, Any]) -> Any:
        node = self._lib.StructureNode(self._file)
        for name, value in values.items():
            node.set(name, self._node(value))
        return node

    def _prototype(self) -> Any:
        lib, file = self._lib, self._file
        prototype = lib.StructureNode(file)
        limit = lib.E57_DOUBLE_MAX
        for name in _XYZ:
            prototype.set(name, lib.FloatNode(file, 0.0, lib.E57_DOUBLE, -limit, limit))
        for name in _RGB:
            prototype.set(name, lib.IntegerNode(file, 0, 0, 255))
        single = ['intensity', *(_field(name) for name in self._sigmas)]
        for name in single:
            prototype.set(
                name,
                lib.FloatNode(file, 0.0, lib.E57_SINGLE, -lib.E57_FLOAT_MAX, lib.E57_FLOAT_MAX),
            )
        for name, kind in WHOLE.items():
            if name in self._table.scalar_names:
                most = 256**kind.itemsize - 1
                prototype.set(_field(name), lib.IntegerNode(file, 0, 0, most))
        return prototype

    @property
    def _sigmas(self) -> list[str]:
        return [name for name in self._table.scalar_names if name.startswith('sigma')]

    def _fields(self, chunk: PointChunk) -> dict[str, Any]:
        return {
            **dict(zip(_XYZ, chunk.xyz.T, strict=True)),
            **dict(zip(_RGB, chunk.rgb.T, strict=True)),
            'intensity': chunk.scalars['sigma_z'],
            **{_field(name): values for name, values in chunk.scalars.items()},
        }

    def _write_points(self, points: Any) -> None:
        if not len(self._table):
            return
        with self._writer(points) as (writer, buffers):
            for chunk in self._table.chunks():
                for name, values in self._fields(chunk).items():
                    buffers[name][: len(values)] = values
                writer.write(len(chunk.xyz))

    @contextmanager
    def _writer(self, points: Any) -> Iterator[tuple[Any, dict[str, Any]]]:
        """Open the writer of points with a buffer for each field."""
        lib = self._lib
        first = self._fields(next(self._table.chunks(1)))
        size = min(CHUNK, len(self._table))
        buffers = {name: np.empty(size, values.dtype) for name, values in first.items()}
        places = lib.VectorSourceDestBuffer()
        for name, buffer in buffers.items():
            places.append(lib.SourceDestBuffer(self._file, name, buffer, size, True, True))
        with closing(points.writer(places)) as writer:
            yield writer, buffers


_LIMITS = (('Minimum', 0), ('Maximum', 255))


def _field(name: str) -> str:
    return f'{_PREFIX}:{name}'
