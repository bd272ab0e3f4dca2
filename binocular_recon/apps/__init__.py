# SPDX-License-Identifier: Apache-2.0
"""What a command or a node does, without its front end.

`reconstruct_bag` runs the chain on a whole bag into an `output_folder`; `progress` shows a
person how far it is. Commands and nodes parse arguments or parameters and call these.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.apps.output_folder import ResultFolder
    from binocular_recon.apps.reconstruct_bag import BagInput, reconstruct_bag

__all__ = [
    'BagInput',
    'ResultFolder',
    'reconstruct_bag',
]

__getattr__ = lazy_exports(__name__, __file__)
