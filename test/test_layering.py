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

# The rooms in the order in which they build upon each other: a module imports from its own room
# and from those before it. A room holds its subfolders unless these are listed themselves; the
# modules of a folder may stand in several rooms, some below its subfolders and some above.
ROOMS = [
    {
        'errors',
        '_signals',
        'options',
        'number_text',
        '_lazy',
        '_kernel_cache',
        'rotations',
        'lenses',
    },
    {
        'inputs',
        'config',
        'cloud_config',
        'stereo.foreign.conventions',
        'camera',
        '_jit',
        '_simd',
        'machine',
    },
    {'images', 'pairing'},
    {'stereo.rectification', 'stereo.confidence', 'stereo.validity', 'stereo._validity_kernels'},
    {'stereo.holes'},
    {'stereo.matching', 'stereo.foreign'},
    {'stereo.filtering'},
    {
        'stereo.point_covariance',
        'stereo.range_tracker',
        'stereo.row_check',
        'stereo.orientation',
        'stereo.diagnosis',
        'stereo.search_range',
        'stereo.thinning',
        'stereo.triangulation',
        'stereo._triangulation_kernels',
        'stereo.pipeline',
    },
    {'io'},
    {'io.messages'},
    {'io.bags', 'io.pairs'},
    {'drawing'},
    {'io.exports'},
    {'calibration.model', 'calibration.target'},
    {'calibration.detection'},
    {'calibration.adjustment'},
    {'calibration.rectification'},
    {
        'calibration.advice',
        'calibration.holding',
        'calibration.result',
        'calibration.screening',
        'calibration.solve',
        'calibration.verdict',
    },
    {'calibration.report'},
    {'calibration.session'},
    {'measurement'},
    {'measurement.site', 'merging'},
    {'simulation'},
    {'evaluation.peers', 'evaluation.tables', 'evaluation.timing'},
    {'evaluation.accuracy', 'evaluation.speed', 'evaluation.calibration'},
    {'evaluation.paper'},
    {'apps'},
    {'viewer'},
    {'nodes.runtime'},
    {'nodes.calibration', 'nodes.stages'},
    {'nodes'},
    {'cli', '__main__'},
]
# Modules of which kernels take names of types only.
TYPES_ONLY = {'camera', 'images'}
# What only io.bags may import, and what only nodes may.
BAGS = {'rosbags'}
ROS = {
    'builtin_interfaces', 'diagnostic_msgs', 'geometry_msgs', 'rcl_interfaces', 'rclpy',
    'rosgraph_msgs', 'sensor_msgs', 'std_msgs', 'std_srvs', 'stereo_msgs', 'tf2_msgs',
    'visualization_msgs',
}  # fmt: skip
MOST_MODULES, MOST_LINES = 15, 300


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


def inner_imports(path: Path) -> Iterator[str]:
    """Yield the modules of the package that a file imports, as seen from inside the package."""
    for name in imports(path):
        if name.startswith('binocular_recon.'):
            yield origin(name.removeprefix('binocular_recon.'))


def origin(name: str) -> str:
    """Return the module that a module or one of its names comes from."""
    if name in NAMES:
        return name
    parent, _, last = name.rpartition('.')
    init = PACKAGE / parent.replace('.', '/') / '__init__.py'
    if init.exists():
        exported = [one for one in imports(init) if one.rpartition('.')[2] == last]
        return origin(exported[0].removeprefix('binocular_recon.')) if exported else parent
    return parent


def room(name: str) -> int:
    """Return the number of the room of module ``name``, as seen from inside the package."""
    found = [
        (len(member), number)
        for number, members in enumerate(ROOMS)
        for member in members
        if name == member or name.startswith(f'{member}.')
    ]
    if not found:
        raise AssertionError(f'{name} is in no room; add it to ROOMS')
    return max(found)[1]


def name_of(path: Path) -> str:
    """Return the dotted name of a module inside the package, '' for the package itself."""
    parts = path.relative_to(PACKAGE).with_suffix('').parts
    return '.'.join(part for part in parts if part != '__init__')


NAMES = {name_of(path) for path in MODULES}


def test_imports_point_one_way() -> None:
    wrong = [
        f'{name_of(path)} imports {inner}'
        for path in MODULES
        if path.name != '__init__.py'  # what it exports is imported when it is used
        for inner in inner_imports(path)
        if inner and room(inner) > room(name_of(path))
    ]
    assert not wrong


