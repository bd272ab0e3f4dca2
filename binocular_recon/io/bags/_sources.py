# SPDX-License-Identifier: Apache-2.0
"""The files of bags: intact ones as the rosbags library reads them, and damaged ones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

from rosbags.interfaces import Connection, ConnectionExtRosbag1, QosDurability, QosReliability
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader

from binocular_recon.errors import BagError
from binocular_recon.io.bags._decompression import decompressed_message
from binocular_recon.io.bags._salvage import scan_messages

# DDS does not transmit the depth of a publisher, so recorders store 0; rclpy's usual depth then.
DEFAULT_DEPTH = 10


class TopicQos(NamedTuple):
    """Quality of service that the publishers of a topic offered."""

    reliable: bool = True
    transient_local: bool = False
    depth: int = DEFAULT_DEPTH


class Topic(NamedTuple):
    """A topic of a bag."""

    name: str
    msgtype: str
    message_count: int
    qos: TopicQos


# Encodings of messages that can be read, by their names in MCAP.
_ENCODINGS = ('cdr', 'ros1')
# A message as stored in its file: topic, time of recording in ns, bytes.
Message = tuple[Topic, int, bytes]


class RecordedTopic(NamedTuple):
    """A topic in one file, and the quality of service that each publisher offered."""

    name: str
    msgtype: str
    message_count: int
    offers: list[TopicQos]


class Source(Protocol):
    """A file or folder with messages."""

    path: Path
    connections: list[RecordedTopic]
    start_ns: int
    ros1: bool
    definitions: dict[str, str]

    def messages(self, topics: Collection[Topic]) -> Iterator[Message]: ...

    def close(self) -> None: ...


class IntactSource:
    """A bag, or one file of it, read by the rosbags library."""

    def __init__(self, path: Path, *, ros1: bool = False) -> None:
        self.path, self.ros1 = path, ros1
        self._reader = Ros1Reader(path) if ros1 else Ros2Reader(path)
        self._reader.open()
        recorded = self._reader.connections
        self.start_ns = self._reader.start_time
        self.connections = [
            RecordedTopic(x.topic, x.msgtype, x.msgcount, _offers(x)) for x in recorded
        ]
        self.definitions = {x.msgtype: x.msgdef.data for x in recorded}

    @property
    def complete(self) -> bool:
        """Whether every message of the file belongs to a topic; the others are not read."""
        return self._reader.message_count <= sum(topic.message_count for topic in self.connections)

    def messages(self, topics: Collection[Topic]) -> Iterator[Message]:
        by_key = {(topic.name, topic.msgtype): topic for topic in topics}
        wanted = [x for x in self._reader.connections if (x.topic, x.msgtype) in by_key]
        if wanted:  # rosbags reads all topics if none is given
            for connection, stamp_ns, data in self._reader.messages(wanted):
                topic = by_key[connection.topic, connection.msgtype]
                yield topic, stamp_ns, data if self.ros1 else decompressed_message(data)

    def close(self) -> None:
        self._reader.close()


class DamagedSource:
    """A file that rosbags cannot open, read from its start, up to the damage if there is any.

    Raises a BagError if the messages are neither those of ROS 1 nor of ROS 2.
    """

    def __init__(self, path: Path, *, note: Callable[[Path, Exception], None]) -> None:
        self.path = path
        self.start_ns = 2**63 - 1
        self.definitions = {}
        counts: Counter[tuple[str, str]] = Counter()
        foreign: dict[str, str] = {}
        encodings = set()
        try:
            for message in scan_messages(path):
                if message.encoding not in _ENCODINGS:
                    foreign[message.topic] = f'{message.msgtype or "no type"}, {message.encoding}'
                    continue
                encodings.add(message.encoding)
                counts[message.topic, message.msgtype] += 1
                self.start_ns = min(self.start_ns, message.stamp_ns)
                self.definitions[message.msgtype] = message.definition
        except Exception as error:  # noqa: BLE001 - damaged data raise errors of any type
            note(path, error)
        if foreign and not counts:
            names = ', '.join(f'{topic} ({kind})' for topic, kind in sorted(foreign.items()))
            raise BagError(
                f'{path} holds {names}: only messages of ROS 1 and ROS 2 are read; record or'
                ' convert it as a ROS 2 bag'
            )
        self.ros1 = encodings == {'ros1'}
        self.connections = [RecordedTopic(*key, count, []) for key, count in counts.items()]

    def messages(self, topics: Collection[Topic]) -> Iterator[Message]:
        by_key = {(topic.name, topic.msgtype): topic for topic in topics}
        for message in scan_messages(self.path):
            topic = by_key.get((message.topic, message.msgtype))
            if topic:
                yield topic, message.stamp_ns, message.data

    def close(self) -> None:
        """Do nothing: no file stays open."""


def _offers(connection: Connection) -> list[TopicQos]:
    """Return the quality of service that each publisher of a connection offered."""
    if isinstance(connection.ext, ConnectionExtRosbag1):
        return [TopicQos(transient_local=bool(connection.ext.latching))]
    return [
        TopicQos(
            reliable=offer.reliability != QosReliability.BEST_EFFORT,
            transient_local=offer.durability == QosDurability.TRANSIENT_LOCAL,
            depth=offer.depth,
        )
        for offer in connection.ext.offered_qos_profiles
    ]
