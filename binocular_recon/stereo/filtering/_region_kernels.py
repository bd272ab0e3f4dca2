# SPDX-License-Identifier: Apache-2.0
"""Kernels of regions: nodes that strong links hold together, cut off from what is around them.

In holes, and where disparities step, small regions lie beside each other in shapes that no regular
coarse grid sees. Each is corrected as a whole, by one number.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from binocular_recon._jit import inline_kernel, kernel
from binocular_recon.stereo.filtering._lattice_kernels import (
    ZERO,
    Lattice,
    Vector,
    node,
    offsets,
)

Labels = npt.NDArray[np.int32]


@inline_kernel
def _root(parents: Labels, label: Any) -> Any:
    while parents[label] != label:
        parents[label] = parents[parents[label]]
        label = parents[label]
    return label


@inline_kernel
def _join(parents: Labels, one: Any, other: Any) -> Any:
    """Join the trees of two labels, of which 0 is none; return a label of both."""
    if one == 0 or one == other:
        return other
    if other == 0:
        return one
    one, other = _root(parents, one), _root(parents, other)
    low = min(one, other)
    parents[max(one, other)] = low
    return low


@inline_kernel
def _kept(label: Any, link: Any, strong: Any) -> Any:
    """Return the label if the link to it is strong, else 0; without a branch."""
    return label * np.int32(link > strong)


@inline_kernel
def _differs(label: Any, other: Any) -> Any:
    return (label != 0) & (label != other)


@kernel
def label_regions(lattice: Lattice, least: float, labels: Labels, parents: Labels) -> int:
    """Write the number of each node's region, from 1 on, and return the last one.

    A node without strong links gets 0.
    ``labels`` (nodes,) must be 0 in the padding; ``parents`` (nodes,) is work space.
    """
    links, stride, strong = lattice.links, lattice.stride, np.float32(least)
    last: Any = 0
    east, one, two, three = links[0], links[1], links[2], links[3]
    for y in range(lattice.rows):
        back, first = offsets(lattice.earlier, y), node(stride, y, 0)
        west: Any = np.int32(0)
        for k in range(first, first + lattice.width):
            a = _kept(west, east[k - 1], strong)
            b = _kept(labels[k - back[0]], one[k - back[0]], strong)
            c = _kept(labels[k - back[1]], two[k - back[1]], strong)
            d = _kept(labels[k - back[2]], three[k - back[2]], strong)
            label = max(a, b, c, d)
            if _differs(a, label) | _differs(b, label) | _differs(c, label) | _differs(d, label):
                label = _join(parents, _join(parents, a, b), _join(parents, c, d))
            begins = max(east[k], one[k], two[k], three[k]) > strong
            fresh = np.int32(begins & (label == 0))
            last += fresh
            parents[last + 1 - fresh] = last + 1 - fresh
            label += fresh * last
            labels[k] = west = label
    parents[0] = count = 0
    for label in range(1, last + 1):  # a parent has a lower number than its children
        if parents[label] == label:
            count += 1
            parents[label] = count
        else:
            parents[label] = parents[parents[label]]
    for y in range(lattice.rows):
        first = node(stride, y, 0)
        for k in range(first, first + lattice.width):
            labels[k] = parents[labels[k]]
    return count


@inline_kernel
def _add_outwards(link: Vector, labels: Labels, others: Labels, out: Vector) -> None:
    for i in range(len(out)):
        out[i] += ZERO if labels[i] == others[i] else link[i]


@kernel
def region_diagonal(lattice: Lattice, labels: Labels, diagonal: Any) -> None:
    """Write the sum, by region, of the excess and of the links that leave it."""
    stride, n = lattice.stride, lattice.width
    total = np.empty(n, np.float32)
    diagonal[:] = 0
    for y in range(lattice.rows):
        ahead, back, first = lattice.later[y & 1], lattice.earlier[y & 1], node(stride, y, 0)
        here = labels[first : first + n]
        total[:] = lattice.excess[first : first + n]
        for a in range(4):
            k = first + ahead[a]
            _add_outwards(lattice.links[a, first : first + n], here, labels[k : k + n], total)
            k = first - back[a]
            _add_outwards(lattice.links[a, k : k + n], here, labels[k : k + n], total)
        for x in range(n):
            diagonal[here[x]] += total[x]


@kernel
def sum_regions(lattice: Lattice, labels: Labels, rhs: Vector, sums: Any) -> None:
    """Write the sum of rhs by region; 0 for what is in none. In order, not by strips."""
    sums[:] = 0
    for y in range(lattice.rows):
        first = node(lattice.stride, y, 0)
        for k in range(first, first + lattice.width):
            sums[labels[k]] += rhs[k]
    sums[0] = 0


@kernel
def spread_regions(
    lattice: Lattice, labels: Labels, values: Any, out: Vector, start: int, stop: int
) -> None:
    """Write the value of its region to each node of rows."""
    for y in range(start, stop):
        first = node(lattice.stride, y, 0)
        for k in range(first, first + lattice.width):
            out[k] = np.float32(values[labels[k]])
