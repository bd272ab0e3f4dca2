# SPDX-License-Identifier: Apache-2.0
"""What the nodes share: topics, pairing, work beside the executor, diagnostics, start and end."""

from __future__ import annotations

import functools
import time
import traceback
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

from binocular_recon.camera import StereoRig
from binocular_recon.errors import BinocularReconError, CalibrationError
from binocular_recon.io.messages.camera_infos import calibration_content, rig_from_messages
from binocular_recon.io.messages.images import stamp_ns
from binocular_recon.nodes.runtime.endpoints import Input, Output, offer, subscribe
from binocular_recon.nodes.runtime.health import Health
from binocular_recon.nodes.runtime.options import InputOptions
from binocular_recon.nodes.runtime.parameters import Parameters
from binocular_recon.nodes.runtime.worker import LatestWorker
from binocular_recon.options import Options
from binocular_recon.pairing import Synchronizer

# How often a listener is looked for where the middleware does not report it.
_POLL_S = 0.2
# What complete sets are called in the diagnostics.
_SETS = 'sets'


class StereoNode(Node):
    """Base of the nodes.

    A subclass says what it takes and gives, prepares itself, calls `start`, and makes its outputs
    in `process`, which runs in a thread of its own with the newest set of inputs.

    Attributes
    ----------
    NAME : str
        Node name.
    INPUTS : sequence of Input
        Subscribed to while somebody listens; the first leads the pairing.
    OUTPUTS : sequence of Output
        Made while somebody listens to them.
    LIVE, FIXED : sequence of Options types
        Option groups that may change while the node runs, and that may not.
    options : Parameters
        Their present values.
    health : Health
        What the node has done and what is wrong.

    """

    NAME: ClassVar[str]
    INPUTS: ClassVar[Sequence[Input]]
    OUTPUTS: ClassVar[Sequence[Output]]
    LIVE: ClassVar[Sequence[type[Options]]]
    FIXED: ClassVar[Sequence[type[Options]]] = (InputOptions,)

    def __init__(self) -> None:
        # before all that can fail: ROS destroys nodes that were not finished, too
        self._workers: list[LatestWorker[Any]] = []
        super().__init__(self.NAME)
        self.options = Parameters(self, live=self.LIVE, fixed=self.FIXED)
        self.health = Health(self.get_logger())
        self._rig: tuple[Any, StereoRig] | None = None
        self._worker = self.start_worker(self._work)

    def start_worker(self, work: Callable[[Any], None]) -> LatestWorker[Any]:
        """Return a worker that ends with the node."""
        worker = LatestWorker(work, self._fail)
        self._workers.append(worker)
        return worker

    def prepare(self, compile_kernels: Callable[[], None]) -> None:
        """Compile the kernels before the first frame; later starts take them from the cache."""
        begun_s = time.monotonic()
        compile_kernels()
        seconds = time.monotonic() - begun_s
        self.get_logger().info(f'kernels are ready after {seconds:.1f} s')

    def start(self, inputs: Sequence[Input] | None = None) -> None:
        """Offer the outputs; ``inputs`` replaces `INPUTS`."""
        options = self.options.of(InputOptions)
        self._inputs = {one.topic: one for one in inputs or self.INPUTS}
        self._optional = {
            one.topic: self.resolve_topic_name(one.topic)
            for one in self._inputs.values()
            if one.optional
        }
        self._compressed = options.image_transport == 'compressed'
        self._synchronizer = Synchronizer(
            list(self._inputs), queue_size=options.queue_size, tolerance_ns=options.tolerance_ns
        )
        self._processed = self._superseded = 0
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        offered = {one.topic: offer(self, one, self.health, self._update) for one in self.OUTPUTS}
        self._outputs = {topic: publisher for topic, (publisher, _) in offered.items()}
        # declares the QoS parameters of the inputs
        self._listening = self._subscribe()
        self._update()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self._report, clock=steady)
        if not all(reports for _, reports in offered.values()):
            self.create_timer(_POLL_S, self._update, clock=steady)

    def process(self, *messages: Any) -> None:
        """Make the outputs from one message per input, None for a missing optional one."""
        raise NotImplementedError

    def wanted(self, *topics: str) -> bool:
        """Tell whether somebody subscribes to one of the outputs."""
        return any(self._outputs[topic].get_subscription_count() > 0 for topic in topics)

    def needed(self) -> bool:
        """Tell whether inputs are to be received now."""
        return self.wanted(*self._outputs)

    def publish(self, topic: str, message: Any) -> None:
        """Send an output."""
        self._outputs[topic].publish(message)
        self.health.published(topic)

    def rig(self, left_info: Any, right_info: Any) -> StereoRig:
        """Return the rig of two CameraInfos, made anew only when they change."""
        key = calibration_content(left_info), calibration_content(right_info)
        if self._rig is None or self._rig[0] != key:
            self._rig = None
            self._rig = key, rig_from_messages(left_info, right_info)
            self.state_rig(self._rig[1])
        return self._rig[1]

    def state_rig(self, rig: StereoRig) -> None:
        """Show the calibration in use in the diagnostics."""
        self.health.state(
            'calibration',
            f'{rig.left.width}x{rig.left.height} px, f {rig.focal_px:.2f} px, baseline'
            f' {rig.baseline_m:.4f} m, cx_left - cx_right {rig.disparity_offset_px:.2f} px',
        )

    def explain_missing_sets(self) -> str:
        """Say why there are no sets although every topic has messages."""
        silent = self.health.silent()
        unused = [t for t in self._optional if t in silent and self._is_published(t)]
        if unused:
            return (
                f'sets wait for {", ".join(unused)}, which has a publisher but no messages; check'
                ' that publisher or stop it: sets are complete without'
            )
        too_late = self._explain_lateness()
        if too_late:
            return too_late
        missing = self._synchronizer.explain()
        if missing is None:
            return (
                f'sets of {", ".join(self._inputs)} stay incomplete although stamps agree:'
                ' messages get lost; set reliability to reliable on both sides or raise queue_size'
            )
        text, needed_s = missing
        remedy = (
            'raise'
            if self.options.of(InputOptions).tolerance_ns
            else 'trigger the cameras together or set approximate_sync with'
        )
        return f'{text}; {remedy} approximate_sync_tolerance_seconds of at least {needed_s:.6f}'

    def destroy_node(self) -> None:
        """End the work, then the node."""
        for worker in self._workers:
            worker.close()
        super().destroy_node()

    def _explain_lateness(self) -> str:
        """Say what comes when its partners have been dropped, '' if nothing does."""
        needed = self._synchronizer.too_late()
        if not needed:
            return ''
        return (
            f'messages on {", ".join(needed)} come too late: others of their stamp have made room'
            f' for newer ones by then; raise queue_size to at least {max(needed.values())}'
        )

    def _is_published(self, optional: str) -> bool:
        return self.count_publishers(self._optional[optional]) > 0

    def _subscribe(self) -> list[Any]:
        self._synchronizer.clear()
        self.health.expect([*self._inputs, _SETS])
        return [
            subscribe(
                self,
                one,
                functools.partial(self._receive, one.topic),
                self.health,
                compressed=self._compressed,
            )
            for one in self._inputs.values()
        ]

    def _update(self) -> None:
        """Subscribe while somebody listens to an output, and only then."""
        needed = self.needed()
        if needed and not self._listening:
            self._listening = self._subscribe()
        elif not needed:
            for subscription in self._listening:
                self.destroy_subscription(subscription)
            self._listening = []

    def _receive(self, topic: str, message: Any) -> None:
        self.health.received(topic)
        for optional in self._optional:
            self._synchronizer.expect(optional, self._is_published(optional))
        for found in self._synchronizer.add(topic, stamp_ns(message.header), message):
            self.health.received(_SETS)
            if self._worker.submit(found):
                self._superseded += 1
                self.health.dropped('a newer set came before it was begun')

    def _work(self, messages: tuple[Any, ...]) -> None:
        """Process a set in the worker's thread; whatever is wrong with it, the next one comes."""
        begun_s = time.monotonic()
        try:
            self.process(*messages)
        except BinocularReconError as error:
            kind = 'bad calibration' if isinstance(error, CalibrationError) else 'bad input'
            self.health.dropped(kind)
            self.health.error(str(error))
        except MemoryError as error:
            self.health.dropped('not enough memory')
            self.health.error(f'{error}; choose a smaller disparity_range or smaller pictures')
        else:
            self._processed += 1
            self.health.processed(time.monotonic() - begun_s)

    def _fail(self, error: Exception) -> None:
        """Report a fault of ours, in a worker's thread."""
        if self.context.ok():  # after a shutdown nothing can be published
            self.health.dropped('internal error')
            self.health.error(''.join(traceback.format_exception(error)))

    def _report(self) -> None:
        self._update()
        level, summary = self._condition()
        name = self.get_fully_qualified_name().lstrip('/')
        status = self.health.status(
            f'{name}: frames', name, level, summary, dropped=self._synchronizer.dropped
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def _condition(self) -> tuple[bytes, str]:
        """Return level and summary of the last second, and log what keeps frames from coming."""
        processed, self._processed = self._processed, 0
        superseded, self._superseded = self._superseded, 0
        if not self._listening:
            topics = ', '.join(self._outputs)
            return DiagnosticStatus.OK, f'idle: nobody subscribes to any of {topics}'
        ages_s = self.health.silent()
        required = [topic for topic in self._inputs if topic not in self._optional]
        silent = {topic: ages_s[topic] for topic in required if topic in ages_s}
        level = DiagnosticStatus.ERROR
        if len(silent) == len(required):
            level = DiagnosticStatus.STALE
            text = f'no messages on {", ".join(silent)}; start the cameras or check the remapping'
        elif silent:
            since = ', '.join(f'{topic} for {age_s:.1f} s' for topic, age_s in silent.items())
            text = f'no message on {since}; check what publishes it (node, camera, cable)'
        elif _SETS in ages_s:
            text = self.explain_missing_sets()
        elif too_late := self._explain_lateness():
            level, text = DiagnosticStatus.WARN, too_late
        elif superseded:
            level = DiagnosticStatus.WARN
            text = f'cannot keep up: dropped {superseded} sets for newer ones within a second'
        else:
            return DiagnosticStatus.OK, f'{processed} frames within a second'
        self.health.log(level, text)
        return level, text
