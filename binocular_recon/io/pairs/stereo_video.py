# SPDX-License-Identifier: Apache-2.0
"""The pairs of two videos, or of one that shows both images side by side."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterator
from dataclasses import dataclass

from binocular_recon.camera import StereoRig
from binocular_recon.errors import ConfigError, FileError, ImageError
from binocular_recon.images import Image
from binocular_recon.inputs.camera_checks import check_image_size
from binocular_recon.io.pairs.video import Video, VideoFrame
from binocular_recon.number_text import counted
from binocular_recon.pairing import Synchronizer

# Decoded frames of one video that wait for the other's: those that a lost frame delays.
_QUEUE_SIZE = 5
# Frame rates that differ by less are the same.
_SAME_RATE = 0.01
_SIDES = ('left', 'right')


@dataclass(frozen=True, eq=False)
class VideoPair:
    """An image pair of one or two videos.

    Attributes
    ----------
    stamp_ns : int
        Time of the left frame: since 1970 if the file says when the recording began, else since
        its beginning.
    rig : StereoRig
    names : (str, str)
        File and number of each frame.
    frames : tuple of VideoFrame
        Left and right; one of twice the width if it shows both.

    """

    stamp_ns: int
    rig: StereoRig
    names: tuple[str, str]
    frames: tuple[VideoFrame, ...]

    def images(self) -> tuple[Image, Image]:
        """Return left and right, grey or BGR.

        Raises an ImageError if one is damaged or has another size than its calibration.
        """
        cameras = self.rig.left, self.rig.right
        for frame, name, camera in zip(self.frames, self.names, cameras, strict=False):
            size = frame.content.width * len(self.frames) // 2, frame.content.height
            check_image_size(size, camera.size, name)  # before it is converted
        found = [frame.image(name) for frame, name in zip(self.frames, self.names, strict=False)]
        if len(found) == 1:
            half = found[0].shape[1] // 2
            found = [found[0][:, :half].copy(), found[0][:, half:].copy()]
        return found[0], found[1]


class StereoVideo:
    """The pairs of two videos.

    Parameters
    ----------
    left, right : Video
    rig : StereoRig
    by : str, optional
        ``time`` (the default) or ``order``.
    tolerance_ns : int
        With times: largest difference within a pair; 0: half a frame period.
    offset_ns : int
        Added to the times of the right video.

    Attributes
    ----------
    expected, images_read, unpaired, damage
        As for `StereoFiles`; all but ``expected`` grow while pairs are read.
    remarks : list of str
        What is to be said about the pairs.

    Raises
    ------
    ConfigError
        If they are to be paired by the numbers of their names.
    ImageError
        If a size is not that of the calibration.
    FileError
        If the numbers of frames (``order``) or the frame rates (``time``) differ.

    """

    def __init__(
        self,
        left: Video,
        right: Video,
        rig: StereoRig,
        by: str | None = None,
        *,
        tolerance_ns: int = 0,
        offset_ns: int = 0,
    ) -> None:
        self._videos, self._rig = (left, right), rig
        self._by = by or 'time'
        if self._by == 'number':
            raise ConfigError('frames of videos have no names; give --pair-by time or order')
        for video, camera in zip(self._videos, (rig.left, rig.right), strict=True):
            check_image_size(video.size, camera.size, str(video.path))
        if self._by == 'time':
            tolerance_ns = tolerance_ns or self._half_period_ns()
        elif left.expected and right.expected and left.expected != right.expected:
            raise FileError(
                f'{left.path} has {counted(left.expected, "frame")} and {right.path}'
                f' {right.expected}, so their order does not tell which belong together; give'
                ' --pair-by time'
            )
        self._synchronizer = Synchronizer(
            _SIDES,
            queue_size=_QUEUE_SIZE,
            tolerance_ns=tolerance_ns,
            offsets_ns={_SIDES[1]: offset_ns},
        )
        self.expected = min(left.expected, right.expected)
        self.images_read = self._pairs = 0
        self._order_damage: list[str] = []
        said = {'time': 'their times', 'order': 'their order'}[self._by]
        text = (
            f'frames are paired by {said}: {left.path.name} ({_facts(left)}) with'
            f' {right.path.name} ({_facts(right)})'
        )
        self.remarks = [text]

    def _half_period_ns(self) -> int:
        left, right = self._videos
        rates = left.rate_hz, right.rate_hz
        if not min(rates) or max(rates) > (1 + _SAME_RATE) * min(rates):
            raise FileError(
                f'{left.path} has {rates[0]:.3g} frames per second and {right.path}'
                f' {rates[1]:.3g}; give --approximate-sync-tolerance-seconds to pair the nearest'
                ' ones, or --pair-by order'
            )
        return round(0.5e9 / rates[0])

    @property
    def unpaired(self) -> int:
        """Number of frames read that have no partner."""
        return self.images_read - 2 * self._pairs

    @property
    def damage(self) -> list[str]:
        """Sentences about what could not be read."""
        return [*(text for video in self._videos for text in video.damage), *self._order_damage]

    def __iter__(self) -> Iterator[VideoPair]:
        """Yield the pairs; raises a FileError at the end if there is none."""
        pairs = self._by_time() if self._by == 'time' else self._by_order()
        began_ns = self._videos[0].began_ns
        for frames in pairs:
            self._pairs += 1
            names = tuple(
                f'{video.path.name} #{frame.number}'
                for video, frame in zip(self._videos, frames, strict=True)
            )
            stamp_ns = began_ns + frames[0].time_ns
            yield VideoPair(stamp_ns, self._rig, (names[0], names[1]), frames)
        if not self._pairs:
            mismatch = self._synchronizer.explain()
            why = mismatch.text if mismatch else 'one of the videos has no frame'
            left, right = (video.path for video in self._videos)
            raise FileError('; '.join([f'{left} and {right} have no pair: {why}', *self.damage]))

    def _by_time(self) -> Iterator[tuple[VideoFrame, VideoFrame]]:
        streams = [
            zip(itertools.repeat(name), video.frames(), strict=False)
            for name, video in zip(_SIDES, self._videos, strict=True)
        ]
        for name, frame in heapq.merge(*streams, key=lambda one: one[1].time_ns):
            self.images_read += 1
            for left, right in self._synchronizer.add(name, frame.time_ns, (frame,)):
                yield left[0], right[0]
        for left, right in self._synchronizer.finish():
            yield left[0], right[0]

    def _by_order(self) -> Iterator[tuple[VideoFrame, VideoFrame]]:
        streams = [video.frames(past_damage=False) for video in self._videos]
        alone = 0
        for left, right in itertools.zip_longest(*streams):
            if left and right:
                self.images_read += 2
                yield left, right
            else:
                self.images_read += 1
                alone += 1
        if alone and not self.damage:
            self._order_damage.append(
                f'one video has {counted(alone, "frame")} more than the other, so pairs by order'
                ' may be of different moments; give --pair-by time'
            )


class SideBySideVideo:
    """The pairs of a video whose left half is the left image.

    Parameters
    ----------
    video : Video
    rig : StereoRig

    Attributes
    ----------
    expected, images_read, unpaired, damage, remarks
        As for `StereoVideo`.

    Raises
    ------
    ImageError
        If half of the video does not have the size of the calibration.

    """

    unpaired = 0

    def __init__(self, video: Video, rig: StereoRig) -> None:
        width, height = video.size
        name = f'{video.path} shows two images side by side, each of which'
        if width % 2:
            raise ImageError(f'{video.path} is {width} px wide; two images of one size are not')
        check_image_size((width // 2, height), rig.left.size, name)
        self._video, self._rig = video, rig
        self.expected, self.images_read = video.expected, 0
        self.remarks = [f'{video.path.name} ({_facts(video)}) shows left and right side by side']

    @property
    def damage(self) -> list[str]:
        """Sentences about what could not be read."""
        return self._video.damage

    def __iter__(self) -> Iterator[VideoPair]:
        """Yield the pairs; raises a FileError at the end if there is none."""
        for frame in self._video.frames():
            self.images_read += 2
            name = f'{self._video.path.name} #{frame.number}'
            stamp_ns = self._video.began_ns + frame.time_ns
            yield VideoPair(stamp_ns, self._rig, (name, name), (frame,))
        if not self.images_read:
            raise FileError('; '.join([f'{self._video.path} has no frame', *self.damage]))


def _facts(video: Video) -> str:
    frames = counted(video.expected, 'frame') if video.expected else 'frames not counted'
    return f'{video.size[0]}x{video.size[1]} px, {frames}, {video.rate_hz:.4g} per second'
