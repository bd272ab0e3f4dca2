# SPDX-License-Identifier: Apache-2.0
"""The nodes over DDS, three or one, give what the offline chain gives, at every pixel."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from sensor_msgs.msg import Image, PointCloud2

from binocular_recon.cloud_config import CloudConfig
from binocular_recon.config import ChainConfig
from binocular_recon.drawing.colormap import heat_map
from binocular_recon.images import to_bgr8
from binocular_recon.io.bags.reader import Bag
from binocular_recon.io.bags.stereo_bag import StereoBag
from binocular_recon.io.bags.stereo_topics import find_stereo_topics
from binocular_recon.io.messages.camera_infos import camera_from_message
from binocular_recon.io.messages.disparities import read_disparity
from binocular_recon.io.messages.images import read_image, stamp_ns
from binocular_recon.stereo.matching import disparity_step_px
from binocular_recon.stereo.pipeline import Chain, Reconstruction
from binocular_recon.stereo.thinning import PointSet, thin
from binocular_recon.stereo.triangulation import Cloud
from binocular_recon.stereo.validity import Validity
from test import bag_tools
from test.bag_tools import PERIOD_NS, START_NS, Record
from test.system.chain import OUTPUTS, prime, start_chain
from test.system.conftest import StartNode
from test.system.graph import Graph, executable, wait_until
from test.system.rig import SIDES, CameraPair, header, image_pair, raw_rig

# covers offsets of the principal points from -32.8 to +32.8 px
RANGE = {'min_disparity': -32, 'disparity_range': 88}
CONFIG = ChainConfig.preset('default', **RANGE)
# frame: how the cameras send it, and their cx_left - cx_right
FRAMES = [
    ('mono8', -32.8),
    ('bgr8', 0.0),
    ('rgb8', 32.8),
    ('mono16', -3.2),
    ('bayer_rggb8', -3.2),
    ('yuv422', -3.2),
    ('32FC1', 32.8),
    ('bgra8', 32.8),
]


def camera_message(bgr: np.ndarray, encoding: str, index: int, side: str) -> Image:
    """Return an image of a camera in an encoding."""
    grey = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
    message = Image(header=header(index, side), encoding=encoding)
    message.height, message.width = grey.shape
    images = {
        'mono8': grey,
        'bayer_rggb8': grey,
        'bgr8': bgr,
        'rgb8': bgr[..., ::-1],
        'bgra8': np.dstack([bgr, np.full_like(grey, 255)]),
        'mono16': grey.astype(np.uint16) * 200,
        '32FC1': (grey / 255).astype(np.float32),
        'yuv422': np.dstack([np.full_like(grey, 128), grey]),
    }
    image = np.ascontiguousarray(images[encoding])
    if encoding == '32FC1':
        image[20:24, 30:60] = np.nan
    message.step = image.strides[0]
    message.data = image.tobytes()
    return message


Frame = tuple[dict[str, Any], Reconstruction, Chain]


@pytest.fixture(scope='module', params=['false', 'true'], ids=['apart', 'composed'])
def nodes(start_node: StartNode, request: Any) -> Iterator[str]:
    """Start the chain, as separate nodes and as one, and return the name of the filter's node."""
    arguments = {name: str(value) for name, value in RANGE.items()}
    started = start_chain(start_node, **arguments, composed=request.param)
    assert len(started) == (1 if request.param == 'true' else 3)
    yield '/rig/stereo_node' if request.param == 'true' else '/rig/wls_filter_node'
    for node in started:  # the next ones are to be alone
        assert node.stop() == 0


