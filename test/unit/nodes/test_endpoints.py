# SPDX-License-Identifier: Apache-2.0
"""What a subscription reports to the node's health."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

pytestmark = pytest.mark.ros


def created(health: Any, *, counts_losses: bool) -> Any:
    """Return the event callbacks that an input got from a middleware."""
    from rclpy.event_handler import UnsupportedEventTypeError
    from sensor_msgs.msg import Image

    from binocular_recon.nodes.runtime.endpoints import Input, create_input

    accepted: list[Any] = []

    def create(*_: Any, event_callbacks: Any, **__: Any) -> None:
        if event_callbacks.message_lost and not counts_losses:
            raise UnsupportedEventTypeError('not offered')
        accepted.append(event_callbacks)

    node: Any = Mock(create_subscription=create)
    source = Input('left/image_raw', Image, transported=True)
    create_input(node, source, lambda _: None, health, compressed=False)
    (events,) = accepted
    return events


def test_messages_that_the_middleware_lost_are_reported() -> None:
    health = Mock()
    events = created(health, counts_losses=True)
    events.message_lost(SimpleNamespace(total_count=12, total_count_change=3))
    health.lost.assert_called_once_with('left/image_raw', 3)


def test_a_middleware_that_does_not_count_losses_will_do() -> None:
    events = created(Mock(), counts_losses=False)
    assert events.message_lost is None and events.incompatible_qos is not None
