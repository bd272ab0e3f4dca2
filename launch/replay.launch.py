# SPDX-License-Identifier: Apache-2.0
"""Play a bag into the whole chain; takes the arguments of the chain as well."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

CHAIN = Path(__file__).with_name('binocular_recon.launch.py')
ARGUMENTS = {
    'bag': (None, 'Bag to play: ROS 1, ROS 2 sqlite3 or mcap'),
    'rate': ('1.0', 'Speed as a multiple of that of the recording'),
    'loop': ('false', 'Start again at the end, until interrupted'),
    'clock': ('true', 'Publish the time of recording as /clock and make the nodes use it'),
}


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments, start the player and the chain."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            # Not in `_start_player`, so that `--show-args` lists the chain's arguments too.
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(str(CHAIN)),
                launch_arguments={'use_sim_time': LaunchConfiguration('clock')}.items(),
            ),
            OpaqueFunction(function=_start_player),
        ]
    )


def _start_player(context: LaunchContext) -> list[Any]:
    given = context.launch_configurations
    switches = [f'--{name}' for name in ('loop', 'clock') if yaml.safe_load(given[name])]
    return [
        Node(
            package='binocular_recon',
            executable='play_bag',
            arguments=[given['bag'], '--rate', given['rate'], *switches],
            output='screen',
        ),
    ]