@pytest.fixture(scope='module')
def frames(graph: Graph, nodes: str) -> Iterator[list[Frame]]:  # noqa: ARG001 - they run meanwhile
    """Send all frames and return, of each, the messages and what the offline chain makes."""
    cameras = CameraPair(graph, raw_rig())
    topics = [(f'/rig/{topic}', kind) for topic, kind in OUTPUTS.items()]
    done = []
    with graph.listening(*topics) as inboxes:
        graph.wait_for_subscriber(*cameras.topics)
        prime(cameras, inboxes)
        for index, (encoding, offset_px) in enumerate(FRAMES):
            cameras.rig = raw_rig(offset_px)
            images = [
                camera_message(image, encoding, index, side)
                for image, side in zip(
                    image_pair(index, colour=True), ('left', 'right'), strict=True
                )
            ]
            cameras.send(index, (None, None), left_image=images[0], right_image=images[1])
            messages = {
                topic: inbox.wait(index + 1)[index]
                for topic, inbox in zip(OUTPUTS, inboxes, strict=True)
            }
            chain = Chain(cameras.rig, CONFIG)
            done.append((messages, chain(*(read_image(image).image for image in images)), chain))
        yield done


def values(message: Image) -> np.ndarray:
    return np.frombuffer(message.data, np.float32).reshape(message.height, message.width)


def test_headers(frames: list[Frame]) -> None:
    for index, (messages, _, _) in enumerate(frames):
        for topic, message in messages.items():
            side = 'right' if topic.startswith('right') else 'left'
            assert message.header == header(index, side), topic


def test_rectified_images(frames: list[Frame]) -> None:
    for (messages, expected, _), (encoding, _) in zip(frames, FRAMES, strict=True):
        kept = 'bgr8' if encoding in ('bayer_rggb8', 'yuv422') else encoding
        for side, image in (('left', expected.left), ('right', expected.right)):
            message = messages[f'{side}/image_rect']
            assert message.encoding == kept
            np.testing.assert_array_equal(read_image(message).image, image)


def test_rectified_cameras(frames: list[Frame]) -> None:
    for messages, _, chain in frames:
        for side, camera in (('left', chain.rig.left), ('right', chain.rig.right)):
            message = messages[f'{side}/camera_info_rect']
            assert (message.distortion_model, list(message.d)) == ('plumb_bob', [0.0] * 5)
            np.testing.assert_array_equal(message.k.reshape(3, 3), camera.P[:, :3])
            np.testing.assert_array_equal(message.r.reshape(3, 3), np.eye(3))
            np.testing.assert_array_equal(message.p.reshape(3, 4), camera.P)
            assert not any((message.roi.width, message.roi.height, message.binning_x))
        depth_camera = camera_from_message(messages['depth/camera_info'])
        np.testing.assert_array_equal(depth_camera.P, chain.rig.left.P)


def test_every_matched_disparity(frames: list[Frame]) -> None:
    for (messages, expected, chain), (encoding, _) in zip(frames, FRAMES, strict=True):
        read = read_disparity(messages['disparity'], chain.rig)
        # equal_nan: the same pixels are valid
        np.testing.assert_allclose(read.disparity_px, expected.matched.disparity_px, atol=1e-3)
        np.testing.assert_array_equal(values(messages['confidence']), expected.matched.confidence)
        step_px = disparity_step_px(CONFIG.match)
        assert messages['disparity'].delta_d == pytest.approx(step_px)
        valid = np.isfinite(read.disparity_px)
        assert 0.4 < valid.mean() < 1, encoding
        if encoding == '32FC1':
            assert not valid[20:22, 36:54].any()


def test_every_filtered_disparity(frames: list[Frame]) -> None:
    for messages, expected, chain in frames:
        message = messages['disparity_wls']
        read = read_disparity(message, chain.rig)
        np.testing.assert_allclose(read.disparity_px, expected.filtered.disparity_px, atol=1e-3)
        shifted = values(message.image)
        assert (shifted > message.min_disparity).all() and (shifted < message.max_disparity).all()


def test_validity_is_that_of_the_offline_chain(frames: list[Frame]) -> None:
    """Also why a pixel was not measured, which the matcher knows and the filter publishes."""
    seen = 0
    for messages, expected, _ in frames:
        for topic, validity in (
            ('match_validity', expected.matched.validity),
            ('validity', expected.filtered.validity),
        ):
            assert messages[topic].encoding == 'mono8'
            np.testing.assert_array_equal(read_image(messages[topic]).image, validity)
        seen |= int(np.bitwise_or.reduce(expected.filtered.validity, axis=None))
    reasons = Validity.CONFLICT | Validity.AMBIGUOUS | Validity.NO_DATA
    assert seen & reasons == reasons


