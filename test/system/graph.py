# SPDX-License-Identifier: Apache-2.0
"""Real node processes, and a node of the test's own that talks to them over DDS."""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from binocular_recon.io.messages.images import stamp_ns

with warnings.catch_warnings():  # the parser that it imports uses what Python 3.11 deprecates
    warnings.simplefilter('ignore', DeprecationWarning)
    import rosidl_generator_py  # type: ignore[import-untyped]  # noqa: F401

RELIABLE = QoSProfile(depth=200, reliability=ReliabilityPolicy.RELIABLE)
# Far more than anything takes: it ends a test whose event never happens.
TIMEOUT_S = 60.0


def wait_until(
    condition: Callable[[], Any], what: str, timeout_s: float = TIMEOUT_S, *, every_s: float = 0.01
) -> Any:
    """Return the first true value of a condition, or fail saying what did not happen.

    The condition is evaluated every ``every_s``; one that sends something sends at that rate.
    """
    end_s = time.monotonic() + timeout_s
    while time.monotonic() < end_s:
        value = condition()
        if value:
            return value
        time.sleep(every_s)  # the one place where tests sleep: between two looks
    raise AssertionError(f'not within {timeout_s:g} s: {what}')


def executable(name: str) -> str:
    """Return the path of a node: in the sourced workspace, else in the environment."""
    prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    installed = [Path(prefix, 'lib', 'binocular_recon', name) for prefix in prefixes if prefix]
    paths = [*installed, Path(sys.executable).parent / name]
    return str(next((path for path in paths if path.exists()), paths[-1]))


