# SPDX-License-Identifier: Apache-2.0
"""How a node's process begins and ends."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from binocular_recon.errors import ConfigError

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ('words', 'reason'),
    [
        (['--ros-args', '--params-file', '/no'], r"^ROS refuses .* '--params-file /no'.*file$"),
        (['--ros-args', '-p'], 'ROS refuses the arguments --ros-args -p: .*trailing -p flag'),
        (['--ros-args', '--nonsense'], 'ROS refuses the arguments .*nonsense'),
        (['-p', 'a:=1'], 'arguments -p a:=1 are not known; parameters .* follow --ros-args'),
    ],
)
def test_a_bad_command_line_is_refused_in_words(words: list[str], reason: str) -> None:
    from binocular_recon.nodes.runtime.process import init_ros

    with pytest.raises(ConfigError, match=reason):
        init_ros(['match_node', *words])


def test_a_node_ends_with_status_1(capfd: pytest.CaptureFixture[str]) -> None:
    from binocular_recon.nodes.runtime.process import run_node

    def make_node() -> None:
        raise AssertionError('not reached')

    assert run_node(make_node, ['match_node', '-p', 'a:=1']) == 1  # type: ignore[arg-type]
    assert 'are not known' in capfd.readouterr().err


@pytest.mark.parametrize('interrupted', [True, False])
def test_what_fails_after_an_interrupt_is_no_failure(
    monkeypatch: pytest.MonkeyPatch, interrupted: bool
) -> None:
    """Ctrl-C within a destructor raises nothing; the wait set then finds ROS shut down."""
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
