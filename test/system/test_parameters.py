# SPDX-License-Identifier: Apache-2.0
"""Parameters of real nodes: described, limited, live, rejected with a reason."""

from __future__ import annotations

import dataclasses
import re
from functools import partial
from typing import Any
from unittest.mock import Mock

import pytest
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from stereo_msgs.msg import DisparityImage

from binocular_recon.calibration.target.rods import save_rods
from binocular_recon.config import PRESETS, MatchConfig
from binocular_recon.errors import ConfigError
from binocular_recon.nodes.registry import node_class, node_names
from binocular_recon.nodes.runtime.endpoints import Output, create_output
from binocular_recon.simulation.rods import paper_board
from binocular_recon.stereo.rectification import Rectifier
from test.system.conftest import StartNode
from test.system.graph import Graph, NodeProcess, wait_until
from test.system.rig import SIDES, CameraPair, image_pair, raw_rig

TYPES = {
    bool: ParameterType.PARAMETER_BOOL,
    int: ParameterType.PARAMETER_INTEGER,
    float: ParameterType.PARAMETER_DOUBLE,
    str: ParameterType.PARAMETER_STRING,
}


CHAIN = ('rectify_node', 'match_node', 'wls_filter_node')


@pytest.fixture(scope='module', autouse=True)
def _nodes(start_node: StartNode, tmp_path_factory: pytest.TempPathFactory) -> None:
    start_node('rectify_node')
    # window and range are explicit, the range as a whole number for a float option
    start_node(
        'match_node',
        correlation_window_size=11,
        speckle_range=2,
        disparity_range=32,
        image_transport='compressed',
        **{
            'qos_overrides./rig/right/image_rect/compressed.subscription.reliability': 'reliable',
            'qos_overrides./rig/confidence.publisher.reliability': 'best_effort',
        },
    )
    start_node('wls_filter_node', preset='paper')
    folder = tmp_path_factory.mktemp('calibration')
    save_rods(paper_board(), folder / 'rods.yaml')
    required = {'calibration_node': {'rods': folder / 'rods.yaml', 'output': folder}}
    for name in set(node_names()) - set(CHAIN):
        start_node(name, namespace='/others', **required.get(name, {}))


@pytest.mark.parametrize('name', node_names())
def test_every_option_is_described(graph: Graph, name: str) -> None:
    node, namespace = node_class(name), '/rig' if name in CHAIN else '/others'
    groups = [(group, False) for group in node.LIVE] + [(group, True) for group in node.FIXED]
    specs = {s.name: (s, fixed) for group, fixed in groups for s in dataclasses.fields(group)}  # type: ignore[arg-type]
    request = DescribeParameters.Request(names=list(specs))
    answer = graph.call(f'{namespace}/{name}/describe_parameters', DescribeParameters, request)
    for descriptor, (spec, fixed) in zip(answer.descriptors, specs.values(), strict=True):
        meta = spec.metadata
        assert descriptor.type == TYPES[type(spec.default)], spec.name
        assert meta['description'] in descriptor.description and meta['unit'] in (
            descriptor.description
        )
        assert descriptor.read_only == fixed and not descriptor.dynamic_typing
        ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
        if meta['minimum'] is not None:
            assert (ranges[0].from_value, ranges[0].to_value) == (meta['minimum'], meta['maximum'])
        for choice in meta['choices'] or ():
            assert choice in descriptor.additional_constraints


@pytest.mark.parametrize(
    ('node', 'values', 'reason'),
    [
        ('match_node', {'preset': 'fastest'}, "preset must be one of paper, .*got 'fastest'"),
        ('match_node', {'texture_threshold': -1.0}, 'texture_threshold.*out of range'),
        ('match_node', {'correlation_window_size': 8}, 'correlation_window_size.*step'),
        ('match_node', {'uniqueness_ratio': float('nan')}, 'uniqueness_ratio out of range'),
        ('match_node', {'disparity_range': 'wide'}, 'wrong parameter type'),
        ('match_node', {'queue_size': 9}, 'read-only'),
        ('rectify_node', {'alpha': -0.5}, r'alpha must be -1 or within 0\.\.1, got -0\.5'),
        (
            'wls_filter_node',
            {'min_depth': 9.0, 'max_depth': 5.0},
            'min_depth must be at most max_depth, got 9 m and 5 m',
        ),
        ('wls_filter_node', {'wls_guide': 'right'}, 'wls_guide must be one of left, disparity'),
    ],
)
def test_a_bad_value_is_rejected_with_the_reason(
    graph: Graph, node: str, values: dict[str, Any], reason: str
) -> None:
    names = list(values)
    before = graph.get_parameters(f'/rig/{node}', *names, 'image_transport')
    rejection = graph.set_parameters(f'/rig/{node}', **values)
    assert re.search(reason, rejection, re.IGNORECASE), rejection
    assert graph.get_parameters(f'/rig/{node}', *names, 'image_transport') == before


