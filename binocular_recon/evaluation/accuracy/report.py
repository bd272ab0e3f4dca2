# SPDX-License-Identifier: Apache-2.0
"""A self-contained page: the tables and a map of the errors of every method on every scene."""

from __future__ import annotations

import html
import re
from collections.abc import Collection, Sequence

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.drawing import page as page_parts
from binocular_recon.drawing.colormap import heat_map
from binocular_recon.evaluation.accuracy.scoring import SceneResult
from binocular_recon.images import ByteImage, FloatImage, to_bgr8
from binocular_recon.number_text import fixed

# Upper limits of the error classes, px, and the colour (RGB) of each: blue right, red wrong.
ERROR_LIMITS_PX = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, np.inf)
ERROR_COLOURS = (
    (49, 54, 149),
    (69, 117, 180),
    (171, 217, 233),
    (254, 224, 144),
    (253, 174, 97),
    (244, 109, 67),
    (165, 0, 38),
)
UNFILLED_COLOUR = (255, 0, 255)
UNKNOWN_COLOUR = (236, 236, 236)

_IMAGE_WIDTH = 420
# Below this share of known pixels ground truth is shown as blots of this radius.
_DENSE_SHARE = 0.6
_SPARSE_REACH_PX = 3.0


def error_map(disparity_px: FloatImage, truth_px: FloatImage) -> ByteImage:
    """Colour the absolute error of a disparity map.

    Parameters
    ----------
    disparity_px, truth_px : (H, W) float32
        Estimate and ground truth; NaN = unfilled, unknown.

    Returns
    -------
    (H, W, 3) uint8
        BGR: `ERROR_COLOURS` by size of the error, `UNFILLED_COLOUR`, `UNKNOWN_COLOUR`.

    """
    error = np.abs(disparity_px - truth_px)
    # a limit belongs to the class below it, as everywhere: only a larger error is bad
    classes = np.searchsorted(ERROR_LIMITS_PX, np.nan_to_num(error), side='left')
    colours = np.array(ERROR_COLOURS, np.uint8)[classes]
    colours[~np.isfinite(disparity_px)] = UNFILLED_COLOUR
    colours[~np.isfinite(truth_px)] = UNKNOWN_COLOUR
    return np.ascontiguousarray(colours[..., ::-1])


def scene_section(result: SceneResult) -> str:
    """Return the section of one scene: image, ground truth, and each method's two maps."""
    scene, scores = result.scene, result.scores
    known = scene.truth_px[np.isfinite(scene.truth_px)]
    limits = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    shown = _nearest_known(scene.truth_px)
    truth_px = scene.truth_px.ravel()[shown]
    figures = [
        _figure(to_bgr8(scene.left), 'left image', photo=True),
        _figure(heat_map(truth_px, limits), 'ground truth (black: unknown)'),
    ]
    for score, estimate in zip(scores.scores, result.estimates, strict=True):
        accuracy = score.everywhere
        caption = (
            f'<b>{html.escape(score.method)}</b> bad-2.0 {fixed(accuracy.bad_percent[1])} %,'
            f' mean error {fixed(accuracy.mean_error_px, 2)} px,'
            f' density {fixed(accuracy.density_percent)} %'
        )
        figures.append(_figure(error_map(estimate.disparity_px.ravel()[shown], truth_px), caption))
        if score.ours:
            caption = f'{html.escape(score.method)}: disparity'
            figures.append(_figure(heat_map(estimate.disparity_px, limits), caption))
    seen = f', visibility from {scene.visible_source}' if scene.visible_source else ''
    text = (
        f'{scores.width} x {scores.height} px, {scene.max_disparity_px} disparities, ground truth'
        f' for {scores.truth_percent:.0f} % of the pixels{seen}. Source:'
        f' {html.escape(scene.source)}'
    )
    return page_parts.section(scene.name, text, f'<div class="small">{"".join(figures)}</div>')


def page(
    title: str,
    notes: Sequence[str],
    tables: Sequence[str],
    sections: Sequence[str],
    ours: Collection[str],
) -> str:
    """Return the whole page.

    Parameters
    ----------
    title : str
        Heading.
    notes : sequence of str
        Paragraphs of plain text under it.
    tables : sequence of str
        Markdown tables.
    sections : sequence of str
        HTML of the scenes.
    ours : collection of str
        First cells of the rows of our methods.

    """
    text = '</p><p>'.join(html.escape(note) for note in notes)
    results = page_parts.section('Results', text, *(_html_table(one, ours) for one in tables))
    return page_parts.page(title, [results, _key_to_errors(), *sections])


def _nearest_known(truth_px: FloatImage) -> npt.NDArray[np.intp]:
    """Return, (H, W), the flat index of the pixel to show in each place.

    Where the ground truth is sparse, a pixel without it shows its nearest neighbour with it:
    single dots would not be seen.
    """
    known = np.isfinite(truth_px)
    index = np.arange(truth_px.size).reshape(truth_px.shape)
    if not known.any():
        return index
    distance, labels = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    known_index = np.empty(labels.max() + 1, np.intp)
    known_index[labels[known]] = index[known]
    reach = 0.0 if known.mean() >= _DENSE_SHARE else _SPARSE_REACH_PX
    return np.where(distance <= reach, known_index[labels], index)


def _html_table(markdown: str, ours: Collection[str]) -> str:
    header, _, *rows = (
        [cell.strip() for cell in re.split(r'(?<!\\)\|', line)[1:-1]]
        for line in markdown.splitlines()
    )
    marked = [number for number, row in enumerate(rows) if row[0] in ours]
    cells = [[html.escape(cell) for cell in row] for row in rows]
    return f'<div class="scroll">{page_parts.table(header, cells, marked=marked)}</div>'


def _key_to_errors() -> str:
    low, parts = 0.0, []
    for high, colour in zip(ERROR_LIMITS_PX, ERROR_COLOURS, strict=True):
        label = f'{low:g} - {high:g} px' if np.isfinite(high) else f'more than {low:g} px'
        parts.append((label, f'rgb{colour}'))
        low = high
    parts += [
        ('unfilled', f'rgb{UNFILLED_COLOUR}'),
        ('no ground truth', f'rgb{UNKNOWN_COLOUR}'),
    ]
    return page_parts.section(
        'Error maps',
        'Absolute error of each pixel.',
        f'<div class="wide">{page_parts.legend(*parts)}</div>',
    )


def _figure(image: ByteImage, caption: str, *, photo: bool = False) -> str:
    height, width = image.shape[:2]
    if width > _IMAGE_WIDTH:
        size = (_IMAGE_WIDTH, max(1, round(height * _IMAGE_WIDTH / width)))
        # maps have classes of colours, which must not be mixed
        method = cv2.INTER_AREA if photo else cv2.INTER_NEAREST
        image = np.asarray(cv2.resize(image, size, interpolation=method), np.uint8)
    return page_parts.image_figure(image, caption, photo=photo)
