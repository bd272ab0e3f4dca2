# SPDX-License-Identifier: Apache-2.0
"""Which image files of two cameras belong together."""

from __future__ import annotations

import itertools
import re
import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from binocular_recon.errors import FileError
from binocular_recon.number_text import counted
from binocular_recon.pairing import Synchronizer

# What may tell which images belong together.
PAIR_BY = ('number', 'order', 'time')
# Share of the smaller number of images that must have a partner before numbers are believed.
_LEAST_COMMON = 0.5
# Images of one pair are at most this far apart where there is only one, s.
_SINGLE_S = 1.0
_SHOWN = 3
_SIDES = ('left', 'right')


class FilePair(NamedTuple):
    """Two image files that belong together; the time of the left one, ns, None if not known."""

    left: Path
    right: Path
    stamp_ns: int | None


@dataclass(frozen=True)
class FilePairs:
    """The pairs of two lists of image files.

    Attributes
    ----------
    pairs : list of FilePair
    by : str
        What told them: one of `PAIR_BY`.
    unpaired : list of Path
        Images without a partner.
    remarks : list of str
        What is to be said about the pairs; warnings begin with ``warning:``.

    """

    pairs: list[FilePair]
    by: str
    unpaired: list[Path]
    remarks: list[str] = field(default_factory=list)


def pair_files(
    left: list[Path],
    right: list[Path],
    by: str | None = None,
    *,
    tolerance_ns: int = 0,
    offset_ns: int = 0,
) -> FilePairs:
    """Return which images of two cameras belong together.

    Parameters
    ----------
    left, right : list of Path
        Images of each camera, in their order.
    by : str, optional
        One of `PAIR_BY`. By default the numbers in the names, if at least half of the images have
        a partner by them; else EXIF times, if all images have different ones; else the order, if
        there are as many left as right images.
    tolerance_ns : int
        With times: largest difference within a pair; 0: half the shortest time between two images
        of a camera.
    offset_ns : int
        Added to the times of the right camera.

    Raises
    ------
    FileError
        If they cannot be paired.

    """
    both = sorted(set(left) & set(right))
    if both:
        raise FileError(
            f'{both[0]} is named for both cameras; name the images of the left one, then those of'
            ' the right one'
        )
    # `reconstruct --help` imports this module and needs no numpy, as the reader of files does.
    from binocular_recon.io.pairs.capture_times import capture_time_ns

    times = [[capture_time_ns(path) for path in files] for files in (left, right)]
    numbers = common_numbers([path.stem for path in left], [path.stem for path in right])
    by = by or _choose(left, right, numbers, times)
    remarks: list[str] = []
    if by == 'number':
        partners = _by_number(left, right, numbers)
        remarks += _gaps(left, partners, numbers)
    elif by == 'time':
        partners = _by_time(left, right, times, tolerance_ns, offset_ns)
    else:
        partners = _by_order(left, right)
    pairs = [FilePair(left[i], right[k], times[0][i]) for i, k in partners]
    used = {path for pair in pairs for path in pair[:2]}
    unpaired = [path for path in (*left, *right) if path not in used]
    remarks.insert(0, f'{counted(len(pairs), "pair")} by {_SAID[by]}: {_ends(pairs)}')
    if unpaired:
        lonely = counted(len(unpaired), 'image has', 'images have')
        remarks.append(f'warning: {lonely} no partner: {_listed(unpaired)}')
    if by != 'time':
        remarks += _time_check(pairs, partners, times)
    return FilePairs(pairs, by, unpaired, remarks)


_SAID = {
    'number': 'the number in their names',
    'order': 'the order of their names',
    'time': 'their EXIF times',
}


def common_numbers(left: list[str], right: list[str]) -> tuple[list[int], list[int]] | None:
    """Return the number in each name that tells images of a camera apart and is common to both.

    Of several numbers, as in ``cam1_0007_b``, the one with most values in common, the last first.
    None if names have no numbers, or none tells all images of each camera apart.
    """
    groups = [[re.findall(r'\d+', name) for name in names] for names in (left, right)]
    fewest = min(len(found) for names in groups for found in names)
    best: tuple[list[int], list[int]] | None = None
    most = -1
    for place in range(1, fewest + 1):
        one, other = ([int(found[-place]) for found in names] for names in groups)
        if len(set(one)) < len(one) or len(set(other)) < len(other):
            continue
        common = len(set(one) & set(other))
        if common > most:
            best, most = (one, other), common
    return best


def _choose(
    left: list[Path],
    right: list[Path],
    numbers: tuple[list[int], list[int]] | None,
    times: list[list[int | None]],
) -> str:
    fewer = min(len(left), len(right))
    if len(left) == len(right) == 1:
        return 'order'
    if numbers and len(set(numbers[0]) & set(numbers[1])) >= max(1.0, _LEAST_COMMON * fewer):
        return 'number'
    if all(None not in side and len(set(side)) == len(side) for side in times):
        return 'time'
    if len(left) == len(right):
        return 'order'
    raise FileError(
        f'left images: {len(left)}, right images: {len(right)}, and nothing tells which belong'
        ' together: most names have no number in common, and not all have an EXIF time of their'
        ' own; rename them, remove those without a partner, or give --pair-by'
    )


