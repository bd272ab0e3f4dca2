# SPDX-License-Identifier: Apache-2.0
"""Folders of scenes for tests, and methods whose answer is known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import yaml

from binocular_recon.evaluation.accuracy.methods import (
    Method,
    MethodResult,
)
from binocular_recon.evaluation.speed.synthetic import SyntheticPair
from binocular_recon.io.pfm import write_pfm

WIDTH, HEIGHT, RANGE = 200, 120, 32
FACTS = {'source': 'made by a test', 'max_disparity_px': RANGE}
METRIC = {**FACTS, 'focal_px': 100.0, 'baseline_m': 0.5, 'principal_point_offset_px': 2.0}


def write_scene(folder: Path, pair: SyntheticPair, facts: dict[str, object]) -> None:
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / 'left.png'), pair.left)
    cv2.imwrite(str(folder / 'right.png'), pair.right)
    cv2.imwrite(str(folder / 'visible.png'), pair.visible.astype(np.uint8) * 255)
    write_pfm(folder / 'disparity.pfm', pair.disparity_px)
    (folder / 'scene.yaml').write_text(yaml.safe_dump(facts), encoding='utf-8')


def answering(name: str, answer: Callable[[], MethodResult], *, ours: bool = False) -> Method:
    return Method(name, lambda *_: answer, ours)
