# SPDX-License-Identifier: Apache-2.0
"""What launch files start, without `launch`, which cannot be installed from a package index."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

from test.conftest import REPOSITORY

CHAIN = REPOSITORY / 'launch' / 'binocular_recon.launch.py'
REPLAY = REPOSITORY / 'launch' / 'replay.launch.py'


class Described:
    """An action of a launch file: it keeps its arguments."""

    def __init__(self, *positional: Any, **named: Any) -> None:
        self.positional = positional
        vars(self).update(named)

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)


class DeclareLaunchArgument(Described): ...


class SetEnvironmentVariable(Described): ...


class Node(Described): ...


class IncludeLaunchDescription(Described): ...


class LaunchConfiguration(Described): ...


_MEMBERS: dict[str, dict[str, Any]] = {
    'launch': {'LaunchDescription': list, 'LaunchContext': object},
    'launch.actions': {
        'DeclareLaunchArgument': DeclareLaunchArgument,
        'IncludeLaunchDescription': IncludeLaunchDescription,
        'OpaqueFunction': Described,
        'SetEnvironmentVariable': SetEnvironmentVariable,
    },
    'launch.substitutions': {'LaunchConfiguration': LaunchConfiguration},
    'launch.launch_description_sources': {'PythonLaunchDescriptionSource': Described},
    'launch_ros': {},
    'launch_ros.actions': {'Node': Node},
}


@contextmanager
def _stand_ins() -> Iterator[None]:
    hidden = {name: sys.modules.pop(name) for name in _MEMBERS if name in sys.modules}
    for name, members in _MEMBERS.items():
        sys.modules[name] = ModuleType(name)
        vars(sys.modules[name]).update(members)
    try:
        yield
    finally:
        for name in _MEMBERS:
            del sys.modules[name]
        sys.modules.update(hidden)


def launched(path: Path, **given: str) -> tuple[dict[str, Any], list[Any]]:
    """Return the arguments of a launch file by name, and what it starts with those given."""
    with _stand_ins():
        *described, start = runpy.run_path(str(path))['generate_launch_description']()
        named = {
            one.positional[0]: one for one in described if isinstance(one, DeclareLaunchArgument)
        }
        values = {name: argument.default_value for name, argument in named.items()} | given
        included = [one for one in described if isinstance(one, IncludeLaunchDescription)]
        context = SimpleNamespace(launch_configurations=values)
        return named, [*included, *start.function(context)]


def launched_nodes(**given: str) -> list[Any]:
    """Return the nodes that the chain's launch file starts."""
    return [action for action in launched(CHAIN, **given)[1] if isinstance(action, Node)]
