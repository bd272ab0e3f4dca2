# SPDX-License-Identifier: Apache-2.0
"""Imports point one way, and the library needs no ROS."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import binocular_recon

PACKAGE = Path(binocular_recon.__file__).parent
MODULES = sorted(PACKAGE.rglob('*.py'))

# A module imports from its own layer and those before it.
LAYERS = [
    {'', 'errors', 'config', 'camera', '_jit', '_simd', 'images', 'pairing'},
    {'stereo', 'calibration'},
    {'io', 'simulation', 'evaluation'},
    {'nodes', 'cli', '__main__'},
]
# What the layers up to the second, and the whole outside of nodes, must not import.
BAGS = {'rosbags'}
ROS = {
    'builtin_interfaces', 'diagnostic_msgs', 'geometry_msgs', 'rcl_interfaces', 'rclpy',
    'rosgraph_msgs', 'sensor_msgs', 'std_msgs', 'std_srvs', 'stereo_msgs', 'visualization_msgs',
}  # fmt: skip


def imports(path: Path) -> Iterator[str]:
    """Yield the full name of each module that a file imports, at its top or inside a function."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{path}: relative import'
            assert node.module is not None
            # `from package import module` and `from module import name` look the same
            yield from (f'{node.module}.{alias.name}' for alias in node.names)


def layer(name: str) -> int:
    """Return the number of the layer of module ``name``, as seen from inside the package."""
    for number, members in enumerate(LAYERS):
        if any(name == member or (member and name.startswith(f'{member}.')) for member in members):
            return number
    raise AssertionError(f'{name} belongs to no layer; add it to LAYERS')


def name_of(path: Path) -> str:
    """Return the dotted name of a module inside the package, '' for the package itself."""
    parts = path.relative_to(PACKAGE).with_suffix('').parts
    return '.'.join(part for part in parts if part != '__init__')


def test_imports_point_one_way() -> None:
    wrong = []
    for path in MODULES:
        for name in imports(path):
            if name.startswith('binocular_recon.'):
                inner = name.removeprefix('binocular_recon.')
                inner = '' if inner == '__version__' else inner
                if layer(inner) > layer(name_of(path)):
                    wrong.append(f'{name_of(path)} imports {inner}')
    assert not wrong


def test_only_nodes_import_ros() -> None:
    wrong = [
        f'{name_of(path)} imports {name}'
        for path in MODULES
        if not name_of(path).startswith('nodes')
        for name in imports(path)
        if name.split('.')[0] in ROS
    ]
    assert not wrong


def test_only_io_imports_rosbags() -> None:
    wrong = [
        f'{name_of(path)} imports {name}'
        for path in MODULES
        if not name_of(path).startswith('io')
        for name in imports(path)
        if name.split('.')[0] in BAGS
    ]
    assert not wrong


def test_library_loads_neither_ros_nor_bags() -> None:
    """In a fresh interpreter, so that what others import on our behalf counts too."""
    library = [name for name in map(name_of, MODULES) if layer(name) <= 1]
    assert {'stereo.pipeline', 'calibration', 'camera', 'config', 'errors'} <= set(library)
    statements = [f'import binocular_recon.{name}' for name in library if name]
    statements += ['import sys', 'print(*{name.split(".")[0] for name in sys.modules})']
    done = subprocess.run(
        [sys.executable, '-c', '\n'.join(statements)], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    assert 'numpy' in loaded
    assert not loaded & (ROS | BAGS)
