# SPDX-License-Identifier: Apache-2.0
"""Rod calibration in the field: `calibration_node`, with images in shared memory.

Without an argument every option keeps its node's default; see `ros2 launch --show-args`. The
process of the cameras needs the same Fast DDS profile.
"""

from __future__ import annotations

import dataclasses
import runpy
from pathlib import Path
from typing import Any

import yaml
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

from binocular_recon.nodes.runtime.options import InputOptions, RodOptions

# What launch files share: how options become arguments, and the profile of DDS.
CHAIN = runpy.run_path(str(Path(__file__).with_name('binocular_recon.launch.py')))
ARGUMENTS = {
    name: CHAIN['ARGUMENTS'][name]
    for name in (
        'namespace',
        'left_namespace',
        'left_image',
        'right_namespace',
        'right_image',
        'params_file',
        'use_sim_time',
        'dds_profile',
    )
}
SPECS = [spec for group in (RodOptions, InputOptions) for spec in dataclasses.fields(group)]


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and start the node."""
    arguments = ARGUMENTS | {spec.name: ('', CHAIN['_describe'](spec)) for spec in SPECS}
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in arguments.items()
            ),
            OpaqueFunction(function=_start),
        ]
    )


def _start(context: LaunchContext) -> list[Any]:
    """Return the node with the arguments that were given."""
    given = {name: value for name, value in context.launch_configurations.items() if value}
    values = {
        spec.name: CHAIN['_value'](spec, given[spec.name]) for spec in SPECS if spec.name in given
    }
    values['use_sim_time'] = yaml.safe_load(given.get('use_sim_time', 'false'))
    files = [given['params_file']] if 'params_file' in given else []
    node = Node(
        package='binocular_recon',
        executable='calibration_node',
        namespace=given.get('namespace', '').strip('/'),
        parameters=[*files, values],
        remappings=_remappings(given),
        output='screen',
    )
    return [*CHAIN['_profile'](given), node]


def _remappings(given: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the topics and services of the cameras whose names differ from those of the node."""
    topics = CHAIN['_topics'](given, rectify=True)
    images = [f'{side}/image_raw' for side in CHAIN['SIDES']]
    names = [(name, topics[name]) for name in images if name in topics]
    for side in CHAIN['SIDES']:
        folder = given.get(f'{side}_namespace', side).rstrip('/')
        if folder != side:
            names.append((f'{side}/set_camera_info', f'{folder}/set_camera_info'))
    return names
