# SPDX-License-Identifier: Apache-2.0
"""Messages agree with their numbers: 1 frame, 2 frames."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from binocular_recon.number_text import counted

PACKAGE = Path(__file__).parents[1] / 'binocular_recon'
# What messages count. Behind "of" the plural stands with every number: 1 of 1 frames.
THINGS = (
    'boards cameras chunks features files frames gaps images inputs marks matches pairs picks points'
    ' processes rods scenes sites stations threads values warnings workers'
).split()
BEHIND = re.compile(rf' (?:[a-z]+ )?({"|".join(THINGS)})\b')
# Numbers that are never 1, by what the message says of them.
NEVER_ONE = {
    'warnings': 'one is said by "the warning"',
}


def plurals() -> Iterator[str]:
    """Yield numbers in messages that stand before a plural, whatever they are."""
    for path in sorted(PACKAGE.rglob('*.py')):
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.JoinedStr):
                continue
            before = ''
            for value, behind in zip(node.values, [*node.values[1:], None], strict=True):
                if isinstance(value, ast.Constant):
                    before = str(value.value)
                    continue
                number = ast.unparse(value.value)
                text = str(behind.value) if isinstance(behind, ast.Constant) else ''
                found = BEHIND.match(text)
                if found and not before.endswith(('of ', 'of the ', 'all ')):
                    yield f'{path.relative_to(PACKAGE)}: {{{number}}}{text[:50]}'
                before = ''


def test_things_are_counted_as_people_say_it() -> None:
    assert [counted(n, 'frame') for n in (0, 1, 2)] == ['0 frames', '1 frame', '2 frames']
    assert counted(1, 'image has', 'images have') == '1 image has'
    assert counted(3, 'image has', 'images have') == '3 images have'
    for one in plurals(): print(one)
