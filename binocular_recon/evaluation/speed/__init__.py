# SPDX-License-Identifier: Apache-2.0
"""Speed and memory of every stage, beside its peer in the same run.

`benchmark` times the contestants of `stages` on `content`: real pairs and a `synthetic` one;
`direct_solver` is the exact solution that the filter is held against; `probe` measures what needs
a process of its own.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.evaluation.speed.synthetic import SyntheticPair, synthetic_pair

__all__ = [
    'SyntheticPair',
    'synthetic_pair',
]

__getattr__ = lazy_exports(__name__, __file__)
