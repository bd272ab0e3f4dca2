# SPDX-License-Identifier: Apache-2.0
"""The filter takes the disparities of other matchers, however late, and rejects bad input."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from stereo_msgs.msg import DisparityImage

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.cloud_config import CloudConfig
from binocular_recon.config import FilterConfig, MatchConfig
from binocular_recon.images import FloatImage, mark_empty, to_grey
from binocular_recon.images import Image as ImageArray
from binocular_recon.io.messages.disparities import fill_disparity, read_disparity
from binocular_recon.io.messages.images import read_image, stamp_ns
from binocular_recon.stereo.filtering.wls_filter import filter_disparity
from binocular_recon.stereo.matching import match
from binocular_recon.stereo.orientation import turn
from binocular_recon.stereo.rectification import Rectifier
from binocular_recon.stereo.triangulation import triangulate
from test import stereo_image_proc
from test.system.chain import reliable
from test.system.conftest import StartNode
from test.system.graph import Graph, NodeProcess, wait_until
from test.system.rig import (
    SIDES,
    compressed_message,
    header,
    image_message,
    image_pair,
    info_message,
    raw_rig,
)

pytestmark = pytest.mark.long

CONFIG = MatchConfig(min_disparity=-32, disparity_range=88)
WLS: tuple[str, type[DisparityImage]] = ('/rig/disparity_wls', DisparityImage)
KINDS: dict[str, type[Any]] = {
    'left/image_rect/compressed': CompressedImage,
    'left/camera_info': CameraInfo,
    'right/camera_info': CameraInfo,
    'disparity': DisparityImage,
    'confidence': Image,
    'match_validity': Image,
}
REQUIRED, OPTIONAL = list(KINDS)[:4], list(KINDS)[4:]
# images that wait for their disparities, at most; DDS holds them too, should the node be busy
FRAMES = 36


def grey(image: ImageArray) -> FloatImage:
    """Return the grey levels that the nodes work on: NaN where rectification left nothing."""
    levels = to_grey(image)
    mark_empty(levels)
    return levels


class Matcher:
    """A rectifier and a matcher that publish a compressed image and, at first, no confidence."""

    def __init__(self, graph: Graph, node: NodeProcess) -> None:
        self._graph, self.node = graph, node

    def send(self, **messages: Any) -> None:
        for topic, message in messages.items():
            self._graph.publisher(f'/rig/{topic}', KINDS[topic]).publish(message)

    def wait_for_filter(self) -> None:
        for topic in REQUIRED:
            self._graph.publisher(f'/rig/{topic}', KINDS[topic])
        self._graph.wait_for_subscriber(*(f'/rig/{topic}' for topic in REQUIRED))


def messages(
    index: int, left: np.ndarray, rectify: Rectifier, disparity: DisparityImage
) -> dict[str, Any]:
    """Return a frame by topic."""
    cameras = rectify.rig.left, rectify.rig.right
    infos = [info_message(c, header(index, s)) for c, s in zip(cameras, SIDES, strict=True)]
    disparity.header = header(index)
    frame = [compressed_message(left, header(index)), *infos, disparity]
    return dict(zip(REQUIRED, frame, strict=True))


@pytest.fixture(scope='module')
def matcher(graph: Graph, start_node: StartNode) -> Matcher:
    qos = reliable(list(KINDS), depth=FRAMES)
    return Matcher(graph, start_node('wls_filter_node', image_transport='compressed', **qos))


@pytest.mark.parametrize('sender', ['stereo_image_proc', 'ours'])
@pytest.mark.parametrize('offset_px', [-32.8, 0.0, 32.8])
def test_disparity_of_either_convention(
    graph: Graph, matcher: Matcher, offset_px: float, sender: str
) -> None:
    rectify = Rectifier(raw_rig(offset_px))
    left, right = rectify(*image_pair(5))
    raw = stereo_image_proc.in_sixteenths(match(grey(left), grey(right), CONFIG).disparity_px)
    valid = np.isfinite(raw)
    assert 0.4 < valid.mean() < 0.95
    message = DisparityImage()
    if sender == 'ours':
        fill_disparity(message, raw, rectify.rig, CONFIG.limits_px, header(0), step_px=1 / 64)
    else:
        low, high = CONFIG.limits_px
        stereo_image_proc.fill(message, raw, rectify.rig, (int(low), int(high)))
    with graph.listening(WLS) as (inbox,):
        matcher.wait_for_filter()
        matcher.send(**messages(0, left, rectify, message))
        answer = inbox.wait()[0]
    expected = filter_disparity(
        raw.astype(np.float32),
        valid.astype(np.float32),
        grey(left),
        FilterConfig(),
        limits_px=CONFIG.limits_px,
    )
    read = read_disparity(answer, rectify.rig)
    np.testing.assert_allclose(read.disparity_px, expected.disparity_px, atol=1e-3)
    assert answer.delta_d == pytest.approx(message.delta_d)
    window = answer.valid_window
    assert (window.width, window.height) == (left.shape[1], left.shape[0])


RECTIFY = Rectifier(raw_rig())
LEFT, RIGHT = RECTIFY(*image_pair(5))
MATCH = match(grey(LEFT), grey(RIGHT), CONFIG)


def disparity(**members: Any) -> DisparityImage:
    """Return the disparities of `LEFT`; ``members`` replaces members of their image."""
    message = DisparityImage()
    fill_disparity(
        message, MATCH.disparity_px, RECTIFY.rig, CONFIG.limits_px, header(0), step_px=1 / 64
    )
    for name, value in members.items():
        setattr(message.image, name, value)
    return message


def test_images_wait_for_a_slow_matcher(graph: Graph, matcher: Matcher) -> None:
    """The disparity of every fifth image comes ten images later: none is lost."""
    with graph.listening(WLS) as (inbox,):
        matcher.wait_for_filter()
        for k in range(FRAMES):
            frame = messages(100 + k, LEFT, RECTIFY, disparity())
            del frame['disparity']
            matcher.send(**frame)
            if k >= 10 and k % 5 == 0:
                late = messages(90 + k, LEFT, RECTIFY, disparity())
                matcher.send(disparity=late['disparity'])
                inbox.wait(k // 5 - 1)
    stamps = [stamp_ns(message.header) for message in inbox.messages]
    assert stamps == [stamp_ns(header(100 + k)) for k in range(0, 30, 5)]


def small_image(index: int) -> CompressedImage:
    return compressed_message(LEFT[:60, :80], header(index))


def empty_image(index: int) -> CompressedImage:
    return CompressedImage(header=header(index), format='mono8; png compressed ')


def of_another_rig(_: int) -> DisparityImage:
    message = disparity()
    message.f = 278.0
    return message


BAD: dict[str, tuple[str, Callable[[int], Any], str]] = {
    'disparity of another rig': (
        'disparity',
        of_another_rig,
        'disparity was made with f = 278, the camera infos say 200; use the camera infos of',
    ),
    'disparity of another type': (
        'disparity',
        lambda _: disparity(encoding='16UC1', step=320),
        "disparity has encoding '16UC1'; it must be 32FC1",
    ),
    'short disparity': (
        'disparity',
        lambda _: disparity(data=bytes(100)),
        'disparity holds 100 bytes, step x height is 640 x 120',
    ),
    'disparity of another size': (
        'disparity',
        lambda _: disparity(width=80, height=60),
        'disparity image is 80x60 px, its calibration is for 160x120',
    ),
    'no disparity': (
        'disparity',
        lambda _: disparity(data=np.full((120, 160), np.nan, np.float32).tobytes()),
        'no pixel has a disparity within -32..55 px and a confidence above 0',
    ),
    'image of another size': (
        'left/image_rect/compressed',
        small_image,
        'left image is 80x60 px, its calibration is for 160x120',
    ),
    'empty image': (
        'left/image_rect/compressed',
        empty_image,
        'left image is not an image (0 bytes)',
    ),
    'validity of another type': (
        'match_validity',
        lambda i: image_message(MATCH.confidence, header(i), '32FC1'),
        "match_validity has encoding '32FC1'; it must be mono8",
    ),
    'validity of another size': (
        'match_validity',
        lambda i: image_message(MATCH.validity[:60], header(i)),
        'match_validity image is 160x60 px, its calibration is for 160x120',
    ),
    'confidence of another type': (
        'confidence',
        lambda i: image_message(LEFT, header(i)),
        "confidence has encoding 'mono8'; it must be 32FC1",
    ),
    'confidence of another size': (
        'confidence',
        lambda i: image_message(MATCH.confidence[:60], header(i), '32FC1'),
        'disparity is (120, 160) and confidence (60, 160) (rows, columns)',
    ),
}


def test_a_confidence_of_another_matcher_is_its_sigma(graph: Graph, matcher: Matcher) -> None:
    """Disparities with a standard deviation of 0.1 px on the left and 0.5 px on the right."""
    sigma_px = np.full(LEFT.shape, 0.1, np.float32)
    sigma_px[:, LEFT.shape[1] // 2 :] = 0.5
    known = np.isfinite(MATCH.disparity_px)
    confidence = np.where(known, 1 / (1 + (sigma_px / 0.25) ** 2), 0).astype(np.float32)
    expected = filter_disparity(
        MATCH.disparity_px, confidence, grey(LEFT), FilterConfig(), limits_px=CONFIG.limits_px
    )
    with graph.listening(WLS, ('/rig/points2', PointCloud2)) as (wls, clouds):
        matcher.wait_for_filter()
        graph.publisher('/rig/confidence', Image)
        graph.wait_for_subscriber('/rig/confidence')
        sent = messages(190, LEFT, RECTIFY, disparity())
        matcher.send(**sent, confidence=image_message(confidence, header(190), '32FC1'))
        read, cloud = read_disparity(wls.wait()[0], RECTIFY.rig), clouds.wait()[0]
    np.testing.assert_allclose(read.disparity_px, expected.disparity_px, atol=1e-3)
    points = triangulate(
        expected.disparity_px, expected.sigma_px, expected.validity, RECTIFY.rig, CloudConfig()
    )
    at = {field.name: field.offset // 4 for field in cloud.fields}
    values = np.frombuffer(cloud.data, np.float32).reshape(*LEFT.shape, -1)
    found = values[..., at['sigma_z']]
    np.testing.assert_allclose(found, points.sigma_z_m, rtol=1e-3)
    # sigma_z = Z^2 sigma / (f B), and the scatter of the disparities besides
    sure, unsure = (found[:, half][known[:, half]] for half in (np.s_[:70], np.s_[90:]))
    assert 2 < np.nanmedian(unsure) / np.nanmedian(sure) < 8


def test_bad_input_is_rejected_and_good_used(graph: Graph, matcher: Matcher) -> None:
    """With confidence and reasons from now on, so only the last test comes after it."""
    expected = filter_disparity(
        MATCH.disparity_px,
        MATCH.confidence,
        grey(LEFT),
        FilterConfig(),
        limits_px=CONFIG.limits_px,
    )
    with graph.listening(WLS) as (inbox,):
        matcher.wait_for_filter()
        for topic in OPTIONAL:
            graph.publisher(f'/rig/{topic}', Image)
            graph.wait_for_subscriber(f'/rig/{topic}')
        good = []
        for number, (name, (topic, make, text)) in enumerate(BAD.items()):
            for index in (200 + 2 * number, 201 + 2 * number):
                frame = messages(index, LEFT, RECTIFY, disparity())
                frame['confidence'] = image_message(MATCH.confidence, header(index), '32FC1')
                frame['match_validity'] = image_message(MATCH.validity, header(index))
                if index % 2 == 0:
                    frame[topic] = make(index)
                    frame[topic].header = header(index)
                matcher.send(**frame)
                if index % 2 == 0:
                    wait_until(partial(_holds, matcher.node, text), f'{text!r} in the log')
            good.append(stamp_ns(header(index)))
            inbox.wait(len(good))
            assert [stamp_ns(message.header) for message in inbox.messages] == good, name
        status = graph.wait_for_status('/rig/wls_filter_node', text)
    for message in inbox.messages:
        read = read_disparity(message, RECTIFY.rig)
        np.testing.assert_allclose(read.disparity_px, expected.disparity_px, atol=1e-3)
    assert status.level == status.ERROR
    values = {item.key: item.value for item in status.values}
    assert values['dropped: bad calibration'] == '1'  # f
    assert values['dropped: bad input'] == str(len(BAD) - 1)
    assert 'Traceback' not in matcher.node.text()


def standing(camera: Camera) -> Camera:
    """Return the camera of the image turned clockwise."""
    (fx, _, cx, tx), (_, fy, cy, _) = camera.P[:2]
    P = np.array([[fy, 0, camera.height - 1 - cy, 0], [0, fx, cx, tx], [0, 0, 1, 0]])
    return Camera(camera.height, camera.width, P[:, :3], np.zeros(5), np.eye(3), P)


def test_cameras_one_above_the_other(graph: Graph, matcher: Matcher) -> None:
    """The rig on its side: its cloud is that of the lying rig, turned about the optical axis."""
    rig = StereoRig(standing(RECTIFY.rig.left), standing(RECTIFY.rig.right))
    assert rig.turns == 1
    image, raw = turn(LEFT, -1), turn(MATCH.disparity_px, -1)
    message = DisparityImage()
    fill_disparity(message, raw, rig, CONFIG.limits_px, header(900), step_px=1 / 64)
    infos = [
        info_message(camera, header(900, side))
        for camera, side in zip((rig.left, rig.right), SIDES, strict=True)
    ]
    sent = [
        compressed_message(image, header(900)),
        *infos,
        message,
        image_message(turn(MATCH.confidence, -1), header(900), '32FC1'),
        image_message(turn(MATCH.validity, -1), header(900)),
    ]
    outputs = ('/rig/points2', PointCloud2), ('/rig/validity', Image)
    with graph.listening(WLS, *outputs) as (wls, clouds, validities):
        matcher.wait_for_filter()
        for topic in OPTIONAL:
            graph.publisher(f'/rig/{topic}', Image)
            graph.wait_for_subscriber(f'/rig/{topic}')
        matcher.send(**dict(zip(KINDS, sent, strict=True)))
        disparity_wls, cloud = wls.wait()[0], clouds.wait()[0]
        validity = read_image(validities.wait()[0]).image
    lying = filter_disparity(
        MATCH.disparity_px,
        MATCH.confidence,
        grey(LEFT),
        FilterConfig(),
        limits_px=CONFIG.limits_px,
        reasons=MATCH.validity,
    )
    np.testing.assert_array_equal(turn(validity, 1), lying.validity)
    found = turn(read_disparity(disparity_wls, rig).disparity_px, 1)
    np.testing.assert_allclose(found, lying.disparity_px, atol=1e-3)
    expected = triangulate(
        lying.disparity_px, lying.sigma_px, lying.validity, RECTIFY.rig, CloudConfig()
    )
    assert (cloud.height, cloud.width) == image.shape
    xyz = np.frombuffer(cloud.data, np.float32).reshape(*image.shape, -1)[..., :3]
    # the image's right is now its bottom, and its bottom its left
    x, y, z = np.moveaxis(turn(np.ascontiguousarray(xyz), 1), -1, 0)
    assert np.isfinite(z).mean() > 0.6
    turned = np.stack([y, -x, z], axis=-1)
    np.testing.assert_allclose(turned, expected.points_xyz, rtol=1e-3, atol=1e-4)


def _holds(node: NodeProcess, text: str) -> bool:
    return text in node.text()
