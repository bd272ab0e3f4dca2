# SPDX-License-Identifier: Apache-2.0
"""Launch files and parameter files agree with what the nodes declare."""

from __future__ import annotations

import dataclasses
import importlib.util
import runpy
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from binocular_recon.errors import ConfigError
from binocular_recon.options import check_option
from test.conftest import REPOSITORY
from test.launch_tools import CHAIN, REPLAY, Node, SetEnvironmentVariable, launched, launched_nodes

CALIBRATION = REPOSITORY / 'launch' / 'calibration.launch.py'
pytestmark = pytest.mark.ros
SIDES = ('left', 'right')
SEPARATE = ('rectify_node', 'match_node', 'wls_filter_node')


@pytest.fixture(autouse=True)
def _no_profile(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE'):
        monkeypatch.delenv(name, raising=False)


def nodes() -> dict[str, Any]:
    """Return the classes of the nodes of the chain by name, those apart in its order."""
    from binocular_recon.nodes.registry import node_class

    return {name: node_class(name) for name in (*SEPARATE, 'stereo_node')}


def options(node: Any) -> dict[str, Any]:
    groups = [*node.LIVE, *node.FIXED]
    return {spec.name: spec for group in groups for spec in dataclasses.fields(group)}


def test_every_argument_is_described_and_is_an_option_of_a_node() -> None:
    own = {'namespace', 'params_file', 'use_sim_time', 'rviz', 'rviz_frame', 'dds_profile'}
    own |= {f'{side}_{kind}' for side in SIDES for kind in ('namespace', 'image', 'camera_info')}
    arguments, _ = launched(CHAIN)
    declared = {name for node in nodes().values() for name in options(node)}
    # the launch file sets these itself, by whether it rectifies
    assert set(arguments) - own - {'rectify', 'composed'} == declared - {'camera_info', 'rectify'}
    assert all(len(argument.description) > 15 for argument in arguments.values())
    arguments, _ = launched(REPLAY, bag='some.bag')
    assert set(arguments) == {'bag', 'rate', 'loop', 'clock'}
    assert arguments['bag'].default_value is None  # it must be given
    assert all(len(argument.description) > 15 for argument in arguments.values())


def resolved(node: Any, topic: str) -> str:
    """Return the full name of a topic as ROS resolves it."""
    name = dict(node.remappings).get(topic, topic)
    return name if name.startswith('/') else '/'.join(['', *filter(None, [node.namespace, name])])


def check_wiring(node: Any, offered: set[str]) -> set[str]:
    """Check QoS and namespace of a node; return the full names of its inputs and outputs."""
    declared = nodes()[node.executable]
    parameters = node.parameters[-1]
    chosen = parameters.get('camera_info', 'camera_info')
    topics = [one.topic for one in declared.INPUTS]
    if node.executable != 'rectify_node':
        topics = [topic.replace('camera_info', chosen) for topic in topics]
    inputs = {resolved(node, topic) for topic in topics}
    # what an earlier node publishes is reliable, what the cameras publish is not touched
    between = {f'qos_overrides.{name}.subscription.reliability' for name in inputs & offered}
    assert {name for name in parameters if name.startswith('qos')} == between
    assert all(parameters[name] == 'reliable' for name in between)
    offered |= {resolved(node, one.topic) for one in declared.OUTPUTS}
    return inputs


@pytest.mark.parametrize('namespace', ['', 'rig', '/robot/rig/'])
def test_nodes_are_wired_to_each_other(namespace: str) -> None:
    started = launched_nodes(namespace=namespace, composed='false')
    assert tuple(node.executable for node in started) == SEPARATE
    offered: set[str] = set()
    for node in started:
        known = set(offered)
        inputs = check_wiring(node, offered)
        assert node.executable == 'rectify_node' or inputs <= known
        assert (node.package, node.namespace) == ('binocular_recon', namespace.strip('/'))


def test_cameras_with_other_topics() -> None:
    """Those of the arguments, else those of image_pipeline's namespaces of the cameras."""
    given = {
        'left_image': '/cam0/image',
        'left_camera_info': 'cam0/info',
        'right_namespace': '/cams/right/',
        'right_camera_info': '/cam1/info',
    }
    rectify, match, wls = launched_nodes(namespace='rig', composed='false', **given)
    offered: set[str] = set()
    assert check_wiring(rectify, offered) == {
        *('/cam0/image', '/rig/cam0/info', '/cams/right/image_raw', '/cam1/info'),
    }
    known = set(offered)
    assert '/cams/right/image_rect' in known and '/rig/left/image_rect' in known
    for node in (match, wls):
        assert check_wiring(node, offered) <= known | offered


def test_rectified_cameras_need_no_rectifier() -> None:
    """Two nodes take the cameras, so both get the options of the input."""
    given = {'left_image': 'left/image_rect_color', 'image_transport': 'compressed'}
    match, wls = launched_nodes(
        rectify='false', composed='false', approximate_sync='true', queue_size='9', **given
    )
    offered: set[str] = set()
    cameras = {'/left/image_rect_color', '/left/camera_info', '/right/camera_info'}
    assert check_wiring(match, offered) == cameras | {'/right/image_rect'}
    assert check_wiring(wls, offered) == cameras | {
        f'/{one.topic}' for one in nodes()['match_node'].OUTPUTS
    }
    for node in (match, wls):
        values = node.parameters[-1]
        assert (values['approximate_sync'], values['queue_size']) == (True, 9)
        assert values['image_transport'] == 'compressed'
    with pytest.raises(ConfigError, match=r'^alpha: options of rectification, which rectify:=fa'):
        launched(CHAIN, rectify='false', alpha='0')


def test_arguments_become_parameters_of_the_right_nodes() -> None:
    given = {
        'preset': 'paper',
        'alpha': '0',
        'disparity_range': '64',
        'max_depth': '30',
        'use_color': 'false',
        'image_transport': 'compressed',
        'queue_size': '80',
        'calibration': '/home/me/rig',
        'use_sim_time': 'true',
        'params_file': 'mine.yaml',
    }
    _, actions = launched(CHAIN, composed='false', **given)
    found = {
        action.executable: {
            name: value for name, value in action.parameters[-1].items() if 'qos' not in name
        }
        for action in actions
        if isinstance(action, Node)
    }
    assert found == {
        'rectify_node': {
            'alpha': 0,
            'image_transport': 'compressed',
            'queue_size': 80,
            'calibration': '/home/me/rig',
            'use_sim_time': True,
        },
        'match_node': {
            'preset': 'paper',
            'disparity_range': 64,
            'use_sim_time': True,
            'camera_info': 'camera_info_rect',
        },
        'wls_filter_node': {
            'preset': 'paper',
            'queue_size': 80,
            'max_depth': 30,
            'use_color': False,
            'calibration': '/home/me/rig',
            'use_sim_time': True,
            'camera_info': 'camera_info_rect',
        },
    }
    assert [a.parameters[:-1] for a in actions if isinstance(a, Node)] == [
        ['mine.yaml'],
        ['mine.yaml'],
        [{'avoid_point_cloud_padding': True}, 'mine.yaml'],  # what differs from the nodes' own
    ]


def test_one_node_takes_the_place_of_those_that_are_apart(tmp_path: Path) -> None:
    """It gets the arguments and the parameters of all; a section of its own comes last."""
    file = tmp_path / 'rig.yaml'
    sections = {
        '/**/rectify_node': {'alpha': 0.0, 'queue_size': 9},
        'match_node': {'disparity_range': 96, 'queue_size': 12},
        '/rig/wls_filter_node': {'queue_size': 60, 'max_depth': 40.0},
        '/other/wls_filter_node': {'min_depth': 7.0},
        '/**/stereo_node': {'min_depth': 5.0},
    }
    text = yaml.safe_dump({key: {'ros__parameters': one} for key, one in sections.items()})
    file.write_text(text)
    given = {'left_image': '/cam0/image', 'preset': 'paper', 'params_file': str(file)}
    (node,) = launched_nodes(namespace='rig', **given)
    assert node.executable == 'stereo_node' and dict(node.remappings) == {
        'left/image_raw': '/cam0/image'
    }
    defaults, of_others, whole, values = node.parameters
    assert defaults == {'avoid_point_cloud_padding': True}
    assert of_others == {
        'alpha': 0.0,
        'queue_size': 9,
        'disparity_range': 96,
        'max_depth': 40.0,
    }
    assert whole == str(file)
    assert values == {'preset': 'paper', 'use_sim_time': False, 'rectify': True}
    (node,) = launched_nodes(rectify='false', left_image='/cam0/rectified')
    assert dict(node.remappings) == {'left/image_rect': '/cam0/rectified'}
    assert node.parameters[-1]['rectify'] is False


@pytest.mark.parametrize('composed', ['true', 'false'])
def test_every_argument_reaches_its_node_with_the_type_of_its_option(composed: str) -> None:
    specs = {name: spec for node in nodes().values() for name, spec in options(node).items()}
    for name, spec in specs.items():
        if name in ('camera_info', 'rectify'):
            continue  # set by the launch file
        default = spec.default
        texts: list[tuple[str, Any]] = [(str(default), default)] if default != '' else []
        if isinstance(default, float):
            texts += [('2e-3', 0.002), ('1', 1.0)]
        if name == 'calibration':
            texts += [('2026', '2026'), ('1e3', '1e3'), ('true', 'true')]
        for text, value in texts:
            found = [
                action.parameters[-1][name]
                for action in launched(CHAIN, **{name: text}, composed=composed)[1]
                if isinstance(action, Node) and name in action.parameters[-1]
            ]
            assert found and all(type(x) is type(default) and x == value for x in found), name


@pytest.mark.parametrize(
    ('name', 'text', 'message'),
    [
        ('wls_alpha', 'much', "wls_alpha must be a number, got 'much'"),
        ('max_depth', 'nan', r'max_depth must be within 0\.0\.\.1000000\.0 m, got nan'),
        ('disparity_range', '1e2', "disparity_range must be a whole number, got '1e2'"),
        ('use_color', '2', 'use_color must be true or false, got 2'),
        ('use_color', '[', r"use_color must be true or false, got '\['"),
        ('preset', 'best', 'preset must be one of paper, fast'),
    ],
)
def test_values_that_an_option_does_not_accept_are_rejected(
    name: str, text: str, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        launched(CHAIN, **{name: text})


def test_empty_arguments_count_as_not_given() -> None:
    arguments, _ = launched(CHAIN)
    _, actions = launched(CHAIN, **dict.fromkeys(arguments, ''))
    assert [action.executable for action in actions] == ['stereo_node']
    assert all(action.parameters[-1]['use_sim_time'] is False for action in actions)
    assert launched(CHAIN, rviz='true', rviz_frame='')[1][-1].arguments[-1] == (
        arguments['rviz_frame'].default_value
    )


@pytest.mark.parametrize('path', [CHAIN, CALIBRATION])
@pytest.mark.parametrize(('distribution', 'name'), [('jazzy', 'FASTRTPS'), ('kilted', 'FASTDDS')])
def test_shared_memory_unless_the_user_has_a_profile(
    monkeypatch: pytest.MonkeyPatch, distribution: str, name: str, path: Path
) -> None:
    monkeypatch.setenv('ROS_DISTRO', distribution)
    _, actions = launched(path)
    assert isinstance(actions[0], SetEnvironmentVariable), 'before the nodes that it is for'
    (profile,) = [a.positional for a in actions if isinstance(a, SetEnvironmentVariable)]
    assert profile[0] == f'{name}_DEFAULT_PROFILES_FILE' and Path(profile[1]).is_file()
    _, actions = launched(path, dds_profile='')
    assert not any(isinstance(action, SetEnvironmentVariable) for action in actions)
    monkeypatch.setenv('FASTDDS_DEFAULT_PROFILES_FILE', 'mine.xml')
    _, actions = launched(path)
    assert not any(isinstance(action, SetEnvironmentVariable) for action in actions)


def test_rviz_shows_topics_of_the_nodes() -> None:
    _, actions = launched(CHAIN, rviz='true', rviz_frame='cam')
    rviz = actions[-1]
    assert rviz.executable == 'rviz2' and rviz.arguments[-2:] == ['-f', 'cam']
    content = yaml.safe_load(Path(rviz.arguments[1]).read_text())
    topics = {d['Topic']['Value'] for d in content['Visualization Manager']['Displays']}
    offered = {one.topic for node in nodes().values() for one in node.OUTPUTS}
    assert topics <= offered and len(topics) == 3


def test_replay_plays_into_the_chain() -> None:
    _, (chain, player) = launched(REPLAY, bag='some.bag', rate='0.5', loop='true')
    assert chain.positional[0].positional == (str(CHAIN),)
    ((name, value),) = chain.launch_arguments
    assert (name, value.positional) == ('use_sim_time', ('clock',))
    assert (player.package, player.executable) == ('binocular_recon', 'play_bag')
    assert player.arguments == ['some.bag', '--rate', '0.5', '--loop', '--clock']
    _, (chain, player) = launched(REPLAY, bag='some.bag', clock='false')
    assert player.arguments == ['some.bag', '--rate', '1.0']


def test_calibration_takes_the_options_of_its_node() -> None:
    from binocular_recon.nodes.registry import node_class

    node = node_class('calibration_node')
    own = {'namespace', 'params_file', 'use_sim_time', 'dds_profile'}
    own |= {f'{side}_{name}' for side in ('left', 'right') for name in ('namespace', 'image')}
    arguments, _ = launched(CALIBRATION)
    assert set(arguments) - own == set(options(node))
    assert all(len(argument.description) > 15 for argument in arguments.values())
    given = {
        'namespace': '/rig/',
        'rods': 'rods.yaml',
        'output': '2026',
        'approximate_sync': 'true',
        'params_file': 'mine.yaml',
    }
    (started,) = (a for a in launched(CALIBRATION, **given)[1] if isinstance(a, Node))
    assert (started.package, started.executable) == ('binocular_recon', 'calibration_node')
    assert started.remappings == []
    assert started.namespace == 'rig' and started.parameters == [
        'mine.yaml',
        {'rods': 'rods.yaml', 'output': '2026', 'approximate_sync': True, 'use_sim_time': False},
    ]
    with pytest.raises(ConfigError, match='lens must be one of'):
        launched(CALIBRATION, lens='wide')


def test_calibration_takes_cameras_with_other_topics() -> None:
    (renamed,) = (
        action
        for action in launched(
            CALIBRATION, left_namespace='/cam0/', right_image='/driver/image', rods='a', output='b'
        )[1]
        if isinstance(action, Node)
    )
    assert renamed.remappings == [
        ('left/image_raw', '/cam0/image_raw'),
        ('right/image_raw', '/driver/image'),
        ('left/set_camera_info', '/cam0/set_camera_info'),
    ]


@pytest.mark.skipif(importlib.util.find_spec('launch_ros') is None, reason='launch_ros is missing')
def test_launch_accepts_the_files(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.split('.')[0] in ('launch', 'launch_ros')]:
        monkeypatch.delitem(sys.modules, name)
    from launch import LaunchContext  # type: ignore[attr-defined]

    for path in (CHAIN, REPLAY, CALIBRATION):
        description = runpy.run_path(str(path))['generate_launch_description']()
        context = LaunchContext()
        context.launch_configurations['bag'] = 'some.bag'
        for entity in description.entities:
            entity.visit(context)


def test_parameter_files_hold_options_that_the_nodes_accept() -> None:
    checked = 0
    for path in (REPOSITORY / 'config').glob('*.yaml'):
        for key, value in yaml.safe_load(path.read_text()).items():
            if not isinstance(value, dict) or 'ros__parameters' not in value:
                continue  # not of a node
            declared = options(nodes()[key.rpartition('/')[2]])
            for name, given in value['ros__parameters'].items():
                check_option(declared[name], given)
                assert given != declared[name].default, f'{path.name}: {name} restates the default'
                checked += 1
    assert checked > 0
