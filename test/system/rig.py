# SPDX-License-Identifier: Apache-2.0
"""A small rig, its images, and their messages."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.io.messages.camera_infos import fill_camera_info
from binocular_recon.io.messages.images import fill_image

WIDTH, HEIGHT = 160, 120
FRAME_NS = 100_000_000
SIDES = ('left', 'right')


def raw_rig(offset_px: float = -3.2, width: int = WIDTH, height: int = HEIGHT) -> StereoRig:
    """Return a rig that is not rectified: lenses distort, both cameras are turned alike.

    Raw rows of its images nearly correspond, so that `image_pair` needs no lens model.
    """
    f = 1.25 * width
    K = np.array([[f, 0, 0.49 * width], [0, f + 1, 0.51 * height], [0, 0, 1]])
    P = np.array([[f, 0, width / 2 - 2, 0], [0, f, height / 2, 0], [0, 0, 1.0, 0]])
    right_P = P.copy()
    right_P[0, 2] -= offset_px
    right_P[0, 3] = -f * 0.25
    cameras = []
    rotation, _ = cv2.Rodrigues(np.array([0.004, 0.002, -0.004]))
    for projection in (P, right_P):
        D = np.array([-0.05, 0.01, 0.0005, -0.0005, 0.0])
        cameras.append(Camera(width, height, K, D, np.asarray(rotation), projection))
    return StereoRig(*cameras)


def image_pair(
    seed: int, width: int = WIDTH, height: int = HEIGHT, *, colour: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return a textured pair: a slanted wall with a box in front, whose place depends on seed."""
    generator = np.random.default_rng(seed)
    wide = generator.uniform(0, 255, (height, width + 64, 3)).astype(np.float32)
    wide = cv2.GaussianBlur(wide, (0, 0), 1.0) * 3 - 255
    y, x = np.mgrid[:height, :width].astype(np.float32)
    disparity = 8 + 6 * y / height
    left_edge = generator.integers(width // 8, width // 2)
    box = (x > left_edge) & (x < left_edge + width / 4) & (y > height / 4) & (y < height * 3 / 4)
    disparity[box] += 8
    right = wide[:, 32 : 32 + width]
    left = cv2.remap(wide, x + 32 - disparity, y, cv2.INTER_LINEAR)
    pair = [np.clip(image, 0, 255).astype(np.uint8) for image in (left, right)]
    if not colour:
        pair = [np.ascontiguousarray(image[..., 1]) for image in pair]
    return pair[0], pair[1]


def header(index: int, side: str = 'left') -> Header:
    """Return the header of frame ``index``."""
    seconds, nanoseconds = divmod(1_000_000_000 + index * FRAME_NS, 1_000_000_000)
    return Header(stamp=Time(sec=seconds, nanosec=nanoseconds), frame_id=f'{side}_optical')


def image_message(image: np.ndarray, head: Header, encoding: str = '') -> Image:
    """Return an Image."""
    message = Image()
    fill_image(message, image, encoding or ('mono8' if image.ndim == 2 else 'bgr8'), head)
    return message


def compressed_message(
    image: np.ndarray, head: Header, extension: str = '.png'
) -> CompressedImage:
    """Return a CompressedImage as image_transport makes it."""
    done, file = cv2.imencode(extension, image)
    assert done
    codec = {'.png': 'png', '.jpg': 'jpeg'}[extension]
    encoding, order = ('mono8', '') if image.ndim == 2 else ('bgr8', 'bgr8')
    return CompressedImage(
        header=head, format=f'{encoding}; {codec} compressed {order}', data=file.tobytes()
    )


def info_message(camera: Camera, head: Header) -> CameraInfo:
    """Return a CameraInfo."""
    message = CameraInfo()
    fill_camera_info(message, camera, head)
    return message


class CameraPair:
    """The drivers of the cameras of a rig, in the test's own node."""

    def __init__(
        self, graph: Any, rig: StereoRig, image: str = 'image_raw', *, compressed: bool = False
    ) -> None:
        self.rig = rig
        self._compressed = compressed
        self._images, self._infos = {}, {}
        self.topics = []
        for side in SIDES:
            topic = f'/rig/{side}/{image}' + ('/compressed' if compressed else '')
            self.topics += [topic, f'/rig/{side}/camera_info']
            kind = CompressedImage if compressed else Image
            self._images[side] = graph.publisher(topic, kind)
            self._infos[side] = graph.publisher(f'/rig/{side}/camera_info', CameraInfo)

    def send(self, index: int, images: tuple[Any, Any], **changes: Any) -> None:
        """Send a frame; ``changes`` replaces messages by topic (None: not sent)."""
        cameras = (self.rig.left, self.rig.right)
        for side, image, camera in zip(SIDES, images, cameras, strict=True):
            head = header(index, side)
            info = changes.get(f'{side}_info', info_message(camera, head))
            if f'{side}_image' in changes:
                message = changes[f'{side}_image']
            else:
                make = compressed_message if self._compressed else image_message
                message = make(image, head)
            if info is not None:
                self._infos[side].publish(info)
            if message is not None:
                self._images[side].publish(message)
