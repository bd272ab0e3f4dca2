# SPDX-License-Identifier: Apache-2.0
"""The whole chain, rectify, match and filter: raw images in, point cloud out.

One node does it all (`stereo_node`), or with ``composed:=false`` one for each step.

Without an argument every option keeps its node's default, but clouds have no padding; see
`ros2 launch --show-args`.
"""

from __future__ import annotations

import dataclasses
import itertools
import os
from pathlib import Path
from typing import Any

import yaml
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch_ros.actions import Node

from binocular_recon.cloud_config import CloudConfig
from binocular_recon.config import FilterConfig, MatchConfig
from binocular_recon.errors import ConfigError
from binocular_recon.inputs.options import ImageConfig
from binocular_recon.nodes.runtime.options import (
    CalibrationOptions,
    CloudMessageOptions,
    DepthBoundOptions,
    FrameOptions,
    InputOptions,
    LoadOptions,
    PresetOptions,
    QueueOptions,
    RectifyOptions,
)
from binocular_recon.options import Options, OptionValue, check_option

SHARE = Path(__file__).resolve().parents[1]
SIDES = ('left', 'right')
RECTIFIER, COMPOSED = 'rectify_node', 'stereo_node'
# Options of each separate node that are launch arguments. Only the first receives and pairs images
# of the cameras: what it publishes carries one stamp. In the last images wait for disparities.
OPTIONS: dict[str, tuple[type[Options], ...]] = {
    RECTIFIER: (InputOptions, CalibrationOptions, RectifyOptions, FrameOptions, LoadOptions),
    'match_node': (PresetOptions, MatchConfig, DepthBoundOptions, ImageConfig, LoadOptions),
    'wls_filter_node': (
        PresetOptions,
        QueueOptions,
        FilterConfig,
        CloudConfig,
        CloudMessageOptions,
        ImageConfig,
        CalibrationOptions,
        LoadOptions,
    ),
}
# Defaults that differ from those of the nodes, which are image_pipeline's: a cloud without unused
# bytes is 20 instead of 32 bytes a point. A params_file and arguments override them.
DEFAULTS = {'avoid_point_cloud_padding': True}
# Messages between the nodes must not be lost: reliable, whatever the cameras are.
_MEASURED = ['disparity', 'confidence', 'match_validity']
_RECTIFIED = [f'{side}/{topic}' for side in SIDES for topic in ('image_rect', 'camera_info_rect')]
RELIABLE = {
    'match_node': _RECTIFIED,
    'wls_filter_node': [*_MEASURED, 'left/image_rect', *_RECTIFIED[1::2]],
}
# Fast DDS 3 knows the first name, Fast DDS 2 (Jazzy and earlier) the second.
PROFILE_VARIABLES = ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE')
_IMAGE = (
    'Images of the {0} camera; empty: <{0}_namespace>/image_raw, image_rect with rectify:=false'
)
_INFO = 'Camera infos of the {0} camera; empty: <{0}_namespace>/camera_info'
# Arguments that are not options of a node: default and description.
ARGUMENTS = {
    'namespace': ('', 'Namespace of the rig: its topics are <namespace>/left/image_raw, ...'),
    'left_namespace': ('left', 'Namespace of the left camera and of its rectified image'),
    'right_namespace': ('right', 'Namespace of the right camera and of its rectified image'),
    'left_image': ('', _IMAGE.format('left')),
    'left_camera_info': ('', _INFO.format('left')),
    'right_image': ('', _IMAGE.format('right')),
    'right_camera_info': ('', _INFO.format('right')),
    'rectify': (
        'true',
        'Rectify the images; false: they are rectified already, and the camera infos are theirs',
    ),
    'composed': (
        'true',
        'Run the chain as one node; false: rectify_node, match_node and wls_filter_node apart',
    ),
    'params_file': ('', 'YAML file with parameters of the nodes; launch arguments override it'),
    'use_sim_time': (
        'false',
        'Take the time from /clock, as published by a bag player or a simulator',
    ),
    'rviz': ('false', 'Start RViz with the point cloud and the images'),
    'rviz_frame': (
        'camera_left_optical',
        'Fixed frame of RViz: the optical frame of the left camera',
    ),
    'dds_profile': (
        str(SHARE / 'config' / 'fastdds_shared_memory.xml'),
        'Fast DDS profile with shared memory for images; empty: do not change DDS',
    ),
}


