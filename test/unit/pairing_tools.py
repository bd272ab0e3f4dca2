# SPDX-License-Identifier: Apache-2.0
"""What test_pairing and test_late_messages share."""

from __future__ import annotations

import random
from collections.abc import Iterable
from typing import Any

from binocular_recon.pairing import Synchronizer

MS = 1_000_000


NAMES = ('left', 'left_info', 'right', 'right_info')


class Message:
    """Compares with nothing: a synchronizer that compares messages would fail."""

    def __init__(self, name: str, stamp_ns: int, run: int = 0) -> None:
        self.name, self.stamp_ns, self.run = name, stamp_ns, run

    def __eq__(self, other: object) -> bool:
        raise AssertionError('messages must not be compared')

    __hash__ = None  # type: ignore[assignment]

    def __bool__(self) -> bool:
        raise AssertionError('messages have no truth value')


def feed(synchronizer: Synchronizer, messages: Iterable[Message]) -> list[tuple[Any, ...]]:
    sets = []
    for message in messages:
        sets += synchronizer.add(message.name, message.stamp_ns, message)
    return sets


def interleaved(streams: list[list[Message]], generator: random.Random) -> list[Message]:
    """Merge streams at random; each keeps its own order, as on one topic."""
    streams, merged = [list(stream) for stream in streams], []
    while any(streams):
        stream = generator.choice([stream for stream in streams if stream])
        merged.append(stream.pop(0))
    return merged


def stamps(sets: list[tuple[Any, ...]]) -> list[tuple[int | None, ...]]:
    return [tuple(m.stamp_ns if m is not None else None for m in found) for found in sets]
