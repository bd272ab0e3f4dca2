# SPDX-License-Identifier: Apache-2.0
"""Create publishers and subscriptions with their QoS, and explain QoS mismatches."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.event_handler import (
    PublisherEventCallbacks,
    SubscriptionEventCallbacks,
    UnsupportedEventTypeError,
)
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions
from sensor_msgs.msg import CompressedImage

from binocular_recon.errors import ConfigError
from binocular_recon.nodes.runtime.health import Health


@dataclass(frozen=True)
class Input:
    """A topic that a node subscribes to.

    Attributes
    ----------
    topic : str
        Relative name.
    type : type
        Message type.
    transported : bool
        Whether it follows ``image_transport``.
    optional : bool
        Whether frames are complete without it while nobody publishes it.

    """

    topic: str
    type: type[Any]
    transported: bool = False
    optional: bool = False


@dataclass(frozen=True)
class Output:
    """A topic that a node publishes.

    Attributes
    ----------
    topic : str
        Relative name.
    type : type
        Message type.
    latched : bool
        Whether who subscribes later gets the last message (transient local).

    """

    topic: str
    type: type[Any]
    latched: bool = False


def create_output(
    node: Node, output: Output, health: Health, on_match: Callable[[], None]
) -> tuple[Any, bool]:
    """Create the publisher of an output: reliable, keep last 1, unless overridden.

    It is volatile unless it is latched.

    Returns the publisher, and whether the middleware calls ``on_match`` when a subscriber appears
    or disappears. Raises a ConfigError if a QoS override is not valid.
    """
    durability = DurabilityPolicy.TRANSIENT_LOCAL if output.latched else DurabilityPolicy.VOLATILE
    qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=durability)
    explain = _mismatch_reporter(node, output.topic, qos, health, publishes=True)
    events = PublisherEventCallbacks(incompatible_qos=explain, matched=lambda _event: on_match())
    create = functools.partial(
        node.create_publisher,
        output.type,
        output.topic,
        qos,
        qos_overriding_options=QoSOverridingOptions.with_default_policies(),
    )
    try:
        try:
            return create(event_callbacks=events), True
        except UnsupportedEventTypeError:
            events.matched = None
            return create(event_callbacks=events), False
    except (InvalidQosOverridesError, RuntimeError) as error:
        raise ConfigError(f'output {output.topic}: {error}') from error


def create_input(
    node: Node,
    source: Input,
    callback: Callable[[Any], None],
    health: Health,
    *,
    compressed: bool,
) -> Any:
    """Create the subscription of an input: sensor data QoS unless overridden.

    Messages that the middleware knows to be lost on their way are reported to ``health``.

    The topic of compressed images follows from the remapped name of the raw ones. Raises a
    ConfigError if a QoS override is not valid.
    """
    topic, kind = source.topic, source.type
    if source.transported and compressed:
        topic, kind = f'{node.resolve_topic_name(topic)}/compressed', CompressedImage
    qos = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    events = SubscriptionEventCallbacks(
        incompatible_qos=_mismatch_reporter(node, topic, qos, health, publishes=False),
        message_lost=lambda event: health.lost(source.topic, event.total_count_change),
    )
    create = functools.partial(
        node.create_subscription,
        kind,
        topic,
        callback,
        qos,
        qos_overriding_options=QoSOverridingOptions.with_default_policies(),
    )
    try:
        try:
            return create(event_callbacks=events)
        except UnsupportedEventTypeError:
            events.message_lost = None
            return create(event_callbacks=events)
    except (InvalidQosOverridesError, RuntimeError) as error:
        raise ConfigError(f'input {topic}: {error}') from error


def _mismatch_reporter(
    node: Node, topic: str, own: QoSProfile, health: Health, *, publishes: bool
) -> Callable[[Any], None]:
    """Return an event callback that reports whose QoS is incompatible and why."""
    name = node.resolve_topic_name(topic)
    role, other_role = ('publisher', 'subscriber') if publishes else ('subscription', 'publisher')

    def explain(_event: Any) -> None:
        if publishes:
            others = node.get_subscriptions_info_by_topic(name)
        else:
            others = node.get_publishers_info_by_topic(name)
        for other in others:
            offered, requested = (
                (own, other.qos_profile) if publishes else (other.qos_profile, own)
            )
            compatible, reason = qos_check_compatible(offered, requested)
            if compatible == QoSCompatibility.ERROR:
                reason = reason.replace('ERROR: ', '').strip().rstrip(';')
                known = not other.node_name.startswith('_')  # it may be discovered later
                who = f'{other_role} {other.node_name}' if known else f'a {other_role}'
                health.warning(
                    f'{name}: the QoS of {who} is incompatible ({reason}), so it exchanges no'
                    f' messages; change it or set parameter'
                    f' qos_overrides.{name}.{role}.reliability'
                )

    return explain