def test_messages_decode_by_the_published_definition(frames: list[Frame]) -> None:
    """Z = f T / d with the message's own numbers is the cloud's z, whatever the offset."""
    for (messages, _, _), (_, offset_px) in zip(frames, FRAMES, strict=True):
        message, z = messages['disparity_wls'], values(messages['depth'])
        assert message.min_disparity == pytest.approx(RANGE['min_disparity'] - offset_px, abs=1e-4)
        near = z < 1000  # beyond, float32 does not hold 1e-4 of a disparity
        assert near.mean() > 0.6
        depth = message.f * message.t / values(message.image)
        np.testing.assert_allclose(depth[near], z[near], rtol=1e-4)


def test_points(frames: list[Frame]) -> None:
    layout = np.dtype(
        {
            'names': ['xyz', 'rgb', 'sigma_z'],
            'formats': ['(3,)<f4', '(3,)u1', '<f4'],
            'offsets': [0, 16, 20],
            'itemsize': 32,
        }
    )
    for messages, expected, _ in frames:
        message = messages['points2']
        shape = expected.cloud.sigma_z_m.shape
        assert (message.height, message.width) == shape
        points = np.frombuffer(message.data, layout).reshape(shape)
        np.testing.assert_allclose(points['xyz'], expected.cloud.points_xyz, rtol=1e-3)
        np.testing.assert_allclose(points['sigma_z'], expected.cloud.sigma_z_m, rtol=1e-2)
        np.testing.assert_array_equal(points['rgb'], to_bgr8(expected.left))
        np.testing.assert_array_equal(values(messages['depth']), points['xyz'][..., 2])
        assert message.is_dense == bool(np.isfinite(points['xyz']).all())


def test_heat_map(frames: list[Frame]) -> None:
    for messages, expected, _ in frames:
        message = messages['disparity_color']
        assert message.encoding == 'bgr8'
        drawn = heat_map(expected.filtered.disparity_px, CONFIG.match.limits_px)
        difference = np.abs(read_image(message).image.astype(int) - drawn)
        assert np.mean(difference.max(axis=-1) > 8) < 0.01  # 1e-3 px may change a colour's step


def test_frames_come_once(frames: list[Frame]) -> None:
    stamps = [stamp_ns(messages['disparity_wls'].header) for messages, _, _ in frames]
    assert stamps == sorted(set(stamps)) and len(stamps) == len(FRAMES)


@pytest.mark.usefixtures('frames')
def test_status_states_the_accuracy_of_the_solution(graph: Graph, nodes: str) -> None:
    def solution() -> dict[str, str]:
        status = graph.status(nodes)
        values = {pair.key: pair.value for pair in status.values} if status else {}
        return {key: values[key] for key in ('iterations', 'estimated error') if key in values}

    wait_until(lambda: len(solution()) == 2, 'iterations and estimated error')
    assert 1 <= int(solution()['iterations']) < 100
    assert (
        0
        <= float(solution()['estimated error'].removesuffix(' px'))
        <= CONFIG.filter.wls_tolerance_px
    )


