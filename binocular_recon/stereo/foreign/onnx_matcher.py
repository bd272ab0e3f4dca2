# SPDX-License-Identifier: Apache-2.0
"""The matcher 'onnx': a network's disparities, checked against the images."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from binocular_recon.config import MatchConfig
from binocular_recon.images import FloatImage
from binocular_recon.stereo.foreign.checks import check_disparity
from binocular_recon.stereo.foreign.onnx_model import load_network
from binocular_recon.stereo.matching.matcher import Match


def match_onnx(left: FloatImage, right: FloatImage, config: MatchConfig) -> Match:
    """Match a pair by the network ``config.onnx_model``.

    Parameters
    ----------
    left, right : (H, W, 3) float32
        Rectified images, BGR or grey in three channels, levels 0..255; NaN = no data.
    config : MatchConfig
        Network with its conventions, search range and checks.

    Returns
    -------
    Match
        Disparities of the network that pass `check_disparity`. For the left-right check the
        network runs again, on the pair exchanged and flipped; ``disp12_max_diff`` below 0 saves
        that.

    Raises
    ------
    BinocularReconError
        If the network cannot be loaded, or does not fit the pair.

    """
    network = load_network(Path(config.onnx_model).expanduser())
    known = np.nan_to_num(left), np.nan_to_num(right)
    disparity_px = network.disparity(*known, config)
    right_disparity_px = None
    if config.disp12_max_diff >= 0:
        flipped = [np.ascontiguousarray(image[:, ::-1]) for image in known[::-1]]
        right_disparity_px = network.disparity(flipped[0], flipped[1], config)[:, ::-1]
    greys = [np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)) for image in (left, right)]
    return check_disparity(disparity_px, greys[0], greys[1], config, right_disparity_px)