def test_one_bad_value_rejects_all(graph: Graph) -> None:
    names = ('min_disparity', 'disp12_max_diff')
    before = graph.get_parameters('/rig/match_node', *names)
    reason = graph.set_parameters('/rig/match_node', min_disparity=4, disp12_max_diff=500.0)
    assert 'disp12_max_diff' in reason
    assert graph.get_parameters('/rig/match_node', *names) == before


def test_explicit_values_survive_a_change_of_preset(graph: Graph) -> None:
    node = '/rig/match_node'
    names = ('correlation_window_size', 'speckle_range', 'disp12_max_diff', 'texture_threshold')
    default = MatchConfig()
    assert graph.get_parameters(node, *names) == [
        11,
        2.0,
        default.disp12_max_diff,
        default.texture_threshold,
    ]
    assert graph.set_parameters(node, texture_threshold=3) == ''  # set while the node runs
    assert graph.set_parameters(node, preset='paper') == ''
    paper = PRESETS['paper']
    assert graph.get_parameters(node, *names) == [11, 2.0, paper['disp12_max_diff'], 3.0]
    assert graph.set_parameters(node, preset='default') == ''
    assert graph.get_parameters(node, *names) == [11, 2.0, default.disp12_max_diff, 3.0]


def test_preset_given_at_the_start(graph: Graph) -> None:
    paper = PRESETS['paper']
    names = ('wls_lambda', 'wls_alpha', 'wls_use_confidence')
    values = graph.get_parameters('/rig/wls_filter_node', *names)
    assert values == [paper[name] for name in names]


def test_live_change_shows_in_the_next_frame(graph: Graph) -> None:
    rectify = Rectifier(raw_rig())
    images = rectify(*image_pair(2))
    cameras = CameraPair(graph, rectify.rig, image='image_rect', compressed=True)
    with graph.listening(('/rig/disparity', DisparityImage)) as (inbox,):
        graph.wait_for_subscriber(*cameras.topics)
        for index, low in enumerate((0, 6)):
            assert graph.set_parameters('/rig/match_node', min_disparity=low) == ''
            cameras.send(index, images)
            message = inbox.wait(index + 1)[index]
            offset_px = rectify.rig.disparity_offset_px
            assert message.min_disparity == pytest.approx(low - offset_px)
            assert message.max_disparity == pytest.approx(low + 31 - offset_px)


def test_quality_of_service_is_that_of_the_sensors_unless_overridden(graph: Graph) -> None:
    """Publishers are reliable, subscriptions best effort, except where overridden."""

    def subscriptions(side: str) -> list[Any]:
        topic = f'/rig/{side}/image_rect/compressed'
        found = graph.node.get_subscriptions_info_by_topic(topic)
        return [one.qos_profile for one in found if one.node_name == 'match_node']

    with graph.listening(('/rig/disparity', DisparityImage)):
        left, right = (
            wait_until(partial(subscriptions, side), f'match_node to subscribe to {side}')[0]
            for side in SIDES
        )
    assert left.reliability == ReliabilityPolicy.BEST_EFFORT
    assert right.reliability == ReliabilityPolicy.RELIABLE
    for node in map(node_class, CHAIN):
        for output in node.OUTPUTS:
            for offered in graph.node.get_publishers_info_by_topic(f'/rig/{output.topic}'):
                if offered.node_name == node.NAME:
                    assert (offered.qos_profile.reliability == ReliabilityPolicy.RELIABLE) == (
                        output.topic != 'confidence'
                    )
                    assert offered.qos_profile.durability == DurabilityPolicy.VOLATILE


@pytest.mark.parametrize(
    ('executable', 'parameters', 'reason'),
    [
        ('match_node', {'disparity_range': 1}, 'disparity_range must be within 2..4096 px, or 0'),
        ('rectify_node', {'calibration': '/nowhere'}, '/nowhere/left.yaml cannot be read'),
        (
            'match_node',
            {'qos_overrides./rig/left/image_rect.subscription.reliability': 'always'},
            'input left/image_rect: .*always',
        ),
    ],
)
def test_bad_value_at_the_start_ends_the_node(
    tmp_path: Any, executable: str, parameters: dict[str, object], reason: str
) -> None:
    node = NodeProcess(executable, tmp_path / 'log', **parameters)
    wait_until(lambda: node.process.poll() is not None, 'end of the node')
    assert node.process.returncode == 1
    assert re.search(reason, node.text()), node.text()
    assert 'Traceback' not in node.text()


def test_a_bad_qos_override_of_a_publisher_is_reported(graph: Graph) -> None:
    name = 'qos_overrides./rig/disparity.publisher.reliability'
    arguments = ['--ros-args', '-p', f'{name}:=always']
    node = Node('own', namespace='/rig', context=graph.context, cli_args=arguments)
    try:
        with pytest.raises(ConfigError, match=r'output disparity: .*always'):
            create_output(node, Output('disparity', DisparityImage), Mock(), Mock())
    finally:
        node.destroy_node()
