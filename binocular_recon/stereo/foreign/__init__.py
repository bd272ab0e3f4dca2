# SPDX-License-Identifier: Apache-2.0
"""Disparities that others computed: networks, other programs.

`checks` gives them a confidence: the image of the other camera must agree. `onnx_matcher` is the
matcher 'onnx'; `onnx_model` loads its network and gives it what `conventions`, options of
`config`, say. Exports the check.
"""

from typing import TYPE_CHECKING

from binocular_recon._lazy import lazy_exports

if TYPE_CHECKING:
    from binocular_recon.stereo.foreign.checks import check_disparity

__all__ = ['check_disparity']

__getattr__ = lazy_exports(__name__, __file__)
