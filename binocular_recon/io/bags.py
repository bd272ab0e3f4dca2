# SPDX-License-Identifier: Apache-2.0
"""Read bags: ROS 1, ROS 2 sqlite3 and mcap, without ROS.

Only this module, `bag_writer`, `_bag_salvage` and `_ros1_conversion` know the rosbags library.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from rosbags.interfaces import Connection, ConnectionExtRosbag1, QosDurability, QosReliability
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from binocular_recon.errors import BagError
from binocular_recon.io import _bag_salvage
from binocular_recon.io._ros1_conversion import Ros1Conversion

_SUFFIXES = ('.mcap', '.db3', '.bag')
# DDS does not tell the depth of a publisher, so recorders store 0: rclpy's usual depth then.
_DEFAULT_DEPTH = 10


class TopicQos(NamedTuple):
    """Quality of service that a topic was offered with."""

    reliable: bool = True
    transient_local: bool = False
    depth: int = _DEFAULT_DEPTH


class Topic(NamedTuple):
    """A topic of a bag."""

    name: str
    msgtype: str
    message_count: int
    qos: TopicQos


class BagMessage(NamedTuple):
    """A recorded message; ``cdr`` is serialised for ROS 2 whatever the bag's format."""

    topic: Topic
    stamp_ns: int
    cdr: bytes


# A message as its file holds it.
_Raw = tuple[Topic, int, bytes]


class _Source(Protocol):
    """A file or folder with messages."""

    path: Path
    topics: list[Topic]
    start_ns: int
    ros1: bool
    definitions: dict[str, str]

    def messages(self, topics: Collection[Topic]) -> Iterator[_Raw]: ...

    def close(self) -> None: ...


