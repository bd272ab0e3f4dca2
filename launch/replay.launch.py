# SPDX-License-Identifier: Apache-2.0
"""A recorded bag through the whole chain; the chain's arguments are accepted too."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import Node

CHAIN = Path(__file__).with_name('binocular_recon.launch.py')
ARGUMENTS = {
    'bag': (None, 'Bag to play: ROS 1, ROS 2 sqlite3 or mcap'),
    'rate': ('1.0', 'Speed as a multiple of that of the recording'),
    'loop': ('false', 'Begin again at the end, until interrupted'),
    'clock': ('true', 'Publish the time of recording as /clock, and let the nodes use it'),
}


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments, start the player and the chain."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            OpaqueFunction(function=_start),
        ]
    )


def _start(context: LaunchContext) -> list[Any]:
    """Return the chain and the player."""
    given = context.launch_configurations
    switches = [f'--{name}' for name in ('loop', 'clock') if yaml.safe_load(given[name])]
    return [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(CHAIN)),
            launch_arguments={'use_sim_time': given['clock']}.items(),
        ),
        Node(
            package='binocular_recon',
            executable='play_bag',
            arguments=[given['bag'], '--rate', given['rate'], *switches],
            output='screen',
        ),
    ]
