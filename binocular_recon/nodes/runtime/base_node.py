# SPDX-License-Identifier: Apache-2.0
"""The base of every node: parameters, outputs, worker threads, diagnostics."""

from __future__ import annotations

import time
import traceback
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

from binocular_recon._kernel_cache import cache_problem, compiled_count
from binocular_recon.config import PRESETS
from binocular_recon.nodes.runtime.diagnostics import PERIOD_S, DiagnosticsPublisher
from binocular_recon.nodes.runtime.endpoints import Input, Output, create_output
from binocular_recon.nodes.runtime.health import Health
from binocular_recon.nodes.runtime.options import PresetOptions
from binocular_recon.nodes.runtime.parameters import Parameters
from binocular_recon.nodes.runtime.process import compile_elsewhere, saying_progress
from binocular_recon.nodes.runtime.worker import LatestWorker
from binocular_recon.options import Options

# How often to look for subscribers where the middleware does not report them.
_POLL_S = 0.2


class BaseNode(Node):
    """Base of every node.

    A subclass declares its topics and options in the attributes below, prepares itself and then
    calls `start`.

    Attributes
    ----------
    NAME : str
        Node name, also that of its module and executable.
    INPUTS : sequence of Input
        Topics that the node subscribes to.
    OUTPUTS : sequence of Output
        Topics that it publishes while somebody subscribes to them.
    SERVICES : mapping of str to str
        Private services of type ``std_srvs/Trigger`` and what each does.
    LIVE, FIXED : sequence of Options types
        Option groups that may change while the node runs, and those that may not.
    SUBJECT : str
        What the node's diagnostics are about.
    options : Parameters
        Current values of the options.
    health : Health
        What the node has done and what is wrong.

    """

    NAME: ClassVar[str]
    INPUTS: ClassVar[Sequence[Input]]
    OUTPUTS: ClassVar[Sequence[Output]]
    SERVICES: ClassVar[Mapping[str, str]] = {}
    LIVE: ClassVar[Sequence[type[Options]]] = ()
    FIXED: ClassVar[Sequence[type[Options]]] = ()
    SUBJECT: ClassVar[str]

    def __init__(self) -> None:
        # first of all: ROS calls destroy_node on nodes whose construction failed, too
        self._workers: list[LatestWorker[Any]] = []
        super().__init__(self.NAME)
        self.options = Parameters(self, live=self.LIVE, fixed=self.FIXED)
        self.health = Health(self.get_logger())

    @staticmethod
    def compile_kernels(presets: Sequence[str] = tuple(PRESETS)) -> None:
        """Run every kernel that the node uses with these presets once; by default it uses none."""

    def prepare(self) -> None:
        """Compile the kernels before the first frame; later starts load them from the cache.

        If there was something to compile, another process goes on with the other presets.
        """
        options = (*self.LIVE, *self.FIXED)
        own = (
            [self.options.of(PresetOptions).preset] if PresetOptions in options else list(PRESETS)
        )
        begun_s = time.monotonic()
        with saying_progress(self.get_logger()):
            self.compile_kernels(own)
        self.get_logger().info(f'kernels ready after {time.monotonic() - begun_s:.1f} s')
        if cache_problem():
            self.get_logger().warning(cache_problem())
        elif compiled_count() and len(own) < len(PRESETS):
            compile_elsewhere([name for name in PRESETS if name not in own])

    def start(self, *, outputs: Sequence[Output] | None = None) -> None:
        """Create the publishers and report on /diagnostics from now on.

        ``outputs`` replaces `OUTPUTS`.
        """
        self._diagnostics = DiagnosticsPublisher(self, self.health, self.SUBJECT)
        created = {
            output.topic: create_output(self, output, self.health, self.update_subscriptions)
            for output in outputs or self.OUTPUTS
        }
        self._outputs = {topic: publisher for topic, (publisher, _) in created.items()}
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(PERIOD_S, self._report, clock=steady)
        if not all(reports_matches for _, reports_matches in created.values()):
            self.create_timer(_POLL_S, self.update_subscriptions, clock=steady)

    def start_worker(
        self, work: Callable[[Any], None], kind: type[LatestWorker[Any]] = LatestWorker
    ) -> LatestWorker[Any]:
        """Return a worker thread that ends with the node."""
        worker = kind(work, self._on_internal_error)
        self._workers.append(worker)
        return worker

    def wanted(self, *topics: str) -> bool:
        """Tell whether somebody subscribes to one of these outputs."""
        return any(self._outputs[topic].get_subscription_count() > 0 for topic in topics)

    def publish(self, topic: str, message: Any) -> None:
        """Publish a message on an output."""
        self._outputs[topic].publish(message)
        self.health.published(topic)

    def update_subscriptions(self) -> None:
        """Subscribe to or unsubscribe from inputs; called when the outputs' subscribers change."""

    def condition(self) -> tuple[bytes, str]:
        """Return the level and a summary of the time since the last call, for /diagnostics."""
        raise NotImplementedError

    def dropped(self) -> Counter[str]:
        """Return the messages dropped by reason, besides those that `health` counts."""
        return Counter()

    def destroy_node(self) -> None:
        """End the worker threads, then the node."""
        for worker in self._workers:
            worker.close()
        super().destroy_node()

    def _report(self) -> None:
        self.update_subscriptions()
        level, summary = self.condition()
        self._diagnostics.publish(level, summary, self.dropped())

    def _on_internal_error(self, error: Exception) -> None:
        """Report a fault of our own; called in the worker threads."""
        if self.context.ok():  # after a shutdown nothing can be published
            self.health.dropped('internal error')
            self.health.error(''.join(traceback.format_exception(error)))
