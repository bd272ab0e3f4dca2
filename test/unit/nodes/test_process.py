# SPDX-License-Identifier: Apache-2.0
"""How a node's process starts and ends."""

from __future__ import annotations

import atexit
import os
import subprocess
import threading
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from binocular_recon.errors import ConfigError

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ('words', 'reason'),
    [
        (['--ros-args', '--params-file', '/no'], r"^ROS rejects .* '--params-file /no'.*file$"),
        (['--ros-args', '-p'], 'ROS rejects the arguments --ros-args -p: .*trailing -p flag'),
        (['--ros-args', '--nonsense'], 'ROS rejects the arguments .*nonsense'),
        (['-p', 'a:=1'], 'unknown arguments -p a:=1; give parameters .* after --ros-args'),
    ],
)
def test_a_bad_command_line_is_rejected_with_the_reason(words: list[str], reason: str) -> None:
    from binocular_recon.nodes.runtime.process import init_ros

    with pytest.raises(ConfigError, match=reason):
        init_ros(['match_node', *words])


@pytest.mark.parametrize(
    ('words', 'reason'),
    [
        (
            ['-p', 'use_sim_time:=1'],
            'parameter use_sim_time must be true or false, got 1; correct it on the command line',
        ),
        (['-p', 'use_sim_time:=[a]'], 'parameter use_sim_time must be true or false, got '),
        (
            ['-p', 'start_type_description_service:=yes_'],
            'parameter start_type_description_service must be true or false, got yes_',
        ),
    ],
)
@pytest.mark.filterwarnings('ignore::DeprecationWarning')  # of a parser that ROS imports
def test_a_parameter_of_a_wrong_type_is_refused_with_what_is_allowed(
    words: list[str], reason: str
) -> None:
    import rclpy
    from rclpy.node import Node

    from binocular_recon.nodes.runtime.process import init_ros, parameters_checked

    init_ros(['match_node', '--ros-args', *words])
    try:
        with pytest.raises(ConfigError, match=reason), parameters_checked():
            Node('a')
    finally:
        rclpy.try_shutdown()


def test_a_node_ends_with_status_1(capfd: pytest.CaptureFixture[str]) -> None:
    from binocular_recon.nodes.runtime.process import run_node

    def make_node() -> None:
        raise AssertionError('not reached')

    assert run_node(make_node, ['match_node', '-p', 'a:=1']) == 1  # type: ignore[arg-type]
    assert 'unknown arguments' in capfd.readouterr().err


@pytest.mark.parametrize('interrupted', [True, False])
def test_an_error_after_an_interrupt_is_not_a_failure(
    monkeypatch: pytest.MonkeyPatch, interrupted: bool
) -> None:
    """Ctrl-C in a destructor is not raised; the wait set then finds that ROS was shut down."""
    import rclpy

    from binocular_recon.nodes.runtime.process import run_node

    node: Any = SimpleNamespace(destroy_node=lambda: None)

    def spin(*_: object) -> None:
        if interrupted:
            rclpy.shutdown()
        raise RuntimeError('the given context is not valid')

    monkeypatch.setattr(rclpy, 'spin', spin)
    monkeypatch.setattr('sys.unraisablehook', lambda _: None)  # put back afterwards
    if interrupted:
        assert run_node(lambda: node, ['ends']) == 0
    else:
        with pytest.raises(RuntimeError, match='context'):
            run_node(lambda: node, ['ends'])


def test_a_first_start_compiles_its_preset_says_so_and_leaves_the_others_to_another_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from binocular_recon.nodes.match_node import MatchNode
    from binocular_recon.nodes.runtime import base_node, process
    from binocular_recon.nodes.runtime.options import PresetOptions

    said, compiled = threading.Event(), []
    node: Any = Mock(LIVE=MatchNode.LIVE, FIXED=MatchNode.FIXED)
    node.options.of = lambda _: PresetOptions(preset='fast')

    def compile_kernels(presets: list[str]) -> None:
        compiled.append(presets)
        assert said.wait(5)

    node.compile_kernels = compile_kernels
    node.get_logger().info.side_effect = lambda _: said.set()
    started = Mock(pid=os.getpid())
    monkeypatch.setattr(process, '_PROGRESS_EVERY_S', 0.01)
    popen = Mock(return_value=started)
    monkeypatch.setattr(subprocess, 'Popen', popen)
    monkeypatch.setattr(os, 'setpriority', Mock())
    at_exit: list[Any] = []
    monkeypatch.setattr(atexit, 'register', at_exit.append)
    for count in (0, 3):
        monkeypatch.setattr(base_node, 'compiled_count', lambda count=count: count)
        monkeypatch.setattr(base_node, 'cache_problem', str)
        base_node.BaseNode.prepare(node)
        assert popen.called == bool(count), 'only where something was missing'
    assert compiled == [['fast']] * 2
    lines = [call.args[0] for call in node.get_logger().info.call_args_list]
    assert lines[0].startswith('compiling kernels: 0 after 0 s') and 'ready after' in lines[-1]
    (command,) = popen.call_args.args
    assert command[-3:] == ['warm-up', '--presets', 'paper,default,accurate']
    at_exit[0]()
    assert started.kill.called and started.wait.called
