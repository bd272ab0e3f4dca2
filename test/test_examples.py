# SPDX-License-Identifier: Apache-2.0
"""Every code block of the documentation runs, or is a command that the project has."""

from __future__ import annotations

import ast
import dataclasses
import itertools
import re
import shlex
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
import yaml

from binocular_recon.calibration import load_rods
from binocular_recon.cli import main
from binocular_recon.config import ChainConfig
from binocular_recon.io import write_rig
from binocular_recon.io.bags import Bag, StereoBag, find_stereo_topics
from binocular_recon.measurement import read_picks
from binocular_recon.nodes.runtime import options
from binocular_recon.simulation import CaptureOptions, simulate_capture, survey_rig
from test.calibration_tools import write_covariance
from test.conftest import REPOSITORY

LANGUAGES = {'sh', 'python', 'yaml', 'text'}
# Lines of other software, which is not here: nothing of them is checked.
ELSEWHERE = {
    '. /opt/ros/': 'needs a ROS installed by apt',
    '. install/setup.sh': 'needs a colcon workspace',
    'pip install': 'needs the network; test_package reads the extras',
    'sudo apt install': 'changes the machine',
    'cd ~/ros2_ws': 'needs a colcon workspace',
    'dask scheduler': 'starts a cluster; test_batch uses one',
    'dask worker': 'starts a cluster; test_batch uses one',
    'python cluster.py': 'needs SLURM',
    'git clone': 'needs the network',
    'rosdep install': 'needs rosdep',
    'python3 -m venv': "is Python's",
    'touch venv/COLCON_IGNORE': 'needs the venv',
    'venv/bin/pip install': 'needs the venv and the network; test_package reads its versions',
    'venv/bin/python -m colcon': 'needs the venv; `make colcon` builds the package',
    'ros2 run rqt_image_view': 'needs a display',
    'ros2 launch foxglove_bridge': 'needs foxglove_bridge; other_software.md states the version',
    'ros2 launch rtabmap_launch': 'needs rtabmap_ros; other_software.md states the version',
    'ros2 run octomap_server': 'needs octomap_server; other_software.md states the version',
    'ros2 run stereo_image_proc': 'needs image_pipeline; other_software.md states the version',
    'ros2 run depth_image_proc': 'needs image_pipeline; other_software.md states the version',
}


class Block(NamedTuple):
    """A code block and where it begins."""

    page: str
    line: int
    language: str
    text: str

    @property
    def place(self) -> str:
        """Page and line, for a person."""
        return f'{self.page}:{self.line}'


def blocks() -> list[Block]:
    """Return the fenced blocks of all pages, and those of the site's first page."""
    paths = [REPOSITORY / name for name in ('README.md', 'CONTRIBUTING.md')]
    paths += [*sorted((REPOSITORY / 'docs').glob('*.md')), REPOSITORY / 'docs' / 'index.rst']
    fence = re.compile(
        r'^ *```(.*)\n([\s\S]*?)^ *```$|^\.\. code-block:: (\w+)\n\n((?: .*\n|\n)+)', re.MULTILINE
    )
    found = []
    for path in paths:
        text = path.read_text()
        for match in fence.finditer(text):
            line = text.count('\n', 0, match.start()) + 1
            language, content = match[1], match[2]
            if match[3]:
                language, content = match[3], re.sub('^ {3}', '', match[4], flags=re.MULTILINE)
            found.append(Block(path.name, line, language, content))
    return found


BLOCKS = blocks()


def of(language: str) -> pytest.MarkDecorator:
    """Parametrise a test with the blocks of a language."""
    chosen = [block for block in BLOCKS if block.language == language]
    assert chosen
    return pytest.mark.parametrize('block', chosen, ids=[block.place for block in chosen])


def test_every_block_states_its_language() -> None:
    assert len(BLOCKS) > 20
    assert not [block.place for block in BLOCKS if block.language not in LANGUAGES]


