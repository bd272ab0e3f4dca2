# SPDX-License-Identifier: Apache-2.0
"""Scenes with ground truth: folders of left.png, right.png, disparity.pfm and scene.yaml.

``visible.png`` (255 = seen by both cameras) or ``disparity_right.pfm`` (ground truth of the right
image's pixels) may say what is occluded.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from binocular_recon.errors import FileError, ImageError
from binocular_recon.evaluation.accuracy.metrics import truth_step_px
from binocular_recon.evaluation.accuracy.visibility import visible_from_both, visible_from_truth
from binocular_recon.images import FloatImage, Image, Mask
from binocular_recon.io.image_files import read_image_file
from binocular_recon.io.pfm import read_pfm
from binocular_recon.io.text_files import number, read_yaml, whole_number

# A sparser ground truth does not show what hides what.
_DENSE_PERCENT = 40.0


@dataclass(frozen=True, eq=False)
class TruthScene:
    """A rectified pair with ground truth.

    Attributes
    ----------
    name : str
        Name of the folder.
    source : str
        Where the data come from, with licence.
    left, right : (H, W) or (H, W, 3), uint8 or uint16
        Rectified images; colour as BGR.
    truth_px : (H, W) float32
        Disparity x_left - x_right; NaN = unknown.
    visible : (H, W) bool or None
        Pixels that both cameras see; None if unknown.
    visible_source : str
        ``visible.png``, ``both ground truths`` (``disparity_right.pfm`` agrees), ``ground truth``
        (derived, see `visible_from_truth`) or empty.
    max_disparity_px : int
        Number of disparities to search, from 0.
    focal_px, baseline_m : float or None
        Calibration, if known.
    offset_px : float
        ``cx_left - cx_right``, px.

    """

    name: str
    source: str
    left: Image
    right: Image
    truth_px: FloatImage
    visible: Mask | None
    visible_source: str
    max_disparity_px: int
    focal_px: float | None = None
    baseline_m: float | None = None
    offset_px: float = 0.0

    @cached_property
    def truth_step_px(self) -> float:
        """Step to which the ground truth is rounded, px; 0 if it is not."""
        return truth_step_px(self.truth_px)

    @property
    def focal_baseline(self) -> float | None:
        """Focal length times baseline, px m, if known."""
        if self.focal_px is None or self.baseline_m is None:
            return None
        return self.focal_px * self.baseline_m


def find_scenes(folder: Path, names: list[str] | None = None) -> list[Path]:
    """Return the scene folders in ``folder`` (or ``folder`` itself, if it is one), by name.

    Parameters
    ----------
    folder : Path
        Where to look.
    names : list of str, optional
        Only these.

    Raises
    ------
    FileError
        If there is no such folder, no scene in it, or a name is not among them.

    """
    if not folder.is_dir():
        raise FileError(f'{folder} is not a folder; give one that holds scene folders')
    candidates = [folder] if _is_scene(folder) else sorted(filter(_is_scene, folder.iterdir()))
    if not candidates:
        raise FileError(
            f'{folder} holds no scene folder; a scene has left.png, right.png, disparity.pfm and'
            ' scene.yaml'
        )
    if names is None:
        return candidates
    known = {path.name: path for path in candidates}
    missing = [name for name in names if name not in known]
    if missing:
        raise FileError(
            f'{folder} has no scene {", ".join(missing)}; it has {", ".join(sorted(known))}'
        )
    return [known[name] for name in names]


def read_scene(folder: Path) -> TruthScene:
    """Read a scene folder.

    Raises
    ------
    FileError
        If a file is missing or damaged or scene.yaml lacks a key.
    ImageError
        If the sizes differ.

    """
    facts = _read_facts(folder / 'scene.yaml')
    left = read_image_file(folder / 'left.png')
    right = read_image_file(folder / 'right.png')
    truth_px = read_pfm(folder / 'disparity.pfm')
    size = left.shape[:2]
    for name, image in (('right.png', right), ('disparity.pfm', truth_px)):
        _check_size(folder, name, image, size)
    visible, visible_source = _visibility(folder, truth_px)
    if visible is not None:
        _check_size(folder, 'visible.png', visible, size)
    return TruthScene(
        name=folder.resolve().name,
        source=str(facts.get('source', 'unknown')),
        left=left,
        right=right,
        truth_px=truth_px,
        visible=visible,
        visible_source=visible_source,
        max_disparity_px=int(facts['max_disparity_px']),
        focal_px=facts.get('focal_px'),
        baseline_m=facts.get('baseline_m'),
        offset_px=-facts.get('principal_point_offset_px', 0.0),
    )


def _is_scene(folder: Path) -> bool:
    """Tell a scene's folder by any two of its files, so that an incomplete one is not missed."""
    files = ('left.png', 'right.png', 'disparity.pfm', 'scene.yaml')
    return folder.is_dir() and sum((folder / name).is_file() for name in files) >= 2


def _read_facts(path: Path) -> dict[str, Any]:
    facts = read_yaml(path, 'a scene needs it')
    if not isinstance(facts, dict) or 'max_disparity_px' not in facts:
        raise FileError(f'{path} lacks max_disparity_px, the number of disparities to search')
    positive = ('max_disparity_px', 'focal_px', 'baseline_m')
    for key in (*positive, 'principal_point_offset_px'):
        if key not in facts:
            continue
        read = whole_number if key == 'max_disparity_px' else number
        facts[key] = read(f'{path}: {key}', facts[key], FileError)
        if key in positive and not facts[key] > 0:
            raise FileError(f'{path}: {key} must be positive, got {facts[key]:g}')
    return facts


def _visibility(folder: Path, truth_px: FloatImage) -> tuple[Mask | None, str]:
    path = folder / 'visible.png'
    if path.is_file():
        image = read_image_file(path)
        return (image if image.ndim == 2 else image[..., 0]) == 255, 'visible.png'
    path = folder / 'disparity_right.pfm'
    if path.is_file():
        right_px = read_pfm(path)
        _check_size(folder, path.name, right_px, truth_px.shape)
        return visible_from_both(truth_px, right_px), 'both ground truths'
    if 100.0 * np.isfinite(truth_px).mean() >= _DENSE_PERCENT:
        return visible_from_truth(truth_px), 'ground truth'
    return None, ''


def _check_size(folder: Path, name: str, image: Image, size: tuple[int, ...]) -> None:
    if image.shape[:2] != size:
        raise ImageError(
            f'{folder / name} is {image.shape[1]}x{image.shape[0]} px, left.png is'
            f' {size[1]}x{size[0]} px; they must have the same size'
        )
