# SPDX-License-Identifier: Apache-2.0
"""Read bags: ROS 1, ROS 2 sqlite3 and mcap, without ROS.

Only this module, `bag_writer`, `_bag_sources`, `_bag_salvage` and `_ros1_conversion` know the
rosbags library.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import yaml
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from binocular_recon.errors import BagError
from binocular_recon.io.bags._ros1_conversion import Ros1Conversion
from binocular_recon.io.bags._salvage import kind_of
from binocular_recon.io.bags._sources import (
    DEFAULT_DEPTH,
    Message,
    Recorded,
    Salvaged,
    Source,
    Topic,
    TopicQos,
)

__all__ = ['Bag', 'BagMessage', 'Topic', 'TopicQos', 'decode', 'ros2_types']

_SUFFIXES = ('.mcap', '.db3', '.bag')


class BagMessage(NamedTuple):
    """A recorded message; ``cdr`` is serialised for ROS 2 whatever the bag's format."""

    topic: Topic
    stamp_ns: int
    cdr: bytes


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
        offers: defaultdict[tuple[str, str], list[TopicQos]] = defaultdict(list)
        for source in self._sources:
            for name, msgtype, count, offered in source.connections:
                counts[name, msgtype] += count
                offers[name, msgtype] += offered
        self.topics = [Topic(*key, counts[key], _together(offers[key])) for key in sorted(+counts)]
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

    def _as_ros2(self, source: Source, messages: Iterator[Message]) -> Iterator[Message]:
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

    def _open(self) -> Iterator[Source]:
        if not self.path.exists():
            raise BagError(f'{self.path} does not exist; check the path of the bag')
        if not self.path.is_dir():
            yield self._open_file(self.path)
            return
        files = self._listed_files()
        if any(path.suffix == '.zstd' for path in files):
            try:
                yield Recorded(self.path)  # which unpacks them
            except Exception as error:  # noqa: BLE001 - as above
                self._note_damage(self.path, error)
                files = []
            else:
                return
        files = files or sorted(path for path in self.path.iterdir() if path.suffix in _SUFFIXES)
        if not files:
            raise BagError('; '.join([*self._nothing_found(), *self.damage]))
        for path in files:
            try:
                yield self._open_file(path)
            except BagError as error:  # noqa: PERF203 - one file of many
                self.note(str(error))

    def _listed_files(self) -> list[Path]:
        """Return the files that metadata.yaml lists, none if there is none that fits.

        Each file is opened by itself, so that damage costs the end of one file only; all else
        that metadata.yaml says is in the files too.
        """
        metadata = self.path / 'metadata.yaml'
        if not metadata.exists():
            return []
        try:
            content = yaml.safe_load(metadata.read_bytes())['rosbag2_bagfile_information']
            files = [self.path / PurePath(name).name for name in content['relative_file_paths']]
        except Exception as error:  # noqa: BLE001 - as above
            self.note(f'{metadata} is damaged ({error}); all files beside it are read')
            return []
        missing = [path.name for path in files if not path.exists()]
        if missing:
            self.note(f'{", ".join(missing)} of {metadata} is missing; all files there are read')
            return []
        return files

    def _nothing_found(self) -> list[str]:
        problem = f'{self.path} holds no bag file ({", ".join(_SUFFIXES)})'
        if any(path.suffix == '.zstd' for path in self.path.iterdir()):
            return [problem, 'unpack its .zstd files with zstd -d: they need metadata.yaml']
        return [problem, 'give the folder or file that was recorded']

    def _open_file(self, path: Path) -> Source:
        kind = kind_of(path)
        try:
            return Recorded(path, ros1=kind == 'ros1')
        except Exception:  # noqa: BLE001 - as above
            return Salvaged(path, ros1=kind == 'ros1', note=self._note_damage)

    def _note_damage(self, path: Path, error: Exception) -> None:
        reason = str(error) or type(error).__name__
        self.note(f'{path} is damaged ({reason}); what precedes the damage is used')

    def note(self, sentence: str) -> None:
        """Add a sentence to `damage`, once."""
        if sentence not in self.damage:
            self.damage.append(sentence)


def _together(offers: list[TopicQos]) -> TopicQos:
    """Return what all recorded publishers of a topic together offered."""
    if not offers:
        return TopicQos()
    return TopicQos(
        reliable=any(offer.reliable for offer in offers),
        transient_local=any(offer.transient_local for offer in offers),
        depth=max(offer.depth for offer in offers) or DEFAULT_DEPTH,
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