def _profile(given: dict[str, Any]) -> list[Any]:
    """Return the action that selects the DDS profile, none if there is one already."""
    profile = given.get('dds_profile')
    if not profile or any(name in os.environ for name in PROFILE_VARIABLES):
        return []
    older = os.environ.get('ROS_DISTRO') in ('humble', 'iron', 'jazzy')
    return [SetEnvironmentVariable(PROFILE_VARIABLES[older], profile)]


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and start the nodes."""
    arguments = dict(ARGUMENTS)
    for groups in OPTIONS.values():
        for spec in (spec for group in groups for spec in dataclasses.fields(group)):
            arguments[spec.name] = '', _describe(spec)
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in arguments.items()
            ),
            OpaqueFunction(function=_start),
        ]
    )


def _describe(spec: dataclasses.Field[Any]) -> str:
    meta = spec.metadata
    unit = f' [{meta["unit"]}]' if meta['unit'] else ''
    choices = f' ({", ".join(meta["choices"])})' if meta['choices'] else ''
    source = 'empty: value from params_file, the preset or the node'
    if spec.name in DEFAULTS:
        source = f'empty: value from params_file, else {str(DEFAULTS[spec.name]).lower()}'
    return f'{meta["description"]}{unit}{choices}; {source}'


def _start(context: LaunchContext) -> list[Any]:
    """Return the nodes with the arguments that were given."""
    given = {name: value for name, value in context.launch_configurations.items() if value}
    switched = {
        name: yaml.safe_load(given.get(name, ARGUMENTS[name][0]))
        for name in ('use_sim_time', 'rviz', 'rectify', 'composed')
    }
    options = _options(given, rectify=switched['rectify'], composed=switched['composed'])
    topics = _topics(given, rectify=switched['rectify'])
    actions = _profile(given)
    namespace = given.get('namespace', '').strip('/')
    for executable, groups in options.items():
        specs = [spec for group in groups for spec in dataclasses.fields(group)]
        values: dict[str, OptionValue] = {
            spec.name: _value(spec, given[spec.name]) for spec in specs if spec.name in given
        }
        values['use_sim_time'] = switched['use_sim_time']
        defaults = {spec.name: DEFAULTS[spec.name] for spec in specs if spec.name in DEFAULTS}
        files: list[Any] = [given['params_file']] if 'params_file' in given else []
        if executable == COMPOSED:
            files = [*(_of_separate(file, namespace) for file in files), *files]
            values['rectify'] = switched['rectify']
        elif executable != RECTIFIER and switched['rectify']:
            values['camera_info'] = 'camera_info_rect'
        for topic in RELIABLE.get(executable, []):
            if switched['rectify'] or topic in _MEASURED:
                name = _absolute(topics.get(topic, topic), namespace)
                values[f'qos_overrides.{name}.subscription.reliability'] = 'reliable'
        actions.append(
            Node(
                package='binocular_recon',
                executable=executable,
                namespace=namespace,
                parameters=[*([defaults] if defaults else []), *files, values],
                remappings=list(topics.items()),
                output='screen',
            )
        )
    if switched['rviz']:
        actions.append(
            Node(
                package='rviz2',
                executable='rviz2',
                namespace=namespace,
                arguments=[
                    *('-d', str(SHARE / 'rviz' / 'binocular_recon.rviz')),
                    *('-f', given.get('rviz_frame', ARGUMENTS['rviz_frame'][0])),
                ],
                parameters=[{'use_sim_time': switched['use_sim_time']}],
                remappings=list(topics.items()),
            )
        )
    return actions


def _options(
    given: dict[str, str], *, rectify: bool, composed: bool
) -> dict[str, tuple[type[Options], ...]]:
    """Return the options of each node to start; without rectification two receive the cameras."""
    if not rectify:
        _refuse_unused(given)
    if composed:
        every = dict.fromkeys(itertools.chain.from_iterable(OPTIONS.values()))
        return {COMPOSED: tuple(group for group in every if group is not QueueOptions)}
    if rectify:
        return OPTIONS
    return {
        name: (InputOptions, *(group for group in groups if group is not QueueOptions))
        for name, groups in OPTIONS.items()
        if name != RECTIFIER
    }


def _refuse_unused(given: dict[str, str]) -> None:
    """Raise a ConfigError if options of rectification are given, which is switched off."""
    own = (*dataclasses.fields(RectifyOptions), *dataclasses.fields(FrameOptions))
    unused = [spec.name for spec in own if spec.name in given]
    if unused:
        raise ConfigError(
            f'{", ".join(unused)}: options of rectification, which rectify:=false switches off;'
            ' omit them'
        )


def _of_separate(path: str, namespace: str) -> dict[str, Any]:
    """Return the parameters that a file has for the separate nodes, for the one in their place."""
    content = yaml.safe_load(Path(path).expanduser().read_text(encoding='utf-8')) or {}
    received = {spec.name for spec in dataclasses.fields(InputOptions)}
    values: dict[str, Any] = {}
    for name in OPTIONS:
        for key in (name, f'/**/{name}', _absolute(name, namespace)):
            section = content.get(key)
            own = section.get('ros__parameters', {}) if isinstance(section, dict) else {}
            # what the others receive are messages between the nodes
            values |= {k: v for k, v in own.items() if name == RECTIFIER or k not in received}
    return values


def _topics(given: dict[str, str], *, rectify: bool) -> dict[str, str]:
    """Return the topics of the rig whose names differ from those of the nodes."""
    topics = {}
    for side in SIDES:
        folder = given.get(f'{side}_namespace', side).rstrip('/')
        for name in ('image_raw', 'camera_info', 'image_rect', 'camera_info_rect'):
            topics[f'{side}/{name}'] = f'{folder}/{name}'
        image = f'{side}/image_raw' if rectify else f'{side}/image_rect'
        for topic, argument in ((image, 'image'), (f'{side}/camera_info', 'camera_info')):
            topics[topic] = given.get(f'{side}_{argument}', topics[topic])
    return {topic: name for topic, name in topics.items() if topic != name}


def _absolute(topic: str, namespace: str) -> str:
    """Return the full name of a topic of the rig."""
    if topic.startswith('/'):
        return topic
    return f'/{namespace}/{topic}' if namespace else f'/{topic}'


def _value(spec: dataclasses.Field[Any], text: str) -> OptionValue:
    """Return an argument as the type of its option, or raise a ConfigError."""
    kind = type(spec.default)
    try:
        # YAML reads 1e-5 as text and a folder named 2026 as a number
        value = yaml.safe_load(text) if kind is bool else kind(text)
    except (ValueError, yaml.YAMLError):
        value = text
    return check_option(spec, value)
