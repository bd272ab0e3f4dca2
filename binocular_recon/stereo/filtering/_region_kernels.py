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
from binocular_recon._simd import LANES, at_most, larger, largest, load, splat, to_int32
from binocular_recon.stereo.filtering._lattice_kernels import (
    ONE,
    PAD,
    ZERO,
    Lattice,
    Offsets,
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


@inline_kernel
def _has_strong(links: Any, k: int, back: Offsets, strong: Any) -> Any:
    """Return whether any link of `LANES` nodes, from node k on, is strong."""
    most = larger(load(links[0], k), load(links[0], k - 1))
    for a in range(1, 4):
        most = larger(most, larger(load(links[a], k), load(links[a], k - back[a - 1])))
    marks = at_most(most, splat(strong), splat(ZERO), splat(ONE))
    return largest(to_int32(marks)) > 0


@kernel
def label_regions(
    lattice: Lattice, least: float, labels: Labels, parents: Labels, members: tuple[Labels, Labels]
) -> tuple[int, int]:
    """Write the number of each node's region, from 1 on; 0 where no strong link is.

    Returns the last number and how many nodes have one; ``members`` get these nodes and their
    numbers. All arrays are (nodes,). ``labels`` must be 0 in the padding; ``parents`` is work
    space.
    """
    links, stride, strong = lattice.links, lattice.stride, np.float32(least)
    last: Any = 0
    east, one, two, three = links[0], links[1], links[2], links[3]
    for y in range(lattice.rows):
        back, first = offsets(lattice.earlier, y), node(stride, y, 0)
        west: Any = np.int32(0)
        for begin in range(first, first + lattice.width, LANES):
            if not _has_strong(links, begin, back, strong):
                labels[begin : begin + LANES] = west = np.int32(0)
                continue
            for k in range(begin, begin + LANES):
                a = _kept(west, east[k - 1], strong)
                b = _kept(labels[k - back[0]], one[k - back[0]], strong)
                c = _kept(labels[k - back[1]], two[k - back[1]], strong)
                d = _kept(labels[k - back[2]], three[k - back[2]], strong)
                label = max(a, b, c, d)
                differ = _differs(a, label) | _differs(b, label)
                if differ | _differs(c, label) | _differs(d, label):
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
    nodes, numbers = members
    found = 0
    for y in range(lattice.rows):
        first = node(stride, y, 0)
        for k in range(first, first + lattice.width):
            label = parents[labels[k]]
            labels[k] = numbers[found] = label
            nodes[found] = k
            found += label != 0
    return count, found


@kernel
def region_diagonal(
    lattice: Lattice, labels: Labels, nodes: Labels, diagonal: npt.NDArray[np.float64]
) -> None:
    """Write the sum, by region, of the excess and of the links that leave it.

    ``nodes``: those with a label.
    """
    links = lattice.links
    diagonal[:] = 0
    for k in nodes:
        y = k // lattice.stride - PAD
        ahead, back, here = lattice.later[y & 1], lattice.earlier[y & 1], labels[k]
        total = lattice.excess[k]
        for a in range(4):
            total += ZERO if labels[k + ahead[a]] == here else links[a, k]
            total += ZERO if labels[k - back[a]] == here else links[a, k - back[a]]
        diagonal[here] += total


@kernel
def correct_regions(
    nodes: Labels,
    numbers: Labels,
    inverse: npt.NDArray[np.float64],
    rhs: Vector,
    values: npt.NDArray[np.float64],
    out: Vector,
) -> None:
    """Write the sum of rhs over its region, times the inverse, to each of its nodes.

    ``nodes`` and ``numbers``: those with a label, and these; ``values`` is work space. In order,
    not by strips.
    """
    values[:] = 0
    for i in range(len(nodes)):
        values[numbers[i]] += rhs[nodes[i]]
    for i in range(len(values)):
        values[i] *= inverse[i]
    for i in range(len(nodes)):
        out[nodes[i]] = np.float32(values[numbers[i]])
