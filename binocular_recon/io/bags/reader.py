# SPDX-License-Identifier: Apache-2.0
"""Read bags: ROS 1, ROS 2 sqlite3 and mcap, without ROS."""

from __future__ import annotations

import tempfile
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager, suppress
from functools import cache
from pathlib import Path, PurePath
from typing import Any, NamedTuple

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from binocular_recon.errors import BagError, plain_text
from binocular_recon.io.bags._decompression import unpack_file
from binocular_recon.io.bags._ros1_conversion import Ros1Conversion
from binocular_recon.io.bags._salvage import check_index, file_format, is_compressed
from binocular_recon.io.bags._sources import (
    DEFAULT_DEPTH,
    DamagedSource,
    IntactSource,
    Message,
    Source,
    Topic,
    TopicQos,
)
from binocular_recon.io.bags._sqlite import (
    DAMAGE,
    can_be_read,
    check_tables,
    has_journal,
    merge_journal,
)
from binocular_recon.io.text_files import read_yaml

__all__ = ['Bag', 'BagMessage', 'Topic', 'TopicQos', 'decode', 'ros2_types']

_SUFFIXES = ('.mcap', '.db3', '.bag')
_PACKED = ('.zstd', '.zst')


class BagMessage(NamedTuple):
    """A recorded message; ``cdr`` holds ROS 2 bytes whatever the format of the bag."""

    topic: Topic
    stamp_ns: int
    cdr: bytes


class Bag(AbstractContextManager['Bag']):
    """A bag, open for reading.

    Parameters
    ----------
    path : Path
        Folder of a ROS 2 bag (``metadata.yaml`` may be missing), ``.mcap``, ``.db3`` or ROS 1
        ``.bag`` file; also one of these compressed by zstd.

    Attributes
    ----------
    path : Path
    topics : list of Topic
        Topics with at least one message, sorted by name.
    damage : list of str
        Sentences about what could not be read; grows while messages are read.

    Raises
    ------
    BagError
        If the path is not a bag, or the bag holds no message.

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage: list[str] = []
        self._unpacked: list[tempfile.TemporaryDirectory[str]] = []
        self._sources: list[Source] = []
        try:
            self._sources = sorted(self._open(), key=lambda source: source.start_ns)
        except BaseException:
            self.close()
            raise
        counts: Counter[tuple[str, str]] = Counter()
        offers: defaultdict[tuple[str, str], list[TopicQos]] = defaultdict(list)
        for source in self._sources:
            for name, msgtype, count, offered in source.connections:
                counts[name, msgtype] += count
                offers[name, msgtype] += offered
        self.topics = [
            Topic(*key, counts[key], _combined_qos(offers[key])) for key in sorted(+counts)
        ]
        if not self.topics:
            self.close()
            raise BagError('; '.join([f'{path} holds no message', *self.damage]))

    def messages(self, topics: Collection[Topic] = ()) -> Iterator[BagMessage]:
        """Yield messages in the order of recording, without loading the whole bag.

        Parameters
        ----------
        topics : collection of Topic, optional
            Topics to read; all by default.

        Yields
        ------
        message : BagMessage
            Those of a damaged file end at the damage, which is added to `damage`.

        """
        wanted = topics or self.topics
        for source in self._sources:
            read: Counter[tuple[str, str]] = Counter()
            messages = _counted(source.messages(wanted), read)
            try:
                for message in self._as_ros2(source, messages) if source.ros1 else messages:
                    yield BagMessage(*message)
            except Exception as error:  # noqa: BLE001 - damaged data raise errors of any type
                self._note_damage(source.path, error)
            else:
                self._compare_with_index(source, wanted, read)

    def _compare_with_index(
        self, source: Source, wanted: Collection[Topic], read: Counter[tuple[str, str]]
    ) -> None:
        """Note topics of which fewer messages came than the file's index lists."""
        listed: Counter[tuple[str, str]] = Counter()
        for name, msgtype, count, _ in source.connections:
            listed[name, msgtype] += count
        for topic in wanted:
            key = topic.name, topic.msgtype
            if read[key] < listed[key]:
                self.note(
                    f'{source.path} is damaged: {read[key]} of the {listed[key]} messages on'
                    f' {topic.name} that its index lists could be read'
                )

    def close(self) -> None:
        """Close the files."""
        for source in self._sources:
            source.close()
        for folder in self._unpacked:
            folder.cleanup()

    def __exit__(self, *error: object) -> None:
        """Close the files."""
        self.close()

    def _as_ros2(self, source: Source, messages: Iterator[Message]) -> Iterator[Message]:
        convert = Ros1Conversion(source.definitions, ros2_types())
        inconvertible = set()
        for topic, stamp_ns, data in messages:
            if topic in inconvertible:
                continue
            try:
                yield topic, stamp_ns, convert(topic.msgtype, data)
            except Exception as error:  # noqa: BLE001 - definitions may hold anything
                inconvertible.add(topic)
                self.note(
                    f'{topic.name} is left out: {topic.msgtype} cannot be converted: {error}'
                )

    def _open(self) -> Iterator[Source]:
        if not self.path.exists():
            raise BagError(f'{self.path} does not exist; check the path of the bag')
        if not self.path.is_dir():
            yield self._open_file(self.path)
            return
        files = self._listed_files()
        files = files or sorted(path for path in self.path.iterdir() if _is_bag_file(path))
        if not files:
            raise BagError('; '.join([*self._nothing_found(), *self.damage]))
        for path in files:
            try:
                yield self._open_file(path)
            except BagError as error:  # noqa: PERF203 - one file of many
                self.note(str(error))

    def _listed_files(self) -> list[Path]:
        """Return the files that metadata.yaml lists; none if it is absent or does not fit.

        Each file is opened by itself, so that damage costs the end of one file only; the rest of
        metadata.yaml is in the files too.
        """
        metadata = self.path / 'metadata.yaml'
        if not metadata.exists():
            return []
        try:
            content = read_yaml(metadata, 'its files are read')['rosbag2_bagfile_information']
            names = [PurePath(name).name for name in content['relative_file_paths']]
            files = [self.path / name for name in dict.fromkeys(names)]
        except Exception as error:  # noqa: BLE001 - damaged data raise errors of any type
            self.note(f'{metadata} is damaged ({error}); all files in its folder are read')
            return []
        missing = [path.name for path in files if not path.exists()]
        if missing:
            lost = ', '.join(missing)
            self.note(f'{metadata} lists missing files: {lost}; all files in its folder are read')
            return []
        return files

    def _nothing_found(self) -> list[str]:
        problem = f'{self.path} holds no bag file ({", ".join(_SUFFIXES)})'
        return [problem, 'give the folder or file that was recorded']

    def _open_file(self, path: Path) -> Source:
        if not path.is_file():
            raise BagError(
                f'{path} is not a regular file; give a file or folder that was recorded'
            )
        if is_compressed(path):
            path = unpack_file(path, self._temporary_folder())
        kind = file_format(path)
        if kind == 'sqlite3':
            return self._open_sqlite(path)
        try:
            if kind == 'mcap':
                check_index(path)
            return IntactSource(path, ros1=kind == 'ros1')
        except BagError as error:
            self._note_damage(path, error)
            return DamagedSource(path, note=self._note_damage)
        except Exception:  # noqa: BLE001 - damaged data raise errors of any type
            return DamagedSource(path, note=self._note_damage)

    def _open_sqlite(self, path: Path) -> Source:
        journal = has_journal(path)
        if journal and not can_be_read(path):
            path, journal = merge_journal(path, self._temporary_folder()), False
        with suppress(*DAMAGE):  # damage is found below
            check_tables(path)
            if not journal:  # which rosbags would leave out
                with suppress(Exception):  # as above
                    source = IntactSource(path)
                    if source.complete:
                        return source
                    source.close()
        return DamagedSource(path, note=self._note_damage)

    def _temporary_folder(self) -> Path:
        folder = tempfile.TemporaryDirectory(prefix='binocular_recon_')
        self._unpacked.append(folder)
        return Path(folder.name)

    def _note_damage(self, path: Path, error: Exception) -> None:
        reason = str(error) or type(error).__name__
        self.note(f'{path} is damaged ({reason}); messages before the damage are used')

    def note(self, sentence: str) -> None:
        """Add a sentence to `damage`, once."""
        sentence = plain_text(sentence)
        if sentence not in self.damage:
            self.damage.append(sentence)


