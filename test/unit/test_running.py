# SPDX-License-Identifier: Apache-2.0
"""What nodes make of their command line."""

from __future__ import annotations

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
    from binocular_recon.nodes.running import init_ros

    with pytest.raises(ConfigError, match=reason):
        init_ros(['match_node', *words])


def test_a_node_ends_with_status_1(capfd: pytest.CaptureFixture[str]) -> None:
    from binocular_recon.nodes.running import run_node

    def make_node() -> None:
        raise AssertionError('not reached')

    assert run_node(make_node, ['match_node', '-p', 'a:=1']) == 1  # type: ignore[arg-type]
    assert 'are not known' in capfd.readouterr().err