@pytest.mark.usefixtures('frames')
def test_cloud_options_change_while_the_node_runs(graph: Graph, nodes: str) -> None:
    cameras = CameraPair(graph, raw_rig())
    limits = {'min_depth': 2.5, 'max_depth': 4.0}
    layouts = {(True, True): (20, 'x y z rgb sigma_z'), (False, False): (16, 'x y z sigma_z')}
    with graph.listening(('/rig/points2', PointCloud2)) as (inbox,):
        for count, ((colour, tight), (step, names)) in enumerate(layouts.items(), 1):
            options = {'use_color': colour, 'avoid_point_cloud_padding': tight, **limits}
            assert graph.set_parameters(nodes, **options) == ''
            cameras.send(len(FRAMES) + count, image_pair(1))
            message = inbox.wait(count)[-1]
            assert [field.name for field in message.fields] == names.split()
            assert message.point_step == step
            z = np.frombuffer(message.data, np.float32).reshape(-1, step // 4)[:, 2]
            assert 0.2 < np.isfinite(z).mean() < 0.95 and not message.is_dense
            assert np.nanmin(z) >= 2.5 and np.nanmax(z) <= 4.0


@pytest.mark.usefixtures('frames')
def test_thinned_clouds(graph: Graph, nodes: str) -> None:
    """Those of the whole cloud; the depth image keeps its size."""
    cameras = CameraPair(graph, raw_rig())
    pair = image_pair(1)
    chain = Chain(cameras.rig, CONFIG)
    validity = chain(*pair).filtered.validity
    points: tuple[str, type[Any]] = ('/rig/points2', PointCloud2)
    limits = {'min_depth': 0.0, 'max_depth': 1e6, 'use_color': False}
    with graph.listening(points, ('/rig/depth', Image)) as (clouds, depths):
        found = []
        for count, (decimation, voxel_size) in enumerate(((1, 0.0), (3, 0.0), (2, 0.1)), 1):
            options = {'decimation': decimation, 'voxel_size': voxel_size}
            assert graph.set_parameters(nodes, **options, **limits) == ''
            cameras.send(len(FRAMES) + 10 + count, pair)
            message, depth = clouds.wait(count)[-1], depths.wait(count)[-1]
            assert (depth.height, depth.width) == validity.shape
            values = np.frombuffer(message.data, np.float32)
            values = values.reshape(message.height, message.width, 4)
            found.append(values)
            whole = Cloud(found[0][..., :3], found[0][..., 3:])
            assert np.isfinite(whole.depth_m).mean() > 0.6
            expected = thin(
                PointSet(whole, validity),
                CloudConfig(decimation=decimation, voxel_size=voxel_size),
            ).cloud
            np.testing.assert_array_equal(values[..., :3], expected.points_xyz)
            np.testing.assert_array_equal(values[..., 3:], expected.sigma_m)
    assert found[2].shape[0] == 1 and found[2].shape[1] < found[1].size


def record(path: Path, count: int) -> Path:
    """Record what the cameras of `raw_rig` would publish."""
    records: list[Record] = []
    for index in range(count):
        stamp = START_NS + index * PERIOD_NS
        for side, camera, image in zip(
            SIDES,
            (raw_rig().left, raw_rig().right),
            image_pair(index, colour=True),
            strict=True,
        ):
            infos, images = f'/rig/{side}/camera_info', f'/rig/{side}/image_raw'
            records.append((infos, bag_tools.info_message(camera, stamp), stamp))
            records.append((images, bag_tools.image_message(image, stamp), stamp))
    return bag_tools.write_bag(path, records)


@pytest.mark.usefixtures('frames')
def test_a_bag_that_is_played_gives_what_it_gives_offline(graph: Graph, tmp_path: Path) -> None:
    """It loops, for a busy node may drop a pair; every message that comes is compared."""
    path = record(tmp_path / 'bag', 3)
    expected: dict[int, Reconstruction] = {}
    with Bag(path) as bag:
        for pair in StereoBag(bag, find_stereo_topics(bag.topics)):
            chain = Chain(pair.rig, CONFIG)
            expected[pair.stamp_ns] = chain(*pair.images())
    assert len(expected) == 3
    topics = [(f'/rig/{topic}', OUTPUTS[topic]) for topic in ('disparity', 'disparity_wls')]
    with graph.listening(*topics) as inboxes:
        play = subprocess.Popen([executable('play_bag'), str(path), '--loop', '--rate', '0.5'])
        try:
            wait_until(
                lambda: all(x.by_stamp().keys() == expected.keys() for x in inboxes), 'all frames'
            )
        finally:
            play.send_signal(signal.SIGINT)
            status = play.wait(20)
        assert status == 130
        measured, filtered = inboxes
    for message in measured.messages:
        read = read_disparity(message, chain.rig).disparity_px
        offline = expected[stamp_ns(message.header)].matched.disparity_px
        np.testing.assert_allclose(read, offline, atol=1e-3)  # NaN where that is NaN
    for message in filtered.messages:
        read = read_disparity(message, chain.rig).disparity_px
        offline = expected[stamp_ns(message.header)].filtered.disparity_px
        np.testing.assert_allclose(read, offline, atol=1e-3)