@pytest.fixture(scope='module')
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a folder with what the Python examples read: a rig, a pair, a bag, images of rods."""
    folder = tmp_path_factory.mktemp('examples')
    for name in ('bags', 'config'):
        (folder / name).symlink_to(REPOSITORY / name)
    for name in ('rig', 'captures'):
        (folder / name).mkdir()
    with Bag(folder / 'bags' / 'motorcycle') as bag:
        (frame,) = StereoBag(bag, find_stereo_topics(bag.topics))
        for side, image in zip(('left', 'right'), frame.images(), strict=True):
            cv2.imwrite(str(folder / f'{side}.png'), image)
        write_rig(folder / 'rig', frame.rig, ('left', 'right'))
        write_covariance(folder / 'rig', frame.rig)
    # half the size of the survey rig's images, so boards stand at half the distance
    rods, near = load_rods(folder / 'config' / 'rods.yaml'), CaptureOptions(depth_m=(3.0, 8.0))
    for index in range(4):
        rng = np.random.default_rng([7, index])
        capture = simulate_capture(rods, survey_rig(scale=0.5), rng, near)
        cv2.imwrite(str(folder / 'captures' / f'left_{index}.png'), capture.left)
        cv2.imwrite(str(folder / 'captures' / f'right_{index}.png'), capture.right)
    return folder


@of('python')
@pytest.mark.usefixtures('built_in_matchers')
def test_python_examples_run(
    block: Block, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(workplace)
    names: dict[str, Any] = {'__name__': 'example'}
    exec(compile(block.text, block.place, 'exec'), names)
    for name, shape in (('points_m', (497, 741, 3)), ('sigma_m', (497, 741))):
        assert name not in names or names[name].shape == shape


@of('sh')
def test_commands_exist(block: Block) -> None:
    lines = [line for line in block.text.replace('\\\n', ' ').splitlines() if line.strip()]
    assert lines
    for line in lines:
        for command in re.split(r' && ', line):
            check_command(command)


def check_command(command: str) -> None:
    """Fail unless the project has the command and takes its arguments."""
    words = shlex.split(command, comments=True)
    if words[:1] == ['make']:
        check_make(words[1:])
    elif Path(words[0]).name == 'binocular-recon':
        check_arguments(words[1:])
    elif words[1:3] == ['-m', 'binocular_recon']:
        check_arguments(words[3:])
    elif words[:3] == ['ros2', 'launch', 'binocular_recon']:
        check_launch(words[3], words[4:])
    elif words[:3] == ['ros2', 'run', 'binocular_recon']:
        check_node(words[3], words[4:])
    elif words[:3] == ['ros2', 'service', 'call']:
        node, service = words[3].split('/')[-2:]
        assert f'| `~/{service}` |' in section(node), command
    else:
        assert command.startswith(tuple(ELSEWHERE)), f'{command} is not known'


def check_make(words: list[str]) -> None:
    """Fail unless the Makefile has the targets and reads the variables."""
    makefile = (REPOSITORY / 'Makefile').read_text()
    for word in words:
        name, variable, _ = word.partition('=')
        pattern = rf'^{name} \?= ' if variable else rf'^[\w -]*\b{name}\b[\w -]*:'
        assert re.search(pattern, makefile, re.MULTILINE), word


def check_arguments(words: list[str]) -> None:
    """Fail unless the command line takes the arguments."""
    try:
        main._parser(words).parse_args(words)
    except SystemExit:
        pytest.fail(f'binocular-recon {shlex.join(words)} is refused')


def check_launch(file: str, words: list[str]) -> None:
    """Fail unless the launch file exists and has the arguments."""
    arguments: set[str] = set()
    for name in {file, 'binocular_recon.launch.py'}:
        table: Any
        (table,) = (
            node.value
            for node in ast.parse((REPOSITORY / 'launch' / name).read_text()).body
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == 'ARGUMENTS'
        )
        # the names of a comprehension are some of the chain's
        keys: list[Any] = getattr(table, 'keys', None) or table.generators[0].iter.elts
        arguments |= {ast.literal_eval(key) for key in keys if key}
    groups: list[Any] = list(vars(ChainConfig()).values())
    groups += [group for group in vars(options).values() if dataclasses.is_dataclass(group)]
    arguments |= {spec.name for group in groups for spec in dataclasses.fields(group)}
    given = {word.partition(':=')[0] for word in words if word != '--show-args'}
    assert given <= arguments


def check_node(node: str, words: list[str]) -> None:
    """Fail unless there is the node and it has the parameters."""
    for word, value in itertools.pairwise(words):
        if word == '-p':
            assert f'| `{value.partition(":=")[0]}` |' in section(node), value


def section(node: str) -> str:
    """Return what docs/nodes.md, made from the nodes, says of one node."""
    text = (REPOSITORY / 'docs' / 'nodes.md').read_text()
    (found,) = re.findall(rf'^## {node}\n(.*?)(?=^## |\Z)', text, re.MULTILINE | re.DOTALL)
    return str(found)


@of('yaml')
def test_yaml_examples_are_read(block: Block, tmp_path: Path) -> None:
    content = yaml.safe_load(block.text)
    if 'rods' in content:
        path = tmp_path / 'rods.yaml'
        path.write_text(block.text)
        assert load_rods(path).count == len(content['rods'])
        return
    if 'picks' in content:
        path = tmp_path / 'picks.yaml'
        path.write_text(block.text)
        assert len(read_picks(path)[0]) == len(content['picks'])
        return
    if 'local_costmap' in content:
        return  # nav2's
    for name, values in content.items():
        assert name.startswith('/**/')
        for parameter in values['ros__parameters']:
            assert f'| `{parameter}` |' in section(name.removeprefix('/**/')), parameter


def test_exceptions_are_needed() -> None:
    shown = '\n'.join(block.text for block in BLOCKS if block.language == 'sh')
    assert not [start for start in ELSEWHERE if start not in shown]
