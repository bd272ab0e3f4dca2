# SPDX-License-Identifier: Apache-2.0
"""Read files that anybody may have written: text, YAML and JSON with limits.

A file is refused before it costs more time or memory than what it may hold needs: it has a
largest size, a largest depth and, in YAML, no aliases, which could stand for any number of values.
"""

from __future__ import annotations

import errno
import json
import os
import stat
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
import yaml

from binocular_recon.errors import BinocularReconError, FileError, shortened

# The files of a calibration have 10 to 100 kB.
LARGEST_YAML, _LARGEST_JSON = 1_000_000, 5_000_000
_DEEPEST = 50
# PyYAML needs half a second for so many values.
_MOST_VALUES = 30_000
# Python needs a second for so many values and lists.
_MOST_JSON_VALUES = 3_000_000
# Longer numbers take the time of their square.
_LONGEST_NUMBER = 100


def open_file(path: Path) -> BinaryIO:
    """Open a file for reading.

    What is none, such as a pipe or a device, may never end, and raises an OSError.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe is not waited for
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, 'it is not a file')
    return os.fdopen(handle, 'rb')


def read_bytes(path: Path, remedy: str, largest: int) -> bytes:
    """Return the content of a file.

    Parameters
    ----------
    path : Path
        A file; what is none, such as a pipe, may never end and is refused.
    remedy : str
        What to give instead, for the error.
    largest : int
        Largest size, bytes.

    Raises
    ------
    FileError
        If the file cannot be read or is larger; the message begins with the path.

    """
    try:
        with open_file(path) as file:
            data = file.read(largest + 1)
    except OSError as error:
        raise FileError(f'{path} cannot be read: {error.strerror or error}; {remedy}') from error
    except ValueError as error:  # a path with a null character
        raise FileError(f'{str(path)!r} cannot be read: {error}; {remedy}') from error
    check_size(path, data, remedy, largest)
    return data


def check_size(path: Path, data: bytes, remedy: str, largest: int) -> None:
    """Raise a FileError if the content of a file has more than ``largest`` bytes."""
    if len(data) > largest:
        raise FileError(
            f'{path} has more than {largest / 1e6:.3g} MB, the limit of such files; {remedy}'
        )


def read_text(path: Path, remedy: str, largest: int) -> str:
    """Return the text of a file in UTF-8, with or without a byte order mark.

    Raises a FileError as `read_bytes`, and if the file is not text.
    """
    return decoded(path, read_bytes(path, remedy, largest), remedy)


def decoded(path: Path, data: bytes, remedy: str) -> str:
    """Return the content of a file as text; raises a FileError if it is not UTF-8."""
    try:
        return data.decode('utf-8-sig')
    except UnicodeDecodeError as error:
        raise FileError(
            f'{path} cannot be read: byte {error.start} is not UTF-8; {remedy}'
        ) from error


def read_yaml(path: Path, remedy: str) -> Any:
    """Return the content of a YAML file: mappings, lists, text, numbers, dates or None.

    Raises a FileError as `read_text`, and if the file is not YAML, is nested too deeply, or has
    aliases.
    """
    text = read_text(path, remedy, LARGEST_YAML)
    try:
        return parse_yaml(text)
    except FileError as error:
        raise FileError(f'{path} {error}; {remedy}') from error


def parse_yaml(text: str) -> Any:
    """Return the content of a YAML text; raises a FileError as `read_yaml`."""
    try:
        check_structure(text)
        return yaml.load(text, _Loader)  # noqa: S506 - a safe loader
    except FileError:
        raise
    except yaml.YAMLError as error:
        mark = getattr(error, 'problem_mark', None)
        line = f'line {mark.line + 1}: ' if mark else ''
        reason = shortened(Exception(getattr(error, 'problem', None) or error))
        raise FileError(f'is not valid YAML: {line}{reason}') from error
    # the constructors of dates, sets and keys raise what they like
    except (ValueError, TypeError, LookupError, AttributeError, ArithmeticError) as error:
        raise FileError(
            f'is not valid YAML: a value cannot be read ({shortened(error)})'
        ) from error


def check_structure(text: str, *, aliases: bool = False) -> None:
    """Raise a FileError if a YAML text has too many values, is nested too deeply or has aliases.

    Who lets ``aliases`` through counts what they stand for.
    """
    depth = 0
    for count, event in enumerate(_events(text)):
        if count > _MOST_VALUES:
            raise FileError(f'holds more than {_MOST_VALUES} values, the limit')
        if isinstance(event, yaml.AliasEvent) and not aliases:
            raise FileError(
                f'has an alias in line {_line(event)}, which could stand for any number of values;'
                ' write them out'
            )
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > _DEEPEST:
            raise FileError(f'is nested too deeply: {_DEEPEST} levels in line {_line(event)}')


def _events(text: str) -> Iterator[yaml.Event]:
    try:
        yield from yaml.parse(text, _Loader)
    except yaml.MarkedYAMLError as error:
        if 'nesting depth' not in str(error):  # libyaml has a limit of its own
            raise
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise FileError(f'is nested too deeply: {_DEEPEST} levels in line {line}') from error


def _line(event: yaml.Event) -> int:
    return event.start_mark.line + 1 if event.start_mark else 1


class _Loader(getattr(yaml, 'CSafeLoader', yaml.SafeLoader)):  # type: ignore[misc]
    """Reads plain values; refuses what is stated twice and numbers of very many digits."""

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """Return a mapping whose keys all differ."""
        found = set()
        for key, _ in getattr(node, 'value', ()):
            if isinstance(key, yaml.ScalarNode) and key.tag != 'tag:yaml.org,2002:merge':
                if key.value in found:
                    raise yaml.constructor.ConstructorError(
                        None, None, f'{shortened(key.value)} is stated twice', key.start_mark
                    )
                found.add(key.value)
        return super().construct_mapping(node, deep)

    def number(self, node: Any) -> int | float:
        """Return a number."""
        if len(node.value) > _LONGEST_NUMBER:
            raise yaml.constructor.ConstructorError(
                None, None, f'a number has {len(node.value)} characters', node.start_mark
            )
        is_int = node.tag.endswith(':int')
        value: int | float = (
            self.construct_yaml_int(node) if is_int else self.construct_yaml_float(node)
        )
        return value


for _kind in ('int', 'float'):
    _Loader.add_constructor(f'tag:yaml.org,2002:{_kind}', _Loader.number)


def read_json(path: Path, remedy: str, largest: int = _LARGEST_JSON) -> Any:
    """Return the content of a JSON file of at most ``largest`` bytes.

    Raises a FileError as `read_text`, and if the file is not JSON, is nested too deeply or has
    too many values.
    """
    text = read_text(path, remedy, largest)
    if sum(map(text.count, ',[{')) > _MOST_JSON_VALUES:
        raise FileError(
            f'{path} holds more than {_MOST_JSON_VALUES / 1e6:g} million values, the limit;'
            f' {remedy}'
        )
    try:
        return json.loads(text, parse_int=_integer, object_pairs_hook=_object)
    except (ValueError, RecursionError) as error:
        raise FileError(f'{path} is not valid JSON: {shortened(error)}; {remedy}') from error


def numbers(name: str, value: object, kind: type[BinocularReconError]) -> npt.NDArray[np.float64]:
    """Return a list of numbers, or of lists of numbers of one length, from YAML or JSON.

    Parameters
    ----------
    name : str
        What it is, for the error.
    value : object
        What the file holds. Text such as ``1e-05``, which PyYAML does not take for a number,
        counts as one.
    kind : type
        Error to raise.

    Returns
    -------
    (n,) or (n, m) float64
        Finite numbers.

    Raises
    ------
    BinocularReconError
        Of the given kind, if it is anything else.

    """
    nested = isinstance(value, list) and bool(value) and isinstance(value[0], list)
    rows: list[Any] = value if nested and isinstance(value, list) else [value]
    for row in rows:
        if not isinstance(row, list):
            raise kind(f'{name} must be a list of numbers, got {shortened(row)}')
        for one in row:
            if _number(one) is None:
                raise kind(f'{name} must hold finite numbers, got {shortened(one)}')
    if len({len(row) for row in rows}) > 1:
        raise kind(f'the rows of {name} must be equally long; the file is damaged')
    found = np.array([[_number(one) for one in row] for row in rows], np.float64)
    return found if nested else found[0]


def number(name: str, value: object, kind: type[BinocularReconError]) -> float:
    """Return a number from YAML or JSON; raises an error of the given kind if it is none."""
    found = _number(value)
    if found is None:
        raise kind(f'{name} must be a finite number, got {shortened(value)}')
    return found


def whole_number(name: str, value: object, kind: type[BinocularReconError]) -> int:
    """Return a whole number from YAML or JSON; raises an error of the given kind if it is none."""
    found = number(name, value, kind)
    if not found.is_integer():
        raise kind(f'{name} must be a whole number, got {shortened(value)}')
    return int(found)


def _number(value: object) -> float | None:
    """Return a finite number, None if it is anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    try:
        found = float(value)
    except (ValueError, OverflowError):
        return None
    return found if np.isfinite(found) else None


def _integer(text: str) -> int:
    """Return a whole number of JSON."""
    if len(text) > _LONGEST_NUMBER:
        raise ValueError(f'a number has {len(text)} digits')
    return int(text)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object of JSON whose names all differ."""
    found = dict(pairs)
    if len(found) < len(pairs):
        names = Counter(name for name, _ in pairs)
        twice = names.most_common(1)[0][0]
        raise ValueError(f'{shortened(twice)} is stated twice')
    return found
