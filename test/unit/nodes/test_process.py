# SPDX-License-Identifier: Apache-2.0
"""How a node's process starts and ends."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

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
