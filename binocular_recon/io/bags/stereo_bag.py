# SPDX-License-Identifier: Apache-2.0
"""The image pairs of a bag."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from binocular_recon.camera import StereoRig
from binocular_recon.errors import BagError, CalibrationError
from binocular_recon.images import Image
from binocular_recon.inputs.options import PairingOptions
from binocular_recon.io.bags.reader import Bag, Topic, decode
from binocular_recon.io.bags.stereo_topics import StereoTopics
from binocular_recon.io.messages.camera_infos import (
    calibration_content,
    rig_from_messages,
    states_size,
)
from binocular_recon.io.messages.images import read_image, stamp_ns
from binocular_recon.pairing import STANDING_STILL, Synchronizer

# Images of one camera that wait for the other's: recorders interleave the cameras unevenly.
_QUEUE_SIZE = 50


@dataclass(frozen=True, eq=False)
class StereoFrame:
    """A time-stamped image pair.

    Attributes
    ----------
    stamp_ns : int
        Header stamp of the left image.
    rig : StereoRig
        Calibration at that instant; the same object until it changes.
    left, right : sensor_msgs/Image or sensor_msgs/CompressedImage
        Messages; `images` decodes them.

    """

    stamp_ns: int
    rig: StereoRig
    left: Any
    right: Any

    @property
    def names(self) -> None:
        """Messages have no names; their stamps tell them apart."""
        return None

    def images(self) -> tuple[Image, Image]:
        """Return left and right, grey, BGR or BGRA.

        Raises an ImageError if one is damaged or has another size than its calibration.
        """
        return (
            read_image(self.left, 'left image', self.rig.left.size).image,
            read_image(self.right, 'right image', self.rig.right.size).image,
        )


class _Arrival(NamedTuple):
    """An image, its place in the recording, and the camera infos that preceded it."""

    number: int
    message: Any
    infos: tuple[Any, ...]


class StereoBag:
    """The image pairs of an open bag.

    Parameters
    ----------
    bag : Bag
    topics : StereoTopics
    rig : StereoRig, optional
        Replaces the recorded calibration; required if ``topics`` names no camera infos.
    tolerance_ns : int
        Largest difference between the stamps of a pair; 0 pairs equal stamps only.
    pairing : PairingOptions, optional
        Whether stamps or the times of recording tell which images belong together, and what is
        added to the stamps of the right camera.

    Attributes
    ----------
    expected : int
        Number of pairs if every image finds its partner.
    images_read : int
        Number of images read so far.

    """

    def __init__(
        self,
        bag: Bag,
        topics: StereoTopics,
        rig: StereoRig | None = None,
        *,
        tolerance_ns: int = 0,
        pairing: PairingOptions | None = None,
    ) -> None:
        self._bag, self._rig, self._rectified = bag, rig, topics.rectified
        self._sizes: tuple[tuple[int, int] | None, tuple[int, int] | None] = (None, None)
        recorded = {topic.name: topic for topic in bag.topics}
        self._images = [recorded[name] for name in topics.images]
        self._infos = [recorded[name] for name in topics.infos or ()] if rig is None else []
        pairing = pairing or PairingOptions()
        self._synchronizer = Synchronizer(
            topics.images,
            queue_size=_QUEUE_SIZE,
            tolerance_ns=tolerance_ns,
            by_arrival=pairing.by_arrival,
            offsets_ns={topics.images[1]: pairing.stamp_offset_ns},
        )
        self.images_read = self._pairs = 0
        self._ended = False
        self.expected = min(topic.message_count for topic in self._images)

    @property
    def unpaired(self) -> int:
        """Number of images without a partner; those that may still find one do not count."""
        if self._ended:
            return self.images_read - 2 * self._pairs
        return self._synchronizer.dropped.total()

    @property
    def damage(self) -> list[str]:
        """Sentences about what could not be read so far."""
        return self._bag.damage

    def __iter__(self) -> Iterator[StereoFrame]:
        """Yield the pairs in the order of recording; at most 50 images of each camera wait.

        Raises
        ------
        BagError
            At the end, if no left image was paired with a right one.
        CalibrationError
            If the first camera infos are not calibrated.

        """
        infos = self._first_infos()
        rig: StereoRig | None = self._rig or self._rig_of(infos)
        for left, right in self._paired(infos):
            self._pairs += 1
            # those of the later image: by then the infos of both cameras have changed
            latest = max(left, right, key=lambda arrival: arrival.number).infos
            if latest is not infos:
                infos, rig = latest, self._changed_rig(latest)
            if rig:
                yield StereoFrame(stamp_ns(left.message.header), rig, left.message, right.message)
        if not self._pairs:
            why = f'{self._bag.path}: {self._why_unpaired()}'
            raise BagError('; '.join([why, *self._bag.damage]))

    def _paired(self, infos: tuple[Any, ...]) -> Iterator[tuple[_Arrival, _Arrival]]:
        """Yield left and right images that belong together."""
        decoded = self._decoded([*self._images, *self._infos])
        for number, (topic, message, recorded_ns) in enumerate(decoded):
            if topic in self._infos:
                infos = _replaced(infos, self._infos.index(topic), message)
                continue
            self.images_read += 1
            arrival = _Arrival(number, message, infos)
            stamp = stamp_ns(message.header)
            yield from self._synchronizer.add(topic.name, stamp, arrival, recorded_ns)
            self._refuse_clocks_that_stand_still(STANDING_STILL)
        yield from self._synchronizer.finish()
        self._ended = True
        if self.images_read <= 2 * STANDING_STILL:  # a short recording
            self._refuse_clocks_that_stand_still(max(2, self.images_read // 2))

    def _refuse_clocks_that_stand_still(self, least: int) -> None:
        still = self._synchronizer.standing_still(least)
        if still:
            raise BagError(
                f'{self._bag.path}: {still}, or give --pairing arrival if a hardware trigger took'
                ' them'
            )

    def _why_unpaired(self) -> str:
        """Return why no images were paired."""
        mismatch = self._synchronizer.explain()
        if mismatch is None:
            return 'only one camera has images that can be read'
        remedies = []
        if mismatch.tolerance_s is not None:
            remedies.append(
                f'pair them with --approximate-sync-tolerance-seconds {mismatch.tolerance_s:g}'
            )
        if mismatch.offset_s is not None:
            beside = ''
            if mismatch.offset_tolerance_s:
                beside = (
                    f' with --approximate-sync-tolerance-seconds {mismatch.offset_tolerance_s:.6f}'
                )
            remedies.append(f'give --stamp-offset {mismatch.offset_text}{beside}')
            remedies.append('--pairing arrival if a hardware trigger took them')
        if not remedies:
            remedies.append(
                'that is at least half a frame period, so no tolerance tells which belong together'
            )
        return f'{mismatch.text}; {", or ".join(remedies)}'

    def _rig_of(self, infos: tuple[Any, ...]) -> StereoRig:
        """Return the rig of camera infos; sizes that they do not state are those of an image."""
        if self._sizes == (None, None) and not all(map(states_size, infos)):
            self._sizes = self._size_of(0), self._size_of(1)
        left, right = self._sizes
        return rig_from_messages(*infos, size=left, right_size=right, rectified=self._rectified)

    def _size_of(self, side: int) -> tuple[int, int] | None:
        """Return the size of the first left (0) or right image, None if there is none."""
        message = next((found[1] for found in self._decoded([self._images[side]])), None)
        if message is None:
            return None
        height, width = read_image(message, f'{("left", "right")[side]} image').image.shape[:2]
        return width, height

    def _changed_rig(self, infos: tuple[Any, ...]) -> StereoRig | None:
        try:
            return self._rig_of(infos)
        except CalibrationError as error:
            self._bag.note(f'images with unusable camera infos are left out: {error}')
            return None

    def _first_infos(self) -> tuple[Any, ...]:
        """Return the first camera info of each side: images may have been recorded before it."""
        first: list[Any] = []
        for info in self._infos:
            message = next((found[1] for found in self._decoded([info])), None)
            if message is None:
                raise BagError(f'{self._bag.path}: no message on {info.name} can be read')
            first.append(message)
        return tuple(first)

    def _decoded(self, topics: list[Topic]) -> Iterator[tuple[Topic, Any, int]]:
        """Yield topic, message and time of recording."""
        for message in self._bag.messages(topics):
            try:
                decoded = decode(message.topic.msgtype, message.cdr)
                yield message.topic, decoded, message.stamp_ns
            except BagError as error:  # noqa: PERF203 - one message of many
                self._bag.note(f'{message.topic.name}: {error}')


def _replaced(infos: tuple[Any, ...], side: int, info: Any) -> tuple[Any, ...]:
    """Return ``infos`` with one side replaced; the same object if the calibration is the same."""
    if calibration_content(info) == calibration_content(infos[side]):
        return infos
    return (info, infos[1]) if side == 0 else (infos[0], info)
