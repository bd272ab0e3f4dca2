# SPDX-License-Identifier: Apache-2.0
"""Find the topics of a stereo rig in a bag."""

from __future__ import annotations

import re
from typing import NamedTuple

from binocular_recon.errors import BagError
from binocular_recon.io.bags.reader import Topic

_IMAGE_TYPES: tuple[str, ...] = ('sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage')
_INFO_TYPES = ('sensor_msgs/msg/CameraInfo',)
# In order of preference: after our own rectification we know where the image has no data.
_LAYOUTS = (
    ('image_raw', 'camera_info', False),
    ('image_rect', 'camera_info_rect', True),
    ('image_rect', 'camera_info', True),
    ('image_rect_color', 'camera_info', True),
    ('rect/image', 'rect/camera_info', True),
    ('color/rect/image', 'color/rect/camera_info', True),
    ('gray/rect/image', 'gray/rect/camera_info', True),
)
# Words of a topic's name that say whether its images are rectified; whole words: `image_correct`
# is not.
_RECTIFIED = re.compile(r'(?<![a-z])(rect|rectified)(?![a-z])')
_RAW = re.compile(r'(?<![a-z])(raw|unrectified)(?![a-z])')
_TRANSPORTS = ('', '/compressed')


class StereoTopics(NamedTuple):
    """Topics of a stereo rig.

    Attributes
    ----------
    images : (str, str)
        Image or CompressedImage of the left and the right camera.
    infos : (str, str) or None
        Their CameraInfo; None if a calibration folder replaces it.
    rectified : bool
        Whether the images are already rectified.

    """

    images: tuple[str, str]
    infos: tuple[str, str] | None
    rectified: bool


def find_stereo_topics(
    topics: list[Topic], namespace: str | None = None, *, calibrated: bool = False
) -> StereoTopics:
    """Find the topics of a stereo rig by their usual names.

    Parameters
    ----------
    topics : list of Topic
        Topics of the bag.
    namespace : str, optional
        Namespace of the rig; required if the bag has several rigs.
    calibrated : bool
        Whether a calibration folder replaces the camera infos.

    Raises
    ------
    BagError
        If the bag has no rig or more than one.

    """
    have = {topic.name: topic.msgtype for topic in topics}
    found = {}
    for space in sorted(_namespaces(have)):
        if namespace is None or space.strip('/') == namespace.strip('/'):
            rig = _rig_in(space, have, calibrated=calibrated)
            if rig:
                found[space] = rig
    if len(found) > 1:
        raise BagError(
            f'the bag has several stereo rigs: {", ".join(found)}; choose one with --namespace'
        )
    if not found:
        where = '' if namespace is None else f' in namespace {namespace}'
        infos = '' if calibrated else ' with their camera_info'
        remedy = '' if calibrated else ', or give --calibration DIR for the camera_info'
        raise BagError(
            f'there is no left/image_raw and right/image_raw (or image_rect){infos}{where};'
            f' name the topics with --left-image and --right-image{remedy}; {_describe(topics)}'
        )
    return next(iter(found.values()))


def name_stereo_topics(
    topics: list[Topic],
    images: tuple[str, str],
    infos: tuple[str, str] | None = None,
    *,
    rectified: bool | None = None,
    calibrated: bool = False,
) -> StereoTopics:
    """Check the topics that the user named against the bag and return them.

    Parameters
    ----------
    topics : list of Topic
        Topics of the bag.
    images : (str, str)
        Topics of the left and the right image.
    infos : (str, str), optional
        Topics of the camera infos; by default ``camera_info`` beside the images.
    rectified : bool, optional
        Whether the images are rectified; by default as `is_rectified` says.
    calibrated : bool
        Whether a calibration folder replaces the camera infos.

    Raises
    ------
    BagError
        If a topic is missing or has another type, or both images are the same topic.

    """
    if images[0] == images[1]:
        raise BagError(f'{images[0]} is named for both cameras; name the left and the right one')
    left, right = (image.removesuffix('/compressed').rpartition('/') for image in images)
    if infos is None:
        infos = f'{left[0]}/camera_info', f'{right[0]}/camera_info'
    have = {topic.name: topic.msgtype for topic in topics}
    wanted = dict.fromkeys(images, _IMAGE_TYPES)
    if not calibrated:
        wanted |= dict.fromkeys(infos, _INFO_TYPES)
    for name, types in wanted.items():
        if have.get(name) not in types:
            raise BagError(f'there is no {name} of type {" or ".join(types)}; {_describe(topics)}')
    if rectified is None:
        rectified = is_rectified(images[0])
    return StereoTopics(images, None if calibrated else infos, rectified)


def is_rectified(topic: str) -> bool:
    """Tell whether images are rectified, by the words of their topic's name, the last ones first.

    `image_rect`, `image_rect_raw` and `rect/image` are, `image_correct` and `rect/image_raw` are
    not.
    """
    for part in reversed(topic.lower().removesuffix('/compressed').split('/')):
        if _RECTIFIED.search(part):
            return True
        if _RAW.search(part):
            return False
    return False


def _namespaces(have: dict[str, str]) -> set[str]:
    """Return what precedes the image of the left camera in topic names, with its last slash."""
    layouts = (f'left/{image}' for image, _, _ in _LAYOUTS)
    spaces = [name.rpartition(layout) for layout in layouts for name in have]
    return {space for space, found, _ in spaces if found and (not space or space[-1] == '/')}


def _rig_in(space: str, have: dict[str, str], *, calibrated: bool) -> StereoTopics | None:
    for image, info, rectified in _LAYOUTS:
        infos = f'{space}left/{info}', f'{space}right/{info}'
        if not calibrated and not all(have.get(name) in _INFO_TYPES for name in infos):
            continue
        for transport in _TRANSPORTS:
            images = f'{space}left/{image}{transport}', f'{space}right/{image}{transport}'
            if all(have.get(name) in _IMAGE_TYPES for name in images):
                return StereoTopics(images, None if calibrated else infos, rectified)
    return None


def _describe(topics: list[Topic]) -> str:
    names = (f'{topic.name} ({topic.msgtype}, {topic.message_count})' for topic in topics)
    return f'the bag has {", ".join(names)}'
