# SPDX-License-Identifier: Apache-2.0
"""Results as Markdown tables for people and as plain values for JSON."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return an aligned Markdown table: text to the left in the first column, figures right."""
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]

    def line(cells: Sequence[str]) -> str:
        first, *rest = (
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(cells, widths, strict=True))
        )
        return '| ' + ' | '.join([first, *rest]) + ' |'

    rule = '|' + '|'.join(
        '-' * (width + 2) if i == 0 else '-' * (width + 1) + ':' for i, width in enumerate(widths)
    )
    return '\n'.join([line(header), rule + '|', *map(line, rows)])


def to_plain(value: Any) -> Any:
    """Return dataclasses, tuples and NaN as what JSON has: objects, arrays and null."""
    if dataclasses.is_dataclass(value):
        return {f.name: to_plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
