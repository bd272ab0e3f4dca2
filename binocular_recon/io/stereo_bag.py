# SPDX-License-Identifier: Apache-2.0
"""The picture pairs of a bag."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from binocular_recon.camera import StereoRig
from binocular_recon.errors import BagError, CalibrationError
from binocular_recon.images import Image
from binocular_recon.io.bags import Bag, Topic, decode
from binocular_recon.io.messages import read_image, rig_from_messages, stamp_ns
from binocular_recon.io.stereo_topics import StereoTopics

# Pictures of one camera that may wait for the other's: recorders mix the cameras' messages.
_WAITING = 50


@dataclass(frozen=True, eq=False)
class Pair:
    """Two pictures of the same instant.

    Attributes
    ----------
    stamp_ns : int
        Header stamp of the left picture.
    rig : StereoRig
        Calibration at that instant; the same object until it changes.
    left, right : sensor_msgs/Image or sensor_msgs/CompressedImage
        Decoded when `images` is called.

    """

    stamp_ns: int
    rig: StereoRig
    left: Any
    right: Any

    def images(self) -> tuple[Image, Image]:
        """Return left and right as grey, BGR or BGRA; raises an ImageError if one is damaged."""
        return (
            read_image(self.left, 'left image').image,
            read_image(self.right, 'right image').image,
        )


class StereoBag:
    """The picture pairs of an open bag.

    Parameters
    ----------
    bag : Bag
    topics : StereoTopics
    rig : StereoRig, optional
        Calibration that replaces the recorded one; needed if ``topics`` names no camera infos.
    tolerance_ns : int
        Largest difference of the stamps of a pair; 0 pairs equal stamps only.

    Attributes
    ----------
    expected : int
        Number of pairs if every picture finds its partner.

    """

    def __init__(
        self,
        bag: Bag,
        topics: StereoTopics,
        rig: StereoRig | None = None,
        *,
        tolerance_ns: int = 0,
    ) -> None:
        self._bag, self._names, self._rig = bag, topics, rig
        self._matcher = _Matcher(tolerance_ns)
        recorded = {topic.name: topic for topic in bag.topics}
        self._images = [recorded[name] for name in topics.images]
        self._infos = [recorded[name] for name in topics.infos or ()] if rig is None else []
        self.expected = min(topic.message_count for topic in self._images)

    @property
    def unpaired(self) -> int:
        """Pictures left without a partner so far."""
        return self._matcher.dropped

    def __iter__(self) -> Iterator[Pair]:
        """Yield the pairs in the order of recording; only a few pictures are held at a time.

        Raises
        ------
        BagError
            At the end, if no left and right picture belong together.
        CalibrationError
            If the first camera infos hold no calibration.

        """
        infos = self._first_infos()
        rig: StereoRig | None = self._rig or rig_from_messages(*infos)
        paired = False
        for topic, message in self._decoded([*self._images, *self._infos]):
            if topic in self._infos:
                side = self._infos.index(topic)
                if _calibration(message) != _calibration(infos[side]):
                    infos[side], rig = message, None
                continue
            pair = self._matcher.add(self._images.index(topic), message)
            if pair:
                paired = True
                # only now: both cameras' infos have changed
                rig = rig or self._changed_rig(infos)
                if rig:
                    yield Pair(stamp_ns(pair[0].header), rig, *pair)
        if not paired:
            raise BagError(f'{self._bag.path}: {self._matcher.complaint()}')

    def _changed_rig(self, infos: list[Any]) -> StereoRig | None:
        try:
            return rig_from_messages(*infos)
        except CalibrationError as error:
            self._bag.note(f'pictures are left out while the camera infos do not fit: {error}')
            return None

    def _first_infos(self) -> list[Any]:
        """Return the first camera info of each side: pictures may have been recorded before."""
        first: list[Any] = []
        for info in self._infos:
            message = next((message for _, message in self._decoded([info])), None)
            if message is None:
                raise BagError(f'{self._bag.path}: no {info.name} can be read')
            first.append(message)
        return first

    def _decoded(self, topics: list[Topic]) -> Iterator[tuple[Topic, Any]]:
        for message in self._bag.messages(topics):
            try:
                yield message.topic, decode(message.topic.msgtype, message.cdr)
            except BagError as error:  # noqa: PERF203 - one message of many
                self._bag.note(f'{message.topic.name}: {error}')


def _calibration(info: Any) -> tuple[Any, ...]:
    """Return what a CameraInfo says besides its header, to be compared."""
    roi = info.roi
    window = (roi.x_offset, roi.y_offset, roi.width, roi.height, info.binning_x, info.binning_y)
    matrices = [matrix.tobytes() for matrix in (info.d, info.k, info.r, info.p)]
    return info.width, info.height, info.distortion_model, *window, *matrices


class _Matcher:
    """Pair the pictures of two streams by their stamps."""

    def __init__(self, tolerance_ns: int) -> None:
        self._tolerance_ns = tolerance_ns
        self._waiting: tuple[deque[Any], deque[Any]] = (deque(), deque())
        self._nearest_ns: int | None = None
        self.dropped = 0

    def add(self, side: int, message: Any) -> tuple[Any, Any] | None:
        """Take the next picture of a side (0 = left); return left and right if they pair."""
        queue = self._waiting[side]
        if queue and stamp_ns(message.header) < stamp_ns(queue[-1].header):
            # the recording looped: nothing older finds a partner any more
            self._drop(self._waiting[0], len(self._waiting[0]))
            self._drop(self._waiting[1], len(self._waiting[1]))
        queue.append(message)
        while all(self._waiting):
            left, right = (stamp_ns(waiting[0].header) for waiting in self._waiting)
            apart_ns = abs(left - right)
            if apart_ns <= self._tolerance_ns:
                return self._waiting[0].popleft(), self._waiting[1].popleft()
            nearest = self._nearest_ns
            self._nearest_ns = apart_ns if nearest is None else min(nearest, apart_ns)
            self._drop(self._waiting[0 if left < right else 1])
        self._drop(queue, len(queue) - _WAITING)
        return None

    def complaint(self) -> str:
        """Say why nothing was paired."""
        if self._nearest_ns is None:
            return 'only one camera has pictures that can be read'
        seconds = self._nearest_ns / 1e9
        return (
            f'no left and right picture are within {self._tolerance_ns / 1e9:g} s of each other,'
            f' the closest are {seconds:g} s apart; allow that with'
            f' --approximate-sync-tolerance-seconds {seconds * 1.01:.3g}'
        )

    def _drop(self, queue: deque[Any], count: int = 1) -> None:
        for _ in range(count):
            queue.popleft()
            self.dropped += 1