def _by_number(
    left: list[Path], right: list[Path], numbers: tuple[list[int], list[int]] | None
) -> list[tuple[int, int]]:
    common = sorted(set(numbers[0]) & set(numbers[1])) if numbers else []
    if not numbers or not common:
        raise FileError(
            f'the names of left and right images have no number in common ({left[0].name},'
            f' {right[0].name}); rename them, or give --pair-by order or time'
        )
    places = [{value: i for i, value in enumerate(side)} for side in numbers]
    return [(places[0][value], places[1][value]) for value in common]


def _by_order(left: list[Path], right: list[Path]) -> list[tuple[int, int]]:
    if len(left) != len(right):
        raise FileError(
            f'left images: {len(left)}, right images: {len(right)}, so their order does not'
            ' tell which belong together; remove those without a partner, or give --pair-by number'
            ' or time'
        )
    return [(i, i) for i in range(len(left))]


def _by_time(
    left: list[Path],
    right: list[Path],
    times: list[list[int | None]],
    tolerance_ns: int,
    offset_ns: int,
) -> list[tuple[int, int]]:
    for files, side in zip((left, right), times, strict=True):
        without = [path for path, time in zip(files, side, strict=True) if time is None]
        if without:
            raise FileError(
                f'images without an EXIF time: {_listed(without)}; give --pair-by number or order'
            )
    known = [[time for time in side if time is not None] for side in times]
    for files, stamps in zip((left, right), known, strict=True):
        counts = Counter(stamps)
        twice = [path for path, time in zip(files, stamps, strict=True) if counts[time] > 1]
        if twice:
            raise FileError(
                f'{_listed(twice)} have the same EXIF time; give --pair-by number or order'
            )
    if not tolerance_ns:
        steps = [b - a for side in known for a, b in itertools.pairwise(sorted(side))]
        tolerance_ns = min(steps) // 2 if steps else round(_SINGLE_S * 1e9)
    synchronizer = Synchronizer(
        _SIDES,
        queue_size=len(left) + len(right),
        tolerance_ns=tolerance_ns,
        offsets_ns={_SIDES[1]: offset_ns},
    )
    entries = [
        (time, name, i)
        for name, side in zip(_SIDES, known, strict=True)
        for i, time in enumerate(side)
    ]
    found = []
    for time, name, i in sorted(entries):
        found += synchronizer.add(name, time, (i,))
    found += synchronizer.finish()
    if not found:
        mismatch = synchronizer.explain()
        raise FileError(
            'no EXIF times of left and right images agree to'
            f' {tolerance_ns / 1e9:.3f} s{f": {mismatch.text}" if mismatch else ""}; give'
            ' --stamp-offset if a clock differs, or --pair-by number or order'
        )
    return [(i, k) for (i,), (k,) in found]


def _gaps(
    left: list[Path],
    partners: list[tuple[int, int]],
    numbers: tuple[list[int], list[int]] | None,
) -> list[str]:
    """Say where numbers are missing on both sides."""
    assert numbers is not None
    values = [numbers[0][i] for i, _ in partners]
    steps = [b - a for a, b in itertools.pairwise(values)]
    if not steps:
        return []
    usual = Counter(steps).most_common(1)[0][0]
    gaps = [k for k, step in enumerate(steps) if step > usual]
    # names that are times have no usual step
    if not gaps or len(gaps) > len(steps) / 4:
        return []
    k = gaps[0]
    ends = f'{left[partners[k][0]].name} is followed by {left[partners[k + 1][0]].name}'
    return [f'{counted(len(gaps), "gap")} in the numbers, the first where {ends}']


def _time_check(
    pairs: list[FilePair], partners: list[tuple[int, int]], times: list[list[int | None]]
) -> list[str]:
    """Warn if EXIF times contradict the pairs."""
    known = [
        (pair, (right - left) / 1e9)
        for pair, (i, k) in zip(pairs, partners, strict=True)
        if (left := times[0][i]) is not None and (right := times[1][k]) is not None
    ]
    stamps = sorted(pair.stamp_ns for pair, _ in known if pair.stamp_ns is not None)
    steps = [(b - a) / 1e9 for a, b in itertools.pairwise(stamps) if b > a]
    if len(known) < 3 or not steps:
        return []
    usual = statistics.median(difference for _, difference in known)
    # whole seconds are rounded by up to one
    limit = max(statistics.median(steps) / 2, 1.0)
    odd = [(pair, diff) for pair, diff in known if abs(diff - usual) > limit]
    if not odd:
        return []
    pair, difference = odd[0]
    text = (
        f'warning: by their EXIF times {counted(len(odd), "pair does", "pairs do")} not belong'
        f' together, the first being {pair.left.name} and {pair.right.name}: {difference:.1f} s'
        f' apart, most are {usual:.1f} s; try --pair-by time'
    )
    return [text]


def _ends(pairs: Sequence[FilePair]) -> str:
    first, last = pairs[0], pairs[-1]
    text = f'{first.left.name} with {first.right.name}'
    return text if len(pairs) == 1 else f'{text} to {last.left.name} with {last.right.name}'


def _listed(files: list[Path]) -> str:
    names = ', '.join(f'{path.parent.name}/{path.name}' for path in files[:_SHOWN])
    return names + (', ...' if len(files) > _SHOWN else '')