class NodeProcess:
    """A node's process; its log goes to a file."""

    def __init__(self, name: str, log: Path, **parameters: object) -> None:
        remaps = parameters.pop('remaps', {})
        namespace = parameters.pop('namespace', '/rig')
        assert isinstance(remaps, dict)
        command = [executable(name), '--ros-args']
        command += ['-r', f'__ns:={namespace}']
        for source, target in remaps.items():
            command += ['-r', f'{source}:={target}']
        for parameter, value in parameters.items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            command += ['-p', f'{parameter}:={text}']
        self.log = log
        with log.open('wb') as file:
            self.process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT)
        atexit.register(self.process.kill)  # none outlives the run, whatever fails in it
        self._killed = False

    def text(self) -> str:
        """Return what the node has logged."""
        return self.log.read_text()

    def stop(self, number: int = signal.SIGINT) -> int:
        """Interrupt the node and return its exit status, 0 if it was killed before.

        A node that does not end fails the test; the limit is far above what a busy machine takes.
        """
        if self._killed:
            return 0
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            return self.process.wait(TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            raise

    def kill(self) -> None:
        """End the node without warning, as a power cut does."""
        self.process.kill()
        self.process.wait()
        self._killed = True


class Inbox:
    """The messages of a topic."""

    def __init__(self) -> None:
        self.messages: list[Any] = []

    def wait(self, count: int = 1, timeout_s: float = TIMEOUT_S) -> list[Any]:
        """Return the messages once ``count`` have arrived."""
        wait_until(lambda: len(self.messages) >= count, f'{count} messages', timeout_s)
        return self.messages

    def by_stamp(self) -> dict[int, Any]:
        return {stamp_ns(message.header): message for message in self.messages}


class Graph:
    """The test's own node; a thread of it takes messages all the time."""

    def __init__(self, name: str = 'test') -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node: Any = Node(name, namespace='/rig', context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()
        self._publishers: dict[str, Any] = {}
        self._diagnostics = self.inbox('/diagnostics', DiagnosticArray)

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            while True:
                self._executor.spin_once()

    def close(self) -> None:
        """Leave the graph."""
        rclpy.shutdown(context=self.context)
        self._thread.join()
        self.node.destroy_node()

    def do(self, function: Callable[[], Any]) -> Any:
        """Call a function in the thread that spins: entities do not go away under its wait."""
        task = self._executor.create_task(function)
        wait_until(task.done, 'the thread that spins')
        return task.result()

    def inbox(self, topic: str, kind: type[Any], qos: QoSProfile = RELIABLE) -> Inbox:
        """Subscribe to a topic for good."""
        return self._subscribe(topic, kind, qos)[0]

    def _subscribe(self, topic: str, kind: type[Any], qos: QoSProfile) -> tuple[Inbox, Any]:
        inbox = Inbox()
        subscribe = partial(
            self.node.create_subscription,
            kind,
            topic,
            inbox.messages.append,
            qos,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )
        return inbox, self.do(subscribe)

    @contextmanager
    def listening(
        self, *topics: tuple[str, type[Any]], qos: QoSProfile = RELIABLE
    ) -> Iterator[list[Inbox]]:
        """Subscribe to topics of nodes that are there already, and wait for the match."""
        made = [self._subscribe(topic, kind, qos) for topic, kind in topics]
        for topic, _ in topics:
            wait_until(partial(self.node.count_publishers, topic), f'{topic} offered')
        try:
            yield [inbox for inbox, _ in made]
        finally:
            for _, subscription in made:
                self.do(partial(self.node.destroy_subscription, subscription))

    def publisher(self, topic: str, kind: type[Any], qos: QoSProfile = RELIABLE) -> Any:
        """Return a publisher, made once."""
        if topic not in self._publishers:
            create = partial(self.node.create_publisher, kind, topic, qos)
            self._publishers[topic] = self.do(create)
        return self._publishers[topic]

    def wait_for_subscriber(self, *topics: str) -> None:
        """Wait until a node listens to each of these topics that the test publishes."""
        for topic in topics:
            publisher = self._publishers[topic]
            wait_until(publisher.get_subscription_count, f'a subscriber of {topic}')

    def wait_for_matches(self, *topics: str, count: int = 1) -> None:
        """Wait until the test sees a publisher and ``count`` subscribers of each topic."""

        def matched() -> bool:
            return all(
                self.node.count_publishers(topic) and self.node.count_subscribers(topic) >= count
                for topic in topics
            )

        wait_until(matched, f'{count} subscribers of {", ".join(topics)}')

    def status(self, node: str, of: str = 'frames') -> DiagnosticStatus | None:
        """Return the newest status of a node."""
        for array in reversed(self._diagnostics.messages):
            for status in array.status:
                if status.name == f'{node.lstrip("/")}: {of}':
                    return status
        return None

    def next_status(self, *nodes: str) -> list[DiagnosticStatus]:
        """Return the next status of each node."""
        self._diagnostics.messages.clear()
        for node in nodes:
            wait_until(partial(self.status, node), f'a status of {node}')
        return [self.status(node) for node in nodes]

    def wait_for_status(self, node: str, text: str, timeout_s: float = TIMEOUT_S) -> Any:
        """Return the first status from now on whose message holds ``text``."""
        self._diagnostics.messages.clear()

        def found() -> DiagnosticStatus | None:
            status = self.status(node)
            return status if status is not None and text in status.message else None

        try:
            return wait_until(found, f'status of {node} with {text!r}', timeout_s)
        except AssertionError as error:
            last = self.status(node)
            raise AssertionError(f'{error}; the last: {last and last.message}') from None

    def set_parameters(self, node: str, **values: Any) -> str:
        """Set parameters of a node at once; return '' or the reason of the refusal."""
        parameters = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        request = SetParametersAtomically.Request(parameters=parameters)
        result = self.call(f'{node}/set_parameters_atomically', SetParametersAtomically, request)
        return '' if result.result.successful else result.result.reason

    def get_parameters(self, node: str, *names: str) -> list[Any]:
        """Return values of a node's parameters."""
        request = GetParameters.Request(names=list(names))
        result = self.call(f'{node}/get_parameters', GetParameters, request)
        return [
            Parameter.from_parameter_msg(_named(name, value)).value
            for name, value in zip(names, result.values, strict=True)
        ]

    def call(self, service: str, kind: type[Any], request: Any) -> Any:
        """Call a service and return its answer."""
        client = self.do(partial(self.node.create_client, kind, service))
        assert client.wait_for_service(TIMEOUT_S), f'no service {service}'
        future = client.call_async(request)
        wait_until(future.done, f'answer of {service}')
        self.do(partial(self.node.destroy_client, client))
        return future.result()


def _named(name: str, value: Any) -> Any:
    from rcl_interfaces.msg import Parameter as ParameterMessage

    return ParameterMessage(name=name, value=value)
