# SPDX-License-Identifier: Apache-2.0
"""Messages agree with their numbers: 1 frame, 2 frames."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from binocular_recon.number_text import counted

PACKAGE = Path(__file__).parents[1] / 'binocular_recon'
# What messages count. Behind "of" the plural stands with every number: 1 of 1 frames.
THINGS = (
    'boards', 'cameras', 'chunks', 'features', 'files', 'frames', 'gaps', 'images', 'inputs',
    'marks', 'matches', 'pairs', 'picks', 'points', 'processes', 'rods', 'scenes', 'sites',
    'stations', 'threads', 'values', 'warnings', 'workers',
)  # fmt: skip
BEHIND = re.compile(rf' (?:[a-z]+ )?({"|".join(THINGS)})\b')
# Words that are no number; numbers that are never 1 are constants, in capitals, or these.
WORDS = {
    "{kind} images", "{by} need pairs", "{side} marks", "{side} images", "{self.name} in rods",
    "{place} in rods", "{name} holds values", "{args.confidence} holds values",
    "{counted(boards, 'board')} of rods", "{shape} for images",
}  # fmt: skip
NEVER_ONE = {
    '{len(stack.used)} frames': 'at least 2 are averaged',
    '{len(frames)} frames': 'more than fit the table',
    '{math.prod(shape)} values': '9 or 12',
    '{count} values': '9 or 12',
    "{' or '.join(map(str, counts))} values": 'sizes of matrices',
    '{columns} values': 'sizes of matrices',
    '{len(parts) - 2} values': 'about a damaged file',
    '{values.size} values': 'about a damaged file',
    '{len(args.inputs)} inputs': 'more than 2',
    '{len(inputs)} inputs': 'more than 2',
    '{len(compared)} values': 'those of the tour',
    '{len(runs[0].errors_mm[BICYCLE])} picks': '10',
    '{len(raw.listed)} cameras': 'more than 2',
    '{rates[0]} frames': 'a rate',
    '{_MOST_JSON_VALUES / 1000000.0} million': 'a limit',
    '{height} points': 'an image',
    '{len(used)} control': 'at least 3',
    '{count} warnings': 'else it is said otherwise',
}


def plurals() -> Iterator[str]:
    """Yield numbers in messages that stand before a plural, whatever they are."""
    for path in sorted(PACKAGE.rglob('*.py')):
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.JoinedStr):
                continue
            before = ''
            for value, behind in zip(node.values, [*node.values[1:], None], strict=True):
                if not isinstance(value, ast.FormattedValue):
                    before = str(ast.literal_eval(value))
                    continue
                number = ast.unparse(value.value)
                text = str(behind.value) if isinstance(behind, ast.Constant) else ''
                found = BEHIND.match(text)
                constant = number.lstrip('_').isupper()
                if found and not constant and not before.endswith(('of ', 'of the ', 'all ')):
                    yield f'{{{number}}}{text[:50]}'
                before = ''


def test_things_are_counted_as_people_say_it() -> None:
    assert [counted(n, 'frame') for n in (0, 1, 2)] == ['0 frames', '1 frame', '2 frames']
    assert counted(1, 'image has', 'images have') == '1 image has'
    assert counted(3, 'image has', 'images have') == '3 images have'
    found = {one for one in plurals() if not one.startswith((*WORDS, *NEVER_ONE))}
    assert not found, 'count them by counted() of number_text.py'