class Bag(AbstractContextManager['Bag']):
    """A bag that is open for reading.

    Parameters
    ----------
    path : Path
        Folder of a ROS 2 bag (``metadata.yaml`` may be missing), ``.mcap``, ``.db3`` or ROS 1
        ``.bag`` file.

    Attributes
    ----------
    path : Path
    topics : list of Topic
        Topics with at least one message, sorted by name.
    damage : list of str
        What could not be read, in sentences; grows while messages are read.

    Raises
    ------
    BagError
        If there is no bag or no message in it.

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage: list[str] = []
        self._sources = sorted(self._open(), key=lambda source: source.start_ns)
        counts: Counter[tuple[str, str]] = Counter()
        qos = {}
        for topic in (topic for source in self._sources for topic in source.topics):
            counts[topic.name, topic.msgtype] += topic.message_count
            qos[topic.name, topic.msgtype] = topic.qos
        self.topics = [Topic(*key, counts[key], qos[key]) for key in sorted(+counts)]
        if not self.topics:
            self.close()
            raise BagError('; '.join([f'{path} holds no message', *self.damage]))

    def messages(self, topics: Collection[Topic] = ()) -> Iterator[BagMessage]:
        """Yield messages in the order of recording; the bag is never in memory as a whole.

        Parameters
        ----------
        topics : collection of Topic, optional
            Topics wanted; all by default.

        Yields
        ------
        message : BagMessage
            Where a file is damaged, its messages end and `damage` says so.

        """
        wanted = topics or self.topics
        for source in self._sources:
            messages = source.messages(wanted)
            try:
                for message in self._as_ros2(source, messages) if source.ros1 else messages:
                    yield BagMessage(*message)
            except Exception as error:  # noqa: BLE001 - decoders of damaged data raise all kinds
                self._note_damage(source.path, error)

    def close(self) -> None:
        """Close the files."""
        for source in self._sources:
            source.close()

    def __exit__(self, *error: object) -> None:
        """Close the files."""
        self.close()

    def _as_ros2(self, source: _Source, messages: Iterator[_Raw]) -> Iterator[_Raw]:
        convert = Ros1Conversion(source.definitions, ros2_types())
        refused = set()
        for topic, stamp_ns, data in messages:
            if topic in refused:
                continue
            try:
                yield topic, stamp_ns, convert(topic.msgtype, data)
            except Exception as error:  # noqa: BLE001 - definitions may hold anything
                refused.add(topic)
                self.note(f'{topic.name} is left out: {topic.msgtype} has no ROS 2 form: {error}')

    def _open(self) -> Iterator[_Source]:
        if not self.path.exists():
            raise BagError(f'{self.path} does not exist; check the path of the bag')
        if not self.path.is_dir():
            yield self._open_file(self.path)
            return
        if (self.path / 'metadata.yaml').exists():
            try:
                yield _Recorded(self.path)
            except Exception as error:  # noqa: BLE001 - as above
                self._note_damage(self.path, error)
            else:
                return
        files = sorted(path for path in self.path.iterdir() if path.suffix in _SUFFIXES)
        if not files:
            raise BagError('; '.join([*self._nothing_found(), *self.damage]))
        for path in files:
            try:
                yield self._open_file(path)
            except BagError as error:  # noqa: PERF203 - one file of many
                self.note(str(error))

    def _nothing_found(self) -> list[str]:
        problem = f'{self.path} holds no bag file ({", ".join(_SUFFIXES)})'
        if any(path.suffix == '.zstd' for path in self.path.iterdir()):
            return [problem, 'unpack its .zstd files with zstd -d: they need metadata.yaml']
        return [problem, 'give the folder or file that was recorded']

    def _open_file(self, path: Path) -> _Source:
        kind = _bag_salvage.kind_of(path)
        try:
            return _Recorded(path, ros1=kind == 'ros1')
        except Exception:  # noqa: BLE001 - as above
            return _Salvaged(path, ros1=kind == 'ros1', note=self._note_damage)

    def _note_damage(self, path: Path, error: Exception) -> None:
        reason = str(error) or type(error).__name__
        self.note(f'{path} is damaged ({reason}); what precedes the damage is used')

    def note(self, sentence: str) -> None:
        """Add a sentence to `damage`, once."""
        if sentence not in self.damage:
            self.damage.append(sentence)


class _Recorded:
    """A bag, or one file of it, as the rosbags library reads it."""

    def __init__(self, path: Path, *, ros1: bool = False) -> None:
        self.path, self.ros1 = path, ros1
        self._reader = Ros1Reader(path) if ros1 else Ros2Reader(path)
        self._reader.open()
        connections = self._reader.connections
        self.start_ns = self._reader.start_time
        self.topics = [Topic(x.topic, x.msgtype, x.msgcount, _qos(x)) for x in connections]
        self.definitions = {x.msgtype: x.msgdef.data for x in connections}

    def messages(self, topics: Collection[Topic]) -> Iterator[_Raw]:
        by_key = {(topic.name, topic.msgtype): topic for topic in topics}
        wanted = [x for x in self._reader.connections if (x.topic, x.msgtype) in by_key]
        if wanted:  # none means all to rosbags
            for connection, stamp_ns, data in self._reader.messages(wanted):
                yield by_key[connection.topic, connection.msgtype], stamp_ns, data

    def close(self) -> None:
        self._reader.close()


class _Salvaged:
    """A file that rosbags cannot open, read from its start to the damage."""

    def __init__(self, path: Path, *, ros1: bool, note: Callable[[Path, Exception], None]) -> None:
        self.path, self.ros1 = path, ros1
        self.start_ns = 2**63 - 1
        self.definitions = {}
        counts: Counter[tuple[str, str]] = Counter()
        try:
            for message in _bag_salvage.scan(path):
                counts[message.topic, message.msgtype] += 1
                self.start_ns = min(self.start_ns, message.stamp_ns)
                self.definitions[message.msgtype] = message.definition
        except Exception as error:  # noqa: BLE001 - as above
            note(path, error)
        self.topics = [Topic(*key, count, TopicQos()) for key, count in counts.items()]

    def messages(self, topics: Collection[Topic]) -> Iterator[_Raw]:
        by_key = {(topic.name, topic.msgtype): topic for topic in topics}
        for message in _bag_salvage.scan(self.path):
            topic = by_key.get((message.topic, message.msgtype))
            if topic:
                yield topic, message.stamp_ns, message.data

    def close(self) -> None:
        """Nothing stays open."""


def _qos(connection: Connection) -> TopicQos:
    """Return what all recorded publishers of a topic together offered."""
    if isinstance(connection.ext, ConnectionExtRosbag1):
        return TopicQos(transient_local=bool(connection.ext.latching))
    offers = connection.ext.offered_qos_profiles
    if not offers:
        return TopicQos()
    return TopicQos(
        reliable=any(offer.reliability != QosReliability.BEST_EFFORT for offer in offers),
        transient_local=any(offer.durability == QosDurability.TRANSIENT_LOCAL for offer in offers),
        depth=max(offer.depth for offer in offers) or _DEFAULT_DEPTH,
    )


@cache
def ros2_types() -> Typestore:
    """Return ROS 2's message types; images and camera infos are alike in all distributions."""
    return get_typestore(Stores.ROS2_JAZZY)


def decode(msgtype: str, cdr: bytes) -> Any:
    """Return a serialised message as a dataclass with the message's members.

    Raises a BagError if the bytes are no such message.
    """
    try:
        return ros2_types().deserialize_cdr(cdr, msgtype)
    except (SerdeError, AssertionError, IndexError) as error:
        raise BagError(f'message is damaged: {error}') from error