def _counted(messages: Iterator[Message], read: Counter[tuple[str, str]]) -> Iterator[Message]:
    """Pass messages on, and count them by topic name and type."""
    for message in messages:
        read[message[0].name, message[0].msgtype] += 1
        yield message


def _is_bag_file(path: Path) -> bool:
    """Tell by its name whether a file is one of a bag, as recorded or compressed as a whole."""
    name = path.with_suffix('') if path.suffix in _PACKED else path
    return name.suffix in _SUFFIXES


def _combined_qos(offers: list[TopicQos]) -> TopicQos:
    """Return the strongest quality of service that any publisher of a topic offered."""
    if not offers:
        return TopicQos()
    return TopicQos(
        reliable=any(offer.reliable for offer in offers),
        transient_local=any(offer.transient_local for offer in offers),
        depth=max(offer.depth for offer in offers) or DEFAULT_DEPTH,
    )


@cache
def ros2_types() -> Typestore:
    """Return the message types of ROS 2; those used here are the same in all distributions."""
    return get_typestore(Stores.ROS2_JAZZY)


def decode(msgtype: str, cdr: bytes) -> Any:
    """Return a serialised message as a dataclass with the members of the message.

    Raises a BagError if the bytes are not a message of this type.
    """
    try:
        return ros2_types().deserialize_cdr(cdr, msgtype)
    except (SerdeError, AssertionError, IndexError) as error:
        raise BagError(f'message is damaged: {error}') from error
