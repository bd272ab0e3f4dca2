# SPDX-License-Identifier: Apache-2.0
"""Publish a node's health on /diagnostics."""

from __future__ import annotations

from collections import Counter

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from binocular_recon.nodes.runtime.health import Health

# Time between two messages.
PERIOD_S = 1.0


class DiagnosticsPublisher:
    """Publisher of the status of one node.

    Parameters
    ----------
    node : Node
        The node.
    health : Health
        What it has done and what is wrong.
    subject : str
        What the status is about, such as ``frames``; part of its name.

    """

    def __init__(self, node: Node, health: Health, subject: str) -> None:
        self._node, self._health, self._subject = node, health, subject
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)

    def publish(self, level: bytes, summary: str, dropped: Counter[str] | None = None) -> None:
        """Publish the status.

        Parameters
        ----------
        level : bytes
            Level of the summary; a recent problem of the node may raise it.
        summary : str
            The node's condition in one line.
        dropped : Counter, optional
            Messages dropped by reason, besides those that ``health`` counts.

        """
        name = self._node.get_fully_qualified_name().lstrip('/')
        status = self._health.status(
            f'{name}: {self._subject}', name, level, summary, dropped=dropped or Counter()
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
