# SPDX-License-Identifier: Apache-2.0
"""One frame of all frames in an output folder of a rig that stood still."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from binocular_recon.apps.batch.frame_task import FrameOutcome
from binocular_recon.apps.frame_formats import FRAME_FORMATS, FrameResult
from binocular_recon.apps.output_folder import ResultFolder
from binocular_recon.apps.progress import ProgressBar
from binocular_recon.apps.summary_entries import RIG_ENTRY, frame_entry
from binocular_recon.apps.survey.measured_folder import MeasuredFolder
from binocular_recon.camera import FloatArray
from binocular_recon.errors import ConfigError, MeasurementError
from binocular_recon.images import ByteImage, FloatImage
from binocular_recon.io.files import check_apart, part_folder
from binocular_recon.merging.over_time import TimeAverage, average, sigma_of
from binocular_recon.merging.standing_still import MOST_SHIFT_PX, Corners, moved_px
from binocular_recon.number_text import counted
from binocular_recon.stereo.diagnosis import NOTHING
from binocular_recon.stereo.filtering.wls_filter import Filtered
from binocular_recon.stereo.search_range import SearchRange
from binocular_recon.stereo.thinning import PointSet, thin
from binocular_recon.stereo.triangulation import triangulate
from binocular_recon.stereo.validity import Validity

# Of all frames, so many rows are held in memory at once, bytes.
_BAND_BYTES = 1 << 28
# With a larger share of measured pixels whose values do not agree, the rig or the scene moved.
MOST_DISPUTED = 0.5


def merge_over_time(
    folder: MeasuredFolder,
    output: Path,
    *,
    formats: Collection[str] = (),
    report: Callable[[str], None] = lambda _: None,
) -> str:
    """Average the frames of a rig that stood still; the result is an output folder of one frame.

    Parameters
    ----------
    folder : MeasuredFolder
        Frames of one calibration.
    output : Path
        Folder for the result.
    formats : collection of str
        Keys of `FRAME_FORMATS` to write besides those that are always written.
    report : callable
        Takes a line for the user.

    Returns
    -------
    text : str
        One sentence about the result.

    Raises
    ------
    ConfigError
        If a format cannot be made of several frames.
    MeasurementError
        If there is one frame only, calibrations differ, or the rig or most of the scene moved.
    FileError
        If a file cannot be read or written.

    """
    begun_s = time.monotonic()
    _check(folder, output)
    if 'right' in formats:
        raise ConfigError('--format right is not made of several frames; omit it')
    made_from = {
        name: folder.summary.get(name) for name in ('source', 'preset', 'options', 'versions')
    }
    results = ResultFolder(output, made_from, formats=formats)
    try:
        with ProgressBar(3 * folder.count, 'steps') as progress:
            stack = _Stack(folder, progress)
            for number, moved in stack.left_out:
                report(
                    f'frame {number} is left out: its image is shifted by {moved:.1f} px against'
                    ' the others; the camera was moved'
                )
            filtered, count = stack.filtered()
            left_bgr = stack.colours(filtered.disparity_px, filtered.sigma_px)
        rig, limits = folder.rig(), folder.limits
        cloud = triangulate(
            filtered.disparity_px, filtered.sigma_px, filtered.validity, rig, limits
        )
        points = thin(PointSet(cloud, filtered.validity, left_bgr, count), limits)
        frame = FrameResult(folder.raw_rig(), rig, filtered, cloud, points, left_bgr)
        first = folder.summary['frames'][stack.used[0]]
        searched = [one['disparity_px'] for one in folder.summary['frames']]
        least = min(one['min'] for one in searched)
        width = max(one['max'] for one in searched) + 1 - least
        entry = frame_entry(frame, SearchRange(least, width), time.monotonic() - begun_s)
        entry['frames'] = len(stack.used)
        rig_entry = {name: folder.summary.get(name) for name in RIG_ENTRY}
        with part_folder(output) as parts:
            for name in results.formats:
                FRAME_FORMATS[name].write_frame(parts, 0, frame)
            outcome = FrameOutcome(entry=entry, rig_entry=rig_entry)
            results.add(parts, outcome, NOTHING, frame.rig, first.get('stamp_ns'))
        facts: dict[str, Any] = {
            'frames': len(stack.used),
            'left_out': [number for number, _ in stack.left_out],
            'disputed': stack.disputed,
        }
        results.write_summary(finished=True, merged=facts, unpaired=0, damage=[])
    finally:
        results.close()
    return (
        f'{len(stack.used)} frames are one in {output}: {results.matched:.1%} of the pixels'
        f' measured, {stack.disputed:.1%} left out because something moved there;'
        f' median sigma of the disparity {_median(filtered):.3f} px, of one frame'
        f' {stack.single_px:.3f} px'
    )


def _check(folder: MeasuredFolder, output: Path) -> None:
    """Raise an error if the frames cannot be averaged, or not there."""
    if folder.count < 2:
        raise MeasurementError(
            f'{folder.folder} holds {counted(folder.count, "frame")}; at least 2 of a rig that'
            ' stands still are needed: reconstruct more pairs'
        )
    check_apart(output, folder.folder)
    for number in range(folder.count):
        if folder.rig(number) is not folder.rig(0):
            raise MeasurementError(
                f'frame {number} of {folder.folder} has another calibration than frame 0; merge'
                ' the frames of one calibration'
            )


def _median(filtered: Filtered) -> float:
    """Return the median sigma of measured pixels, px; NaN without any."""
    measured = (filtered.validity & Validity.MEASURED) > 0
    return float(np.median(filtered.sigma_px[measured])) if measured.any() else float('nan')


class _Stack:
    """All frames of a folder; what does not fit into memory is read when it is needed.

    Attributes
    ----------
    used : list of int
        Numbers of the frames whose image is not shifted.
    left_out : list of (int, float)
        Number and shift, px, of the others.
    disputed : float
        Share of the pixels whose values do not agree.
    single_px : float
        Median sigma of the measured pixels of one frame.

    """

    def __init__(self, folder: MeasuredFolder, progress: ProgressBar) -> None:
        self._folder, self._progress, self._done = folder, progress, 0.0
        width, height = folder.rig().left.size
        self._size = height, width
        # the bits of pixels that are not measured, of the first frame where that is so
        self._others = np.zeros(self._size, np.uint8)
        self._measured: list[ByteImage] = []
        corners, places = Corners(), []
        for number in range(folder.count):
            validity = folder.validity(number)
            measured = (validity & Validity.MEASURED) > 0
            unknown = (self._others == 0) & ~measured
            self._others[unknown] = validity[unknown]
            self._measured.append(np.packbits(measured, axis=1))
            places.append(corners.follow(folder.left_bgr(number)))
            self._step()
        moved = moved_px(np.array(places))
        self.used = [n for n in range(folder.count) if moved[n] <= MOST_SHIFT_PX]
        self.left_out = [(n, float(moved[n])) for n in range(folder.count) if n not in self.used]
        if len(self.used) < max(2, folder.count / 2):
            raise MeasurementError(
                f'the camera moved: of {folder.count} images {len(self.left_out)} are shifted by'
                f' more than {MOST_SHIFT_PX} px (up to {moved.max():.1f} px) against the median of'
                ' all; merge frames during which the rig stood still'
            )
        self.disputed, self.single_px = 0.0, float('nan')

    def filtered(self) -> tuple[Filtered, npt.NDArray[np.uint16]]:
        """Return the averaged disparities, and of how many frames each is the mean.

        Raises a MeasurementError if most do not agree.
        """
        height, width = self._size
        rows = max(1, _BAND_BYTES // (8 * width * len(self.used)))
        bands = [slice(row, min(row + rows, height)) for row in range(0, height, rows)]
        measured, every = _joined(self._averages(band, len(bands)) for band in bands)
        # what moves is measured in few frames, perhaps where the rest cannot be measured at all
        seen = measured.most_of(len(self.used))
        known = seen | every.most_of(every.count)
        disputed = (every.count > 0) & ~known
        self.disputed = float(disputed.mean())
        moved = float(np.mean(disputed[measured.count > len(self.used) / 2]))
        if moved > MOST_DISPUTED:
            raise MeasurementError(
                f'{moved:.0%} of the measured pixels have values that do not agree over time, at'
                f' most {MOST_DISPUTED:.0%} are allowed: the rig or most of the scene moved; merge'
                ' frames during which they stood still'
            )
        self.single_px = float(np.sqrt(np.nanmedian(measured.stated_px2[seen])))
        nan = np.float32(np.nan)
        disparity_px = np.where(seen, measured.disparity_px, every.disparity_px)
        sigma_px = np.where(seen, sigma_of(measured, seen), np.sqrt(every.stated_px2))
        validity = np.where(seen, np.uint8(Validity.MEASURED), self._others)
        validity[~known] = np.uint8(Validity.AMBIGUOUS)
        averaged = Filtered(
            np.where(known, disparity_px, nan), np.where(known, sigma_px, nan), validity, 0, 0.0
        )
        count = np.where(seen, measured.agreeing, np.where(known, every.agreeing, 0))
        return averaged, count.astype(np.uint16)

    def _averages(self, band: slice, bands: int) -> tuple[TimeAverage, TimeAverage]:
        """Return the averages of the measured and of all values in a band of rows."""
        width = self._size[1]
        shape = (len(self.used), band.stop - band.start, width)
        values, sigmas = np.empty(shape, np.float32), np.empty(shape, np.float32)
        measured = np.empty(shape, bool)
        for k, number in enumerate(self.used):
            values[k] = self._folder.disparity_px(number, band)
            sigmas[k] = self._folder.sigma_px(number, band)
            bits = np.unpackbits(self._measured[number][band], axis=1, count=width)
            measured[k] = bits.astype(bool)
            self._step(1 / bands)
        every = average(values, sigmas)
        values[~measured] = np.nan
        return average(values, sigmas), every

    def colours(self, disparity_px: FloatImage, sigma_px: FloatImage) -> ByteImage:
        """Return the mean colours of the frames that see the averaged surface, (H, W, 3) uint8."""
        total = np.zeros((*self._size, 3), np.float32)
        every, count = np.zeros_like(total), np.zeros(self._size, np.float32)
        for number in self.used:
            away = np.abs(self._folder.disparity_px(number) - disparity_px)
            same = away <= 3 * np.maximum(sigma_px, self._folder.sigma_px(number))
            bgr = self._folder.left_bgr(number)
            every += bgr
            total += np.where(same[..., None], bgr, 0)
            count += same
            self._step()
        seen = count[..., None] > 0
        mean = np.where(seen, total / np.maximum(count, 1)[..., None], every / len(self.used))
        rounded: ByteImage = np.rint(mean).astype(np.uint8)
        return rounded

    def _step(self, share: float = 1.0) -> None:
        self._done += share
        self._progress.show(int(self._done))


def _joined(averages: Any) -> tuple[TimeAverage, TimeAverage]:
    """Return the averages of all bands as two of whole images."""
    parts: list[list[tuple[FloatArray, ...]]] = [[], []]
    for pair in averages:
        for kept, found in zip(parts, pair, strict=True):
            kept.append(tuple(vars(found).values()))
    whole = [
        TimeAverage(*(np.concatenate(maps) for maps in zip(*kept, strict=True))) for kept in parts
    ]
    return whole[0], whole[1]
