# SPDX-License-Identifier: Apache-2.0
"""Points of a cloud in a page, to be turned and clicked; a still image for paper.

The points are in the page as base64: for each of x, y, z and sigma n numbers of 16 bit (little
endian), for red, green, blue and measured n bytes. ``assets/cloud_view.js`` draws them with WebGL
and needs nothing else.
"""

from __future__ import annotations

import json
from base64 import b64encode
from dataclasses import dataclass
from html import escape

import numpy as np
import numpy.typing as npt

from binocular_recon.camera import FloatArray
from binocular_recon.drawing.page import asset, embedded_image

# What a point takes in a page: 12 bytes as base64.
BYTES_PER_POINT = 16
_LEVELS = (1 << 16) - 1
_SIGMA_STEP_M = 1e-4


@dataclass(frozen=True, eq=False)
class ViewedCloud:
    """Points and from where they are seen.

    Attributes
    ----------
    xyz : (N, 3) float64
        m; the coordinates that the page states. N > 0.
    rgb : (N, 3) uint8
    sigma_m : (N,) float
        One standard deviation, m.
    measured : (N,) bool
        Whether a point was measured, not filled.
    names : (str, str, str)
        Names of the axes.
    sigma_name : str
        What ``sigma_m`` is of, such as ``sigma_z``.
    display : (3, 3) float64
        Rotation to axes of which the third is up.
    eye : (3,) float64
        Where the camera was, in the coordinates of ``xyz``.
    gap_rad : float
        Angle between neighbouring points, seen from there.

    """

    xyz: FloatArray
    rgb: npt.NDArray[np.uint8]
    sigma_m: FloatArray
    measured: npt.NDArray[np.bool_]
    names: tuple[str, str, str]
    sigma_name: str
    display: FloatArray
    eye: FloatArray
    gap_rad: float

    @property
    def step_m(self) -> FloatArray:
        """Step to which the coordinates are rounded, (3,) m."""
        step: FloatArray = np.maximum(np.ptp(self.xyz, axis=0) / _LEVELS, 1e-9)
        return step


def cloud_view(cloud: ViewedCloud, still_jpeg: bytes, caption: str) -> str:
    """Return the HTML of a view; the page needs `cloud_script` once.

    Parameters
    ----------
    cloud : ViewedCloud
    still_jpeg : bytes
        Image for paper, and for browsers without WebGL.
    caption : str
        HTML.

    """
    low, step = cloud.xyz.min(axis=0), cloud.step_m
    origin = np.median(cloud.xyz, axis=0)
    meta = {
        'count': len(cloud.xyz),
        'low': low.tolist(),
        'step': step.tolist(),
        'origin': origin.tolist(),
        'height_origin': float(cloud.display[2] @ origin),
        'sigma_step': _SIGMA_STEP_M,
        'sigma_name': cloud.sigma_name,
        'names': list(cloud.names),
        'display': cloud.display.tolist(),
        'eye': (cloud.display @ (cloud.eye - origin)).tolist(),
        'gap': cloud.gap_rad,
    }
    sigma = np.clip(np.nan_to_num(cloud.sigma_m, nan=np.inf) / _SIGMA_STEP_M, 0, _LEVELS)
    words = np.vstack([np.rint((cloud.xyz - low) / step).T, np.rint(sigma)]).astype('<u2')
    octets = np.vstack([cloud.rgb.T, cloud.measured]).astype(np.uint8)
    data = b64encode(words.tobytes() + octets.tobytes()).decode()
    modes = {
        'colour': 'colour', 'height': 'height', 'distance': 'distance from the camera',
        'sigma': cloud.sigma_name, 'measured': 'measured or filled',
    }  # fmt: skip
    options = ''.join(
        f'<option value="{key}">{escape(text)}</option>' for key, text in modes.items()
    )
    buttons = {
        'start': 'start', 'camera': 'camera', 'top': 'from above', 'side': 'from the side',
        'smaller': 'smaller points', 'larger': 'larger points',
    }  # fmt: skip
    controls = ''.join(f'<button value="{key}">{text}</button>' for key, text in buttons.items())
    # in JSON < stands in strings only
    facts = json.dumps(meta).replace('<', '\\u003c')
    return (
        '<figure class="cloud"><canvas tabindex="0" aria-label="points of the cloud"></canvas>'
        f'{embedded_image(still_jpeg, "jpeg", "the cloud from an oblique view")}'
        f'<div class="controls"><label>colour by <select>{options}</select></label>'
        f'<span class="bar"></span>{controls}</div><output></output>'
        f'<figcaption>{caption}</figcaption>'
        f'<script type="application/json">{facts}</script>'
        f'<script type="text/plain">{data}</script></figure>'
    )


def cloud_script() -> str:
    """Return the script that shows every `cloud_view` of a page."""
    return asset('cloud_view.js')