def test_rooms_export_their_own_names() -> None:
    """What a room exports comes from inside it; only the top exports names of several rooms."""
    for path in MODULES:
        own = name_of(path)
        if path.name == '__init__.py' and own:
            inside = [name for name in inner_imports(path) if name != '_lazy']
            assert all(name.startswith(f'{own}.') for name in inside), own


def test_no_exported_name_is_that_of_a_module() -> None:
    """``from room import name`` would give one or the other, by what was imported before."""
    for path in MODULES:
        if path.name == '__init__.py':
            beside = {one.stem for one in path.parent.iterdir()}
            exported = {name.rpartition('.')[2] for name in imports(path)}
            assert not exported & beside, name_of(path)


def test_private_modules_stay_in_their_room() -> None:
    wrong = []
    for path in MODULES:
        own = name_of(path)
        for name in imports(path):
            inner = name.removeprefix('binocular_recon.')
            inner = inner if inner in NAMES else inner.rpartition('.')[0]
            folder, _, last = inner.rpartition('.')
            if last.startswith('_') and folder and not f'{own}.'.startswith(f'{folder}.'):
                wrong.append(f'{own} imports {inner}')
    assert not wrong


def test_no_room_is_crowded() -> None:
    folders = {path.parent for path in MODULES}
    crowded = {
        name_of(folder): count
        for folder in folders
        if (count := len(list(folder.glob('*.py')))) > MOST_MODULES
    }
    long = {
        name_of(path): count
        for path in MODULES
        if (count := path.read_text().count('\n')) > MOST_LINES
    }
    assert not crowded
    assert not long


def test_every_room_says_what_it_is_for() -> None:
    for path in MODULES:
        if path.name == '__init__.py':
            docstring = ast.get_docstring(ast.parse(path.read_text())) or ''
            assert len(docstring.split()) > 25, name_of(path)


def test_kernels_are_where_their_cache_looks_for_them() -> None:
    """The stamp of compiled kernels covers the modules ``_*_kernels``, so all are there."""
    decorators = {'kernel', 'exact_kernel', 'ordered_kernel', 'inline_kernel'}
    for path in MODULES:
        tree = ast.parse(path.read_text())
        used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
        assert not used & decorators or path.stem.endswith('_kernels'), path
        if path.stem.endswith('_kernels'):
            # constants of other modules would be compiled in and never noticed to have changed
            allowed = ('_jit', '_simd', *TYPES_ONLY)
            others = {name for name in inner_imports(path) if not name.endswith('_kernels')}
            assert all(name.startswith(allowed) for name in others), path


def test_kernels_called_by_kernels_are_inlined_or_exact() -> None:
    """Else the result depends on which of two compilations of the inner one was loaded first."""
    functions: dict[str, tuple[set[str], ast.FunctionDef]] = {}
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                names = {one.id for one in node.decorator_list if isinstance(one, ast.Name)}
                if names & {'kernel', 'exact_kernel', 'ordered_kernel', 'inline_kernel'}:
                    functions[node.name] = names, node
    called = {
        node.func.id
        for _, function in functions.values()
        for node in ast.walk(function)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert len(called & set(functions)) > 50
    assert [name for name in called & set(functions) if 'kernel' in functions[name][0]] == []


def test_only_nodes_import_ros() -> None:
    wrong = [
        f'{name_of(path)} imports {name}'
        for path in MODULES
        if not name_of(path).startswith('nodes')
        for name in imports(path)
        if name.split('.')[0] in ROS
    ]
    assert not wrong


def test_only_bags_imports_rosbags() -> None:
    wrong = [
        f'{name_of(path)} imports {name}'
        for path in MODULES
        if not name_of(path).startswith('io.bags')
        for name in imports(path)
        if name.split('.')[0] in BAGS
    ]
    assert not wrong


def test_library_loads_neither_ros_nor_bags() -> None:
    """In a fresh interpreter, so that what others import on our behalf counts too."""
    library = [
        name
        for name in map(name_of, MODULES)
        if name and not name.startswith(('io.bags', 'apps', 'nodes', 'cli', '__main__'))
    ]
    assert {'stereo.pipeline', 'calibration.solve', 'io.messages.images'} <= set(library)
    statements = [f'import binocular_recon.{name}' for name in library if name]
    statements += ['import sys', 'print(*{name.split(".")[0] for name in sys.modules})']
    done = subprocess.run(
        [sys.executable, '-c', '\n'.join(statements)], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    assert 'numpy' in loaded
    assert not loaded & (ROS | BAGS)
