# SPDX-License-Identifier: Apache-2.0
"""SQLite files of bags, where rosbags does not read them: damaged, or with a journal."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from binocular_recon.errors import BagError

# What SQLite adds to the name of a file for messages that are not in it yet, or may be undone.
_JOURNALS = ('-wal', '-journal')
# SQLite keeps a value of any type in any column.
_NO_TEXT = "SELECT 1 FROM topics WHERE typeof(name) <> 'text' OR typeof(type) <> 'text'"
_TOPICS = (
    "SELECT id, coalesce(CAST(name AS TEXT), ''), coalesce(CAST(type AS TEXT), '') FROM topics"
)
# By rowid, in the order of the pages: the index on the timestamps may be lost.
_MESSAGES = """
    SELECT topic_id, coalesce(CAST(timestamp AS INTEGER), 0), coalesce(CAST(data AS BLOB), x'')
    FROM messages ORDER BY id
"""
# What reading a damaged file raises: SQLite's messages quote names of it, UTF-8 or not.
DAMAGE = (sqlite3.Error, UnicodeDecodeError)


def has_journal(path: Path) -> bool:
    """Tell whether the recorder left messages in a journal beside a file."""
    return any(
        journal.is_file() and journal.stat().st_size
        for journal in (path.with_name(path.name + end) for end in _JOURNALS)
    )


def can_be_read(path: Path) -> bool:
    """Tell whether a file can be read where it is, with its journal."""
    try:
        with closing(_connect(path)) as database:
            database.execute('SELECT 1 FROM sqlite_master').fetchone()
    except DAMAGE:
        return False
    return True


def merge_journal(path: Path, folder: Path) -> Path:
    """Copy a file and its journal into a folder, merge them there and return the copy.

    Raises a BagError if they cannot be copied, or do not belong together.
    """
    copy = folder / path.name
    try:
        for end in ('', *_JOURNALS):
            source = path.with_name(path.name + end)
            if source.is_file():
                shutil.copyfile(source, folder / source.name)
        with closing(sqlite3.connect(copy)) as database:
            database.execute('PRAGMA journal_mode=DELETE')
    except (OSError, *DAMAGE) as error:
        raise BagError(
            f'{path} cannot be merged with its journal in {folder}: {error}; open it once with'
            ' sqlite3, or free the disk'
        ) from error
    return copy


def check_tables(path: Path) -> None:
    """Raise a BagError if a file computes its messages: that may never end, or fill the memory.

    Raises one of `DAMAGE` if it is damaged.
    """
    with closing(_connect(path)) as database:
        kinds = database.execute(
            "SELECT name, type FROM sqlite_master WHERE name IN ('messages', 'topics')"
        ).fetchall()
        for name, kind in kinds:
            generated = any(row[6] for row in database.execute(f"PRAGMA table_xinfo('{name}')"))
            if kind != 'table' or generated:
                found = kind if kind != 'table' else 'table with generated columns'
                raise BagError(
                    f'{path}: {name!r} is a {found}, not a table as recorders write it; record the'
                    ' bag again'
                )
        if database.execute(_NO_TEXT).fetchone():
            raise sqlite3.DataError('the name or type of a topic is no text')


def scan_tables(path: Path) -> Iterator[tuple[str, str, str, int, bytes]]:
    """Yield topic, type, definition (empty), time and bytes of each message.

    Raises one of `DAMAGE` where the file is damaged, after the last message if some belong to no
    topic.
    """
    with closing(_connect(path)) as database:
        # Without this, SQLite refuses a file shorter than its first page says.
        database.execute('PRAGMA writable_schema=ON')
        topics = {row[0]: row[1:] for row in database.execute(_TOPICS)}
        lost = 0
        for topic_id, stamp_ns, data in database.execute(_MESSAGES):
            if topic_id in topics:
                yield *topics[topic_id], '', stamp_ns, data
            else:
                lost += 1
        if lost:
            raise sqlite3.DataError(f'messages of no topic: {lost}')


def _connect(path: Path) -> sqlite3.Connection:
    database = sqlite3.connect(f'{path.resolve().as_uri()}?mode=ro', uri=True)
    database.text_factory = lambda data: data.decode(errors='replace')  # damaged names
    return database
