# SPDX-License-Identifier: Apache-2.0
"""Finding a rig among the topics of a bag."""

from __future__ import annotations

import pytest

from binocular_recon.errors import BagError
from binocular_recon.io.bags.reader import Topic, TopicQos
from binocular_recon.io.bags.stereo_topics import (
    StereoTopics,
    find_stereo_topics,
    is_rectified,
    name_stereo_topics,
)

TYPES = {
    'camera_info': 'sensor_msgs/msg/CameraInfo',
    'camera_info_rect': 'sensor_msgs/msg/CameraInfo',
    'compressed': 'sensor_msgs/msg/CompressedImage',
}


def topics(*names: str) -> list[Topic]:
    return [
        Topic(name, TYPES.get(name.split('/')[-1], 'sensor_msgs/msg/Image'), 7, TopicQos())
        for name in sorted(names)
    ]


def rig(space: str, *names: str) -> list[str]:
    return [f'{space}/{side}/{name}' for side in ('left', 'right') for name in names]


@pytest.mark.parametrize('space', ['', '/rig', '/robot/front'])
@pytest.mark.parametrize(
    ('names', 'image', 'info', 'rectified'),
    [
        (('image_raw', 'camera_info'), 'image_raw', 'camera_info', False),
        (('image_raw', 'image_rect', 'camera_info'), 'image_raw', 'camera_info', False),
        (('image_rect', 'camera_info'), 'image_rect', 'camera_info', True),
        (('image_raw', 'image_rect', 'camera_info_rect'), 'image_rect', 'camera_info_rect', True),
        (('image_rect_color', 'camera_info'), 'image_rect_color', 'camera_info', True),
        (('image_raw/compressed', 'camera_info'), 'image_raw/compressed', 'camera_info', False),
        (('image_rect/compressed', 'camera_info'), 'image_rect/compressed', 'camera_info', True),
    ],
)
def test_usual_names_are_found_in_any_namespace(
    space: str, names: tuple[str, ...], image: str, info: str, rectified: bool
) -> None:
    found = find_stereo_topics(topics(*rig(space, *names), '/tf', '/my_left/image_raw'))
    left, right = f'{space}/left', f'{space}/right'
    assert found == StereoTopics(
        (f'{left}/{image}', f'{right}/{image}'), (f'{left}/{info}', f'{right}/{info}'), rectified
    )


def test_of_several_rigs_one_must_be_chosen() -> None:
    have = topics(
        *rig('/front', 'image_raw', 'camera_info'), *rig('/rear', 'image_raw', 'camera_info')
    )
    with pytest.raises(BagError, match=r'several stereo rigs: /front/, /rear/; .* --namespace'):
        find_stereo_topics(have)
    for namespace in ('rear', '/rear', '/rear/'):
        assert find_stereo_topics(have, namespace).images[0] == '/rear/left/image_raw'
    with pytest.raises(BagError, match='in namespace /side'):
        find_stereo_topics(have, '/side')


def test_a_bag_without_the_topics_says_what_it_has() -> None:
    have = topics('/left/image_raw', '/cam1/image_raw', '/left/camera_info')
    with pytest.raises(
        BagError,
        match=r'no left/image_raw and right/image_raw .* with their camera_info; .*--left-image'
        r'.*the bag has /cam1/image_raw \(sensor_msgs/msg/Image, 7\), /left/camera_info',
    ):
        find_stereo_topics(have)


def test_camera_infos_are_not_needed_with_a_calibration() -> None:
    have = topics(*rig('', 'image_raw'))
    with pytest.raises(BagError, match='give --calibration DIR'):
        find_stereo_topics(have)
    assert find_stereo_topics(have, calibrated=True).infos is None


def test_named_topics_take_the_camera_infos_beside_them() -> None:
    have = topics('/cam0/image', '/cam0/camera_info', '/cam1/image', '/cam1/camera_info')
    found = name_stereo_topics(have, ('/cam0/image', '/cam1/image'))
    assert found == StereoTopics(
        ('/cam0/image', '/cam1/image'), ('/cam0/camera_info', '/cam1/camera_info'), False
    )
    assert name_stereo_topics(have, found.images, rectified=True).rectified
    assert name_stereo_topics(have, found.images, calibrated=True).infos is None


def test_named_topics_are_checked() -> None:
    have = topics('/a/image_rect', '/b/image_rect', '/a/camera_info')
    images = ('/a/image_rect', '/b/image_rect')
    with pytest.raises(BagError, match=r'no /b/camera_info of type sensor_msgs/msg/CameraInfo;'):
        name_stereo_topics(have, images)
    with pytest.raises(BagError, match=r'no /c of type .*Image or .*CompressedImage; the bag has'):
        name_stereo_topics(have, ('/a/image_rect', '/c'))
    with pytest.raises(BagError, match='/a/image_rect is named for both cameras; name the left'):
        name_stereo_topics(have, ('/a/image_rect', '/a/image_rect'))
    infos = ('/a/camera_info', '/a/camera_info')
    assert name_stereo_topics(have, images, infos).rectified


@pytest.mark.parametrize(
    ('topic', 'rectified'),
    [
        ('/left/image_rect', True),
        ('/left/image_rect/compressed', True),
        ('/left/image_rect_color', True),
        ('/infra1/image_rect_raw', True),
        ('/zed/left/color/rect/image', True),
        ('/zed/left/rect/image', True),
        ('/cam0/rectified/image', True),
        ('/left/image_correct', False),
        ('/left/image_corrected', False),
        ('/direct/left/image', False),
        ('/rect_rig/left/image_raw', False),
        ('/zed/left/color/raw/image', False),
        ('/left/image_mono', False),
        ('/left/image_unrectified', False),
    ],
)
def test_names_say_whether_images_are_rectified(topic: str, rectified: bool) -> None:
    assert is_rectified(topic) == rectified
    right = topic.replace('left', 'right') if 'left' in topic else f'{topic}2'
    images = (topic, right)
    infos = ('/a/camera_info', '/b/camera_info')
    assert name_stereo_topics(topics(*images, *infos), images, infos).rectified == rectified


def test_rectified_images_in_a_folder_of_their_own_are_found() -> None:
    for inner in ('rect', 'color/rect'):
        have = topics(*rig('/zed', f'{inner}/image', f'{inner}/camera_info'))
        found = find_stereo_topics(have)
        assert found.images == (f'/zed/left/{inner}/image', f'/zed/right/{inner}/image')
        assert found.rectified
