# SPDX-License-Identifier: Apache-2.0
"""The base of nodes that process frames: messages with matching stamps, one per input."""

from __future__ import annotations

import functools
import time
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticStatus

from binocular_recon._jit import limit_threads
from binocular_recon.camera import StereoRig
from binocular_recon.errors import plain_text
from binocular_recon.io.messages.camera_infos import calibration_content, rig_from_messages
from binocular_recon.io.messages.images import stamp_ns
from binocular_recon.nodes.runtime.base_node import BaseNode
from binocular_recon.nodes.runtime.demand import Demand, Requests
from binocular_recon.nodes.runtime.endpoints import Input, Output, create_input
from binocular_recon.nodes.runtime.health import SHARED_MEMORY
from binocular_recon.nodes.runtime.options import InputOptions, LoadOptions
from binocular_recon.nodes.runtime.remedies import remedy
from binocular_recon.nodes.runtime.worker import Intake, InTwoThreads, Rest
from binocular_recon.number_text import counted
from binocular_recon.options import Options
from binocular_recon.pairing import Synchronizer

# What the diagnostics call complete sets of messages.
_SETS = 'sets'


class FrameNode(BaseNode):
    """Base of nodes that process one frame after the other in a worker thread.

    Inputs are received while somebody subscribes to an output. Messages with matching stamps form
    a frame, led by the first input. A subclass makes its outputs in `process`, which gets the
    newest frame; older ones that still wait are dropped.

    Attributes
    ----------
    DEMAND : str
        Topic on which consumers ask for frames; '' = all are made.
    REQUESTS : sequence of str
        Topics on which the node says that it takes frames on demand; it asks on the first.
    ASKS_EARLY : bool
        Whether it asks for the next frame when it begins one, or when it is done.

    """

    FIXED: ClassVar[Sequence[type[Options]]] = (InputOptions,)
    SUBJECT = 'frames'
    DEMAND: ClassVar[str] = ''
    REQUESTS: ClassVar[Sequence[str]] = ()
    ASKS_EARLY: ClassVar[bool] = False

    def __init__(self) -> None:
        super().__init__()
        self._rig: tuple[Any, StereoRig] | None = None
        submit = self.start_worker(self._work).submit
        self._frames = InTwoThreads(self.health, self.process, self.start_worker)
        self._intake = Intake(self.health, submit, lambda: self.options.of(LoadOptions).max_rate)

    def start(
        self, inputs: Sequence[Input] | None = None, *, outputs: Sequence[Output] | None = None
    ) -> None:
        """Create publishers and subscriptions; arguments replace `INPUTS` and `OUTPUTS`."""
        options = self.options.of(InputOptions)
        self._inputs = {one.topic: one for one in inputs or self.INPUTS}
        self._optional = {
            one.topic: self.resolve_topic_name(one.topic)
            for one in self._inputs.values()
            if one.optional
        }
        self._compressed = options.image_transport == 'compressed'
        self._synchronizer = Synchronizer(
            list(self._inputs),
            queue_size=options.queue_size,
            tolerance_ns=options.tolerance_ns,
            by_arrival=options.by_arrival,
            offsets_ns={
                topic: options.stamp_offset_ns
                for topic in self._inputs
                if topic.startswith('right/')
            },
        )
        # Declares the QoS parameters of the inputs, needed or not. The outputs come afterwards, so
        # that who sees those sees no subscription that is about to go.
        self._subscriptions_in_use = self._subscribe()
        self._unsubscribe()
        if self.DEMAND:
            self._intake.demand = Demand(self, self.DEMAND, outputs or self.OUTPUTS, self._on_ask)
        self._intake.requests = Requests(self, self.REQUESTS)
        super().start(outputs=outputs)
        self.update_subscriptions()

    def process(self, *messages: Any) -> Rest | None:
        """Make the outputs from one message per input, None for a missing optional one.

        It may return the second half of the work, which is done in another thread, while the next
        frame is begun.
        """
        raise NotImplementedError

    def needed(self) -> bool:
        """Tell whether inputs are to be received now."""
        return self.wanted(*self._outputs)

    def rig(
        self, left_info: Any, right_info: Any, left: Any, right: Any, *, rectified: bool = False
    ) -> StereoRig:
        """Return the rig of two CameraInfos; it is made again only when they change.

        The sizes of the arrays ``left`` and ``right`` are those of infos which state none. Of
        ``rectified`` images only P counts.
        """
        size, right_size = left.shape[1::-1], right.shape[1::-1]
        key = calibration_content(left_info), calibration_content(right_info), size, right_size
        if self._rig is None or self._rig[0] != key:
            self._rig = None
            sizes = {'size': size, 'right_size': right_size}
            rig = rig_from_messages(left_info, right_info, **sizes, rectified=rectified)
            self._rig = key, rig
            self.report_rig(rig)
        self.warn_of_rig(self._rig[1])
        return self._rig[1]

    def report_rig(self, rig: StereoRig) -> None:
        """Show the calibration in use in the diagnostics, and log once what was read otherwise."""
        self.health.state(
            'calibration',
            f'{rig.left.width}x{rig.left.height} px, f {rig.focal_px:.2f} px, baseline'
            f' {rig.baseline_m:.4f} m, cx_left - cx_right {rig.disparity_offset_px:.2f} px',
        )
        self.health.state('calibration read otherwise', '; '.join(rig.notices))
        for notice in rig.notices:
            self.get_logger().info(plain_text(notice))

    def warn_of_rig(self, rig: StereoRig) -> None:
        """Warn while frames are processed with a calibration that is probably wrong."""
        for warning in rig.warnings:
            self.health.warning(warning)

    def update_subscriptions(self) -> None:
        """Receive the inputs while they are needed, and only then."""
        needed = self.needed()
        if needed and not self._subscriptions_in_use:
            self._subscriptions_in_use = self._subscribe()
        elif not needed:
            self._unsubscribe()
        self._intake.update()
        self._on_ask()  # what was asked may be lost

    def condition(self) -> tuple[bytes, str]:
        """Return level and summary of the last second, and log what prevents frames."""
        processed = self._frames.processed()
        superseded = self._intake.superseded()
        if went_back := self._synchronizer.went_back():
            self.health.warning(went_back)
        if not self._subscriptions_in_use:
            return DiagnosticStatus.OK, f'idle: no subscribers on {", ".join(self._outputs)}'
        ages_s = self.health.silent()
        required = [topic for topic in self._inputs if topic not in self._optional]
        silent = {topic: ages_s[topic] for topic in required if topic in ages_s}
        level = DiagnosticStatus.ERROR
        if len(silent) == len(required):
            level = DiagnosticStatus.STALE
            text = f'no messages on {", ".join(silent)}; {self._who_is_silent(silent)}'
        elif silent:
            text = f'no messages on {_since(silent)}; {self._who_is_silent(silent)}'
        elif _SETS in ages_s:
            text = self.explain_missing_frames()
        elif too_late := self._explain_lateness():
            level, text = DiagnosticStatus.WARN, too_late
        elif superseded:
            level = DiagnosticStatus.WARN
            text = f'cannot keep up: dropped {counted(superseded, "frame")} in the last second'
        elif pausing := self.health.pausing(required):
            return DiagnosticStatus.WARN, f'no messages on {_since(pausing)}'
        else:
            return DiagnosticStatus.OK, f'{counted(processed, "frame")} in the last second'
        self.health.log(level, text)
        return level, text

    def dropped(self) -> Counter[str]:
        """Return the messages that found no partners."""
        return self._synchronizer.dropped

    def explain_missing_frames(self) -> str:
        """Say why there are no complete frames although every required input has messages."""
        if loss := self.health.loss():
            return loss
        silent = self.health.silent()
        unused = [t for t in self._optional if t in silent and self._is_published(t)]
        if unused:
            names = ', '.join(unused)
            return (
                f'frames wait for {names}, which has a publisher but no messages; check that'
                f' publisher or stop it: {names} is optional'
            )
        still = self._synchronizer.standing_still()
        if still:
            return f'{still}, or set pairing to arrival if a hardware trigger takes them'
        too_late = self._explain_lateness()
        if too_late:
            return too_late
        missing = self._synchronizer.explain()
        if missing is None:
            return (
                f'frames of {", ".join(self._inputs)} stay incomplete although their stamps match:'
                ' messages are lost; set reliability to reliable on both sides or raise queue_size'
            )
        return f'{missing.text}; {remedy(missing, self.options.of(InputOptions).tolerance_ns)}'

    def _explain_lateness(self) -> str:
        """Say which messages arrive after their partners were dropped, '' if none do."""
        needed = self._synchronizer.too_late()
        if not needed:
            return ''
        return (
            f'messages on {", ".join(needed)} arrive too late: their partners had already been'
            f' dropped; raise queue_size to at least {max(needed.values())}'
        )

    def _who_is_silent(self, silent: Collection[str]) -> str:
        """Say who publishes topics without messages, and what to do.

        A publisher that is there but sends nothing knows why better than this node.
        """
        publishers, images = set(), []
        for (topic, one), used in zip(
            self._inputs.items(), self._subscriptions_in_use, strict=True
        ):
            found = self.get_publishers_info_by_topic(used.topic_name) if topic in silent else ()
            publishers |= {f'{who.node_namespace.rstrip("/")}/{who.node_name}' for who in found}
            images += [topic] if found and one.transported else []
        if not publishers:
            return 'nobody publishes them: start the cameras or check the remappings'
        known = sorted(name for name in publishers if '/_' not in name)  # or not discovered yet
        text = (
            f'{", ".join(known) or "their publisher"} publishes them but sends nothing: its log'
            ' and its status on /diagnostics say why (for a camera: driver, cable, trigger)'
        )
        lost = f'; if images are sent on {", ".join(images)}, all are lost: {SHARED_MEMORY}'
        return text + lost if images else text

    def _is_published(self, optional: str) -> bool:
        return self.count_publishers(self._optional[optional]) > 0

    def _subscribe(self) -> list[Any]:
        self._synchronizer.clear()
        self.health.expect([*self._inputs, _SETS])
        return [
            create_input(
                self,
                one,
                functools.partial(self._receive, one.topic),
                self.health,
                compressed=self._compressed,
            )
            for one in self._inputs.values()
        ]

    def _unsubscribe(self) -> None:
        for subscription in self._subscriptions_in_use:
            self.destroy_subscription(subscription)
        self._subscriptions_in_use = []

    def _receive(self, topic: str, message: Any) -> None:
        self.health.received(topic)
        for optional in self._optional:
            self._synchronizer.expect(optional, self._is_published(optional))
        arrived_ns = time.monotonic_ns()
        for frame in self._synchronizer.add(topic, stamp_ns(message.header), message, arrived_ns):
            self.health.received(_SETS)
            self._intake.offer(frame)

    def _on_ask(self) -> None:
        self._intake.release()
        if self._subscriptions_in_use:
            self._intake.ask_if_idle()

    def _work(self, messages: tuple[Any, ...]) -> None:
        limit_threads(self.options.of(LoadOptions).threads)
        self._intake.work(self._frames.process, messages, asks_early=self.ASKS_EARLY)


def _since(ages_s: Mapping[str, float]) -> str:
    """Return topics, and since when each has been silent."""
    return ', '.join(f'{topic} for {age_s:.1f} s' for topic, age_s in ages_s.items())
