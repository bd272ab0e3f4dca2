# SPDX-License-Identifier: Apache-2.0
"""Read the frames of an output folder of `reconstruct`, with their calibration."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon.apps.summary_entries import SUMMARY, read_summary, rectified_rig, rig_of_entry
from binocular_recon.camera import StereoRig
from binocular_recon.cloud_config import CloudConfig
from binocular_recon.errors import (
    BinocularReconError,
    CalibrationError,
    ConfigError,
    FileError,
)
from binocular_recon.images import ByteImage, FloatImage, to_bgr8
from binocular_recon.io.image_files import read_image_file
from binocular_recon.io.pfm import read_pfm
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.stereo.rectification import check_size

_REMEDY = 'give the output folder of reconstruct; make it again if it is of an older version'


class MeasuredFolder:
    """The frames in an output folder of `reconstruct`.

    Parameters
    ----------
    folder : Path

    Attributes
    ----------
    folder : Path
    summary : dict
        Content of its ``summary.json``.

    Raises
    ------
    FileError
        If the folder holds no reconstruction.

    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.summary = read_summary(folder, _REMEDY)
        self._rigs: list[tuple[Any, StereoRig]] = []

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.summary['frames'])

    def frame(self, number: int) -> MeasuredFrame:
        """Read a frame.

        Raises
        ------
        FileError
            If there is no such frame, or a file of it is missing or damaged.
        CalibrationError
            If the summary does not hold the calibration.

        """
        if not 0 <= number < self.count:
            raise FileError(
                f'{self.folder} has no frame {number}: it holds the frames 0 to {self.count - 1}'
                if self.count
                else f'{self.folder} has no frames'
            )
        return MeasuredFrame(
            self.rig(number), self.disparity_px(number), self.sigma_px(number),
            self.validity(number), self.left_bgr(number), f'{number}', self.limits,
        )  # fmt: skip

    def disparity_px(self, number: int, rows: slice = slice(None)) -> FloatImage:
        """Return the disparities of a frame, or of some of its rows; NaN = none."""
        return self._map(number, 'disparity', rows)

    def sigma_px(self, number: int, rows: slice = slice(None)) -> FloatImage:
        """Return one standard deviation of each of them."""
        return self._map(number, 'sigma', rows)

    def validity(self, number: int) -> ByteImage:
        """Return the bits of `Validity` of a frame, (H, W) uint8."""
        validity = read_image_file(self._path(number, '_validity.png'))
        check_size(validity, self.rig(number).left.size, 'validity')
        return np.asarray(validity, np.uint8)

    def left_bgr(self, number: int) -> ByteImage:
        """Return the rectified left image of a frame, (H, W, 3) uint8."""
        return self._bgr(number, 'left')

    def has_right(self, number: int) -> bool:
        """Return whether the rectified right image of a frame was kept."""
        return self._path_of(number, '_right.png').exists()

    def right_bgr(self, number: int) -> ByteImage:
        """Return the rectified right image of a frame, (H, W, 3) uint8, if it `has_right`."""
        return self._bgr(number, 'right')

    def _bgr(self, number: int, side: str) -> ByteImage:
        image = read_image_file(self._path(number, f'_{side}.png'))
        check_size(image, self.rig(number).left.size, side)
        return to_bgr8(image)

    def _map(self, number: int, name: str, rows: slice) -> FloatImage:
        width, height = self.rig(number).left.size
        found = read_pfm(self._path(number, f'_{name}.pfm'), rows)
        first, last, _ = rows.indices(height)
        check_size(found, (width, last - first), name)
        return found

    def rig(self, number: int = 0) -> StereoRig:
        """Return the rectified rig of a frame, with the covariance of its calibration."""
        entry = self._calibration(number)
        for known, rig in self._rigs:
            if known == entry:
                return rig
        try:
            rig = rectified_rig(self.summary, entry)
        except BinocularReconError as error:
            raise CalibrationError(f'{self.folder / SUMMARY}: {error}; {_REMEDY}') from error
        self._rigs.append((entry, rig))
        return rig

    def raw_rig(self, number: int = 0) -> StereoRig:
        """Return the rig of a frame as it was calibrated, before rectification."""
        self.rig(number)  # names the file if it cannot be read
        return rig_of_entry(self._calibration(number))

    def _calibration(self, number: int) -> object:
        """Return what the summary says of a frame's calibration."""
        return self.summary['frames'][number].get('calibration', self.summary.get('calibration'))

    def _path(self, index: int, ending: str) -> Path:
        path = self._path_of(index, ending)
        if not path.exists():
            raise FileError(f'{path} is missing, which measuring needs; {_REMEDY}')
        return path

    def _path_of(self, index: int, ending: str) -> Path:
        return self.folder / f'{index:06d}{ending}'

    @cached_property
    def limits(self) -> CloudConfig:
        """Which points the cloud holds, by the options of the run."""
        given = (self.summary.get('options') or {}).get('cloud') or {}
        known = {field.name for field in dataclasses.fields(CloudConfig)}
        try:
            return CloudConfig(**{name: value for name, value in given.items() if name in known})
        except ConfigError as error:
            raise FileError(f'{self.folder / SUMMARY}: {error}; {_REMEDY}') from error
