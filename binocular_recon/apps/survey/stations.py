# SPDX-License-Identifier: Apache-2.0
"""One cloud of several stations: tied together by control points, or by what they both see."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon.apps.frame_formats import FRAME_FORMATS, formats_named
from binocular_recon.apps.stored_frame import stored_frames
from binocular_recon.apps.summary_entries import STATIONS
from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.apps.survey.stations_folder import CLOUD, MOST_OFF_SIGMAS
from binocular_recon.camera import FloatArray
from binocular_recon.errors import ConfigError, MeasurementError
from binocular_recon.io.exports.placement import Placement, read_georeference
from binocular_recon.io.exports.point_table import SIGMAS, PointTable
from binocular_recon.io.files import ClaimedFolder, check_apart, complete_files, write_json
from binocular_recon.io.ply import CAMERA_FRAME
from binocular_recon.machine import machine_facts
from binocular_recon.measurement.site.tie import TIE_FILE
from binocular_recon.merging.overlap import Pose, find_pose, surface_distances
from binocular_recon.merging.voxels import VoxelCloud
from binocular_recon.number_text import counted
from binocular_recon.rotations import cross_matrix

# What is written, by the names of frame formats.
CLOUD_FORMATS = {name: spec for name, spec in FRAME_FORMATS.items() if spec.needs == ('table',)}
# Points of a station that its distance to the others is measured with, and points of each other.
_SAMPLE, _SURFACE = 4000, 200_000
# Surfaces within so many cubes of each other are the same one.
_REACH = 3.0


@dataclass(frozen=True, eq=False)
class Station:
    """A station, its cloud and where it lies.

    Attributes
    ----------
    folder : MeasuredFolder
        Of one frame.
    placement : Placement
        To the common frame.
    pairs : int, optional
        Features that it shares with an earlier station; None if control points place it.
    axes : tuple of str
        Names of the axes of the common frame.
    level : bool
        Whether its third axis is up.

    """

    folder: MeasuredFolder
    placement: Placement
    pairs: int | None = None
    axes: tuple[str, str, str] = ('x', 'y', 'z')
    level: bool = False

    @cached_property
    def table(self) -> PointTable:
        """Its points in the common frame."""
        return next(stored_frames(self.folder.folder, self.placement)).table

    def sample(self, most: int) -> tuple[FloatArray, FloatArray]:
        """Return about ``most`` points, (n, 3), and their sigma, (n,), m."""
        table = self.table
        step = max(1, -(-len(table) // most))
        chunks = [(c.xyz[::step], c.scalars) for c in table.chunks()]
        points = np.concatenate([xyz for xyz, _ in chunks] or [np.empty((0, 3))])
        sigmas = [
            np.sqrt(sum(scalars[name][::step].astype(np.float64) ** 2 for name in SIGMAS))
            for _, scalars in chunks
        ]
        return points, np.concatenate(sigmas or [np.empty(0)])


def merge_stations(
    folders: Sequence[MeasuredFolder],
    output: Path,
    voxel_size_m: float,
    *,
    formats: Collection[str] = (),
    report: Callable[[str], None] = lambda _: None,
) -> str:
    """Write one cloud of the frames of several stations, and how well they fit together.

    Parameters
    ----------
    folders : sequence of MeasuredFolder
        One per station, of one frame each. All have a ``georeference.json`` or none has.
    output : Path
        Folder for ``cloud.ply``, that of other formats, and ``stations.json``.
    voxel_size_m : float
        One point is kept per cube of this edge.
    formats : collection of str
        Keys of `CLOUD_FORMATS` to write besides PLY.
    report : callable
        Takes a line for the user.

    Returns
    -------
    text : str
        One sentence about the result.

    Raises
    ------
    ConfigError
        If a format is not one of clouds, or a station is given twice.
    MeasurementError
        If a station has no frame or several, or the stations cannot be tied together.
    FileError
        If a file cannot be read or written.

    """
    for name in formats:
        if name not in CLOUD_FORMATS:
            raise ConfigError(
                f'--format of several stations must be among {", ".join(CLOUD_FORMATS)}, got'
                f' {name!r}'
            )
    specs = formats_named(['ply', *formats])
    known: set[Path] = set()
    for folder in folders:
        _check(folder, output)
        if (place := folder.folder.resolve()) in known:
            raise ConfigError(f'{folder.folder} is given twice; give each station once')
        known.add(place)
    stations = _placed(folders)
    claim = ClaimedFolder(output)
    try:
        cloud = VoxelCloud(voxel_size_m)
        surfaces = [station.sample(_SURFACE)[0] for station in stations]
        entries = []
        for number, station in enumerate(stations):
            cubes = cloud.add(station.table.chunks())
            others = np.concatenate(surfaces[:number] + surfaces[number + 1 :])
            entries.append(_entry(station, others, voxel_size_m) | {'voxels': cubes})
            report(_line(entries[-1]))
        system = stations[0].placement.crs
        tied = stations[1].pairs is None
        where = 'frame of the site, metres' if tied else f'{CAMERA_FRAME}, of the first station'
        frame = f'{where}, {system}' if system else where
        table = PointTable(cloud.vertices(), stations[1].table.shares, (frame,), system=system)
        with complete_files(output) as parts:
            for spec in specs.values():
                spec.write(parts / f'{CLOUD}{spec.ending}', table)
            write_json(
                parts / STATIONS,
                {
                    'voxel_size_m': voxel_size_m,
                    'crs': system or None,
                    'axes': list(stations[0].axes),
                    'level': stations[0].level,
                    'tied': tied,
                    'stations': entries,
                    'versions': machine_facts()['versions'],
                },
            )
    finally:
        claim.release()
    points = counted(len(table), 'point')
    return f'{points} of {len(stations)} stations in {output}, {frame}'


def _check(folder: MeasuredFolder, output: Path) -> None:
    if folder.count != 1:
        raise MeasurementError(
            f'{folder.folder} holds {counted(folder.count, "frame")}, a station has one: average'
            f' the frames of a rig that stood still first (merge {folder.folder} --output DIR)'
        )
    check_apart(output, folder.folder)


def _placed(folders: Sequence[MeasuredFolder]) -> list[Station]:
    """Return the stations in a common frame."""
    ties = [folder.folder / TIE_FILE for folder in folders]
    missing = [tie.parent for tie in ties if not tie.exists()]
    if not missing:
        stations = []
        for folder, tie in zip(folders, ties, strict=True):
            found = read_georeference(tie)
            stations.append(Station(folder, found.placement, axes=found.names, level=found.level))
        systems = sorted({one.placement.crs or 'local' for one in stations})
        if len(systems) > 1:
            raise MeasurementError(
                f'the stations are in different reference systems: {", ".join(systems)};'
                ' georeference all with the same --epsg'
            )
        return stations
    if len(missing) < len(folders):
        raise MeasurementError(
            f'{missing[0]} has no {TIE_FILE}, {len(folders) - len(missing)} of the other stations'
            ' have one: georeference all stations, or none to join them by their overlap'
        )
    return _joined(folders)


def _joined(folders: Sequence[MeasuredFolder]) -> list[Station]:
    """Return the stations in the frame of the first, each joined to one that is placed already."""
    placed = [Station(folders[0], Placement(np.eye(3), np.zeros(3)))]
    waiting = list(folders[1:])
    frames = {id(folder): folder.frame(0) for folder in folders}
    while waiting:
        reasons = []
        for folder in waiting:
            station, reason = _attached(folder, placed, frames)
            if station:
                placed.append(station)
                waiting.remove(folder)
                break
            reasons.append(f'{folder.folder}: {reason}')
        else:
            raise MeasurementError(reasons[0])
    return [next(one for one in placed if one.folder is folder) for folder in folders]


def _attached(
    folder: MeasuredFolder, placed: Sequence[Station], frames: dict[int, Any]
) -> tuple[Station | None, str]:
    """Return the station joined to the first of those placed that it overlaps, or why to none."""
    reason = ''
    for other in placed:
        try:
            pose = find_pose(frames[id(folder)], frames[id(other.folder)])
        except MeasurementError as error:
            reason = reason or str(error)
            continue
        return Station(folder, _chained(pose, other.placement), pose.pairs), ''
    return None, reason


def _chained(pose: Pose, other: Placement) -> Placement:
    """Return the placement of a station whose pose in the frame of a placed one is known."""
    R = other.rotation @ pose.R
    turn = np.zeros((7, 7))
    turn[:3, :3] = turn[3:6, 3:6] = other.rotation
    covariance = np.zeros((7, 7))
    covariance[:6, :6] = pose.covariance
    covariance = turn @ covariance @ turn.T
    centre = other.points(pose.centre[None])[0]
    if other.covariance is not None and other.centre_m is not None:
        # the other station turns about its own centre, and takes this one with it
        arm = centre - other.centre_m
        move = np.eye(7)
        move[3:6, :3] = -cross_matrix(arm)
        covariance += move @ other.covariance @ move.T
    return Placement(R, other.points(pose.t[None])[0], 1.0, covariance, centre)


def _entry(station: Station, others: FloatArray, voxel_size_m: float) -> dict[str, Any]:
    """Return what ``stations.json`` says of a station, and of its distance to the others."""
    points, sigmas = station.sample(_SAMPLE)
    reach_m = _REACH * max(voxel_size_m, float(np.median(sigmas)) if len(sigmas) else 0.0)
    distances = surface_distances(points, others, reach_m)
    seen = np.isfinite(distances)
    entry: dict[str, Any] = {
        'folder': str(station.folder.folder.resolve()),
        'R': station.placement.rotation.tolist(),
        't': station.placement.translation_m.tolist(),
        'place_sigma_m': station.placement.own_sigma_m,
        'points': len(station.table),
        'shared_features': station.pairs,
        'overlap': float(seen.mean()) if len(seen) else 0.0,
    }
    if seen.any():
        away = np.abs(distances[seen])
        entry['distance_median_m'] = float(np.median(distances[seen]))
        entry['distance_rms_m'] = float(np.sqrt(np.mean(away**2)))
        entry['distance_over_sigma'] = float(np.sqrt(np.mean((away / sigmas[seen]) ** 2)))
    return entry


def _line(entry: dict[str, Any]) -> str:
    """Return what is said of a station."""
    if 'distance_rms_m' not in entry:
        return (
            f'warning: {entry["folder"]} shares no surface with the other stations; check its'
            ' georeference'
        )
    off_mm, rms_mm = (1000 * entry[f'distance_{name}_m'] for name in ('median', 'rms'))
    ratio = entry['distance_over_sigma']
    text = (
        f'{entry["folder"]}: {entry["overlap"]:.0%} of its points lie on surfaces of other'
        f' stations, {off_mm:+.1f} mm off on the median, RMS {rms_mm:.1f} mm or {ratio:.2f} sigma'
    )
    return f'warning: {text}; check its control points' if ratio > MOST_OFF_SIGMAS else text
