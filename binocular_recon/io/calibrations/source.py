# SPDX-License-Identifier: Apache-2.0
"""Files of calibrations, read with bounds: whatever a file holds, reading it ends soon."""

from __future__ import annotations

import ast
import gzip
import io
import json
import re
import zlib
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import yaml

from binocular_recon.errors import CalibrationError, FileError
from binocular_recon.io.calibrations.formats.ros_ini import ini_values, is_ini
from binocular_recon.io.text_files import (
    LARGEST_YAML,
    check_size,
    check_structure,
    decoded,
    open_file,
    read_bytes,
)

# mrcal and MATLAB may add the observations that a calibration was made from.
MOST_BYTES = 64_000_000
_REMEDY = 'give the file of a calibration alone'
# In any format; in YAML with all aliases written out.
MOST_NODES = 500_000
_GZIP = b'\x1f\x8b'
_BROKEN = (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError)


class _Loader(yaml.SafeLoader):  # the C loader ends the process on deeply nested files
    """Reads plain values, and OpenCV's matrices as mappings."""


def _mapping(loader: Any, _suffix: str, node: yaml.Node) -> Any:
    if isinstance(node, yaml.MappingNode):
        return loader.construct_mapping(node, deep=True)
    if isinstance(node, yaml.SequenceNode):
        return loader.construct_sequence(node, deep=True)
    return loader.construct_scalar(node)


_Loader.add_multi_constructor('tag:yaml.org,2002:opencv-', _mapping)
_Loader.add_multi_constructor('tag:yaml.org,2002:python/tuple', _mapping)


class SourceFile:
    """One file of a calibration.

    Attributes
    ----------
    path : Path

    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def name(self) -> str:
        """Name of the file without its folder."""
        return self.path.name

    @cached_property
    def data(self) -> bytes:
        """Content, decompressed; raises a FileError if it cannot be read or is too large."""
        data = read_bytes(self.path, _REMEDY, MOST_BYTES)
        if data.startswith(_GZIP):
            try:
                with gzip.open(io.BytesIO(data)) as file:
                    data = file.read(MOST_BYTES + 1)
            except (OSError, EOFError, zlib.error) as error:
                raise FileError(f'{self.path} cannot be read: {error}; {_REMEDY}') from error
            check_size(self.path, data, _REMEDY, MOST_BYTES)
        return data

    @cached_property
    def text(self) -> str:
        """Content as text; raises a FileError if it is not UTF-8."""
        return decoded(self.path, self.data, _REMEDY)

    @cached_property
    def head(self) -> bytes:
        """First kilobytes of the file as they are; empty if it cannot be read."""
        try:
            with open_file(self.path) as file:
                return file.read(4096)
        except OSError:
            return b''

    @cached_property
    def content(self) -> Any:
        """Values of a YAML, JSON, XML, mrcal or .ini file; an empty mapping for other files.

        XML becomes its root element, but OpenCV's a mapping as in YAML.

        Raises
        ------
        FileError
            If the file cannot be read.
        CalibrationError
            If it is damaged or too large.

        """
        names = self.path.name.lower().removesuffix('.gz')
        if is_ini(self.head):
            return ini_values(self.text)
        if names.endswith(('.txt', '.mat', '.bin')):
            return {}
        begin = self.text[:4096].lstrip()
        parse: Callable[[str], Any]
        if names.endswith('.cameramodel'):
            kind, parse = 'a Python dictionary as mrcal writes it', _literal
        elif begin.startswith('<'):
            kind, parse = 'XML', _xml
        elif names.endswith('.json') or (begin.startswith('{') and not names.endswith('ml')):
            kind, parse = 'JSON', json.loads
        else:
            check_size(self.path, self.data, _REMEDY, LARGEST_YAML)
            kind, parse = 'YAML', _yaml
        try:
            _check_parts(self.text)
            return parse(self.text)
        except (yaml.YAMLError, ET.ParseError, SyntaxError, MemoryError) as error:
            reason = ' '.join(str(error).split()) or 'its values are nested too deeply'
        except RecursionError:
            reason = 'its values are nested too deeply'
        except _BROKEN as error:
            reason = str(error)
        raise CalibrationError(
            f'{self.path} is not a camera file: {reason} (read as {kind}); write it again with the'
            ' program that made it'
        )


def _check_parts(text: str) -> None:
    """Raise a ValueError if a text has so many parts that parsing it would take all memory."""
    if sum(text.count(mark) for mark in '<,[{(') > MOST_NODES:
        raise ValueError(f'it has more than {MOST_NODES} values')


def _yaml(text: str) -> Any:
    if text.startswith('%YAML'):  # OpenCV writes %YAML:1.0, which is none
        text = text.partition('\n')[2]
    text = text.replace('\t', ' ')  # YAML allows tabs, PyYAML does not
    text = re.sub(r'\n---\s*\Z', '\n', text)  # `ros2 topic echo` ends every message so
    try:
        check_structure(text, aliases=True)
    except FileError as error:
        raise ValueError(str(error)) from error
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _check_nodes(node)
        return loader.construct_document(node)
    finally:
        loader.dispose()


def _check_nodes(root: yaml.Node) -> None:
    """Raise a ValueError if a document is endless or grows too large with its aliases."""
    waiting, count = [root], 0
    while waiting:
        node = waiting.pop()
        count += 1
        if count > MOST_NODES:
            raise ValueError(
                f'its aliases (& and *) stand for more than {MOST_NODES} values; write them out'
            )
        if isinstance(node, yaml.MappingNode):
            waiting.extend(part for pair in node.value for part in pair)
        elif isinstance(node, yaml.SequenceNode):
            waiting.extend(node.value)


def _literal(text: str) -> Any:
    return ast.literal_eval(text.strip())


def _xml(text: str) -> Any:
    if '<!DOCTYPE' in text or '<!ENTITY' in text:
        raise ValueError('it declares entities, which calibrations have no use for; remove them')
    root = ET.fromstring(text)  # noqa: S314 - there are no entities to expand
    if root.tag != 'opencv_storage':
        return root
    return {child.tag: _storage_value(child) for child in root}


def _storage_value(node: ET.Element) -> Any:
    """Return a node of OpenCV's FileStorage as YAML would state it."""
    if node.get('type_id', '').startswith('opencv-') or (len(node) and node[0].tag != '_'):
        return {child.tag: _storage_value(child) for child in node}
    if len(node):
        return [_storage_value(child) for child in node]
    words = (node.text or '').split()
    return words[0] if len(words) == 1 else words
