# SPDX-License-Identifier: Apache-2.0
"""A self-contained page: the tables and a map of the errors of every method on every scene."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.drawing.colormap import heat_map
from binocular_recon.evaluation.accuracy.scoring import SceneResult
from binocular_recon.evaluation.tables import figure
from binocular_recon.images import ByteImage, FloatImage, to_bgr8

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

_PICTURE_WIDTH = 420
# Below this share of known pixels ground truth is shown as blots of this radius.
_DENSE_SHARE = 0.6
_SPARSE_REACH_PX = 3.0

_STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 1360px;
  padding: 0 1.2rem; color: #1d2530; background: #fff; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2.2rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .6rem 0 1.2rem; }
th, td { padding: .22rem .7rem; text-align: right; border-bottom: 1px solid #dfe4ea;
  white-space: nowrap; }
th { font-weight: 600; background: #f4f6f8; white-space: normal; vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; }
tr.ours td { background: #eef6ee; }
p.note { color: #55606e; max-width: 60rem; }
.grid { display: grid; grid-template-columns: repeat(auto-fill, minmax(300px, 1fr)); gap: .9rem; }
figure { margin: 0; } figure img { width: 100%; display: block; }
figcaption { font-size: .84rem; padding-top: .2rem; } figcaption b { font-weight: 600; }
.legend { font-size: .84rem; margin: .8rem 0; position: sticky; top: 0; background: #fff;
  padding: .4rem 0; }
.legend span { display: inline-block; margin-right: .9rem; white-space: nowrap; }
.legend i { display: inline-block; width: 1.1em; height: 1.1em; vertical-align: -.18em;
  margin-right: .3em; border: 1px solid #0002; }
"""


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
    picture = np.array(ERROR_COLOURS, np.uint8)[classes]
    picture[~np.isfinite(disparity_px)] = UNFILLED_COLOUR
    picture[~np.isfinite(truth_px)] = UNKNOWN_COLOUR
    return np.ascontiguousarray(picture[..., ::-1])


def scene_section(result: SceneResult) -> str:
    """Return the HTML of one scene: picture, ground truth, and each method's two maps."""
    scene, scores = result.scene, result.scores
    known = scene.truth_px[np.isfinite(scene.truth_px)]
    limits = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    shown = _nearest_known(scene.truth_px)
    truth_px = scene.truth_px.ravel()[shown]
    figures = [
        _figure(to_bgr8(scene.left), 'left picture', photo=True),
        _figure(heat_map(truth_px, limits), 'ground truth (black: unknown)'),
    ]
    for score, estimate in zip(scores.scores, result.estimates, strict=True):
        accuracy = score.everywhere
        caption = (
            f'<b>{html.escape(score.method)}</b> bad-2.0 {figure(accuracy.bad_percent[1])} %,'
            f' mean error {figure(accuracy.mean_error_px, 2)} px,'
            f' density {figure(accuracy.density_percent)} %'
        )
        figures.append(_figure(error_map(estimate.disparity_px.ravel()[shown], truth_px), caption))
        if score.ours:
            caption = f'{html.escape(score.method)}: disparity'
            figures.append(_figure(heat_map(estimate.disparity_px, limits), caption))
    seen = f', visibility from {scene.visible_source}' if scene.visible_source else ''
    return (
        f'<h2>{html.escape(scene.name)}</h2>\n<p class="note">{scores.width} x {scores.height} px,'
        f' {scene.max_disparity_px} disparities, ground truth for {scores.truth_percent:.0f} % of'
        f' the pixels{seen}. Source: {html.escape(scene.source)}</p>\n'
        f'<div class="grid">{"".join(figures)}</div>\n'
    )


def page(title: str, notes: Sequence[str], tables: Sequence[str], sections: Sequence[str]) -> str:
    """Return the whole page.

    Parameters
    ----------
    title : str
        Heading.
    notes : sequence of str
        Paragraphs of plain text under it.
    tables : sequence of str
        Markdown tables; rows of our presets are those whose first cell starts in lower case.
    sections : sequence of str
        HTML of the scenes.

    """
    body = ''.join(f'<p class="note">{html.escape(note)}</p>\n' for note in notes)
    body += ''.join(f'<div class="scroll">{_html_table(table)}</div>\n' for table in tables)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<title>{html.escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n'
        f'<h1>{html.escape(title)}</h1>\n{body}{_legend()}{"".join(sections)}</body>\n</html>\n'
    )


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


def _html_table(markdown: str) -> str:
    header, _, *rows = (
        [cell.strip() for cell in re.split(r'(?<!\\)\|', line)[1:-1]]
        for line in markdown.splitlines()
    )
    head = ''.join(f'<th>{html.escape(cell)}</th>' for cell in header)
    lines = []
    for row in rows:
        kind = ' class="ours"' if row[0][:1].islower() else ''
        lines.append(f'<tr{kind}>{"".join(f"<td>{html.escape(cell)}</td>" for cell in row)}</tr>')
    return f'<table><thead><tr>{head}</tr></thead><tbody>{"".join(lines)}</tbody></table>'


def _legend() -> str:
    low, parts = 0.0, []
    for high, colour in zip(ERROR_LIMITS_PX, ERROR_COLOURS, strict=True):
        label = f'{low:g} - {high:g} px' if np.isfinite(high) else f'more than {low:g} px'
        parts.append((label, colour))
        low = high
    parts += [('unfilled', UNFILLED_COLOUR), ('no ground truth', UNKNOWN_COLOUR)]
    spans = (
        f'<span><i style="background: rgb{colour}"></i>{label}</span>' for label, colour in parts
    )
    return f'<div class="legend">Error: {"".join(spans)}</div>\n'


def _figure(picture: ByteImage, caption: str, *, photo: bool = False) -> str:
    height, width = picture.shape[:2]
    if width > _PICTURE_WIDTH:
        size = (_PICTURE_WIDTH, max(1, round(height * _PICTURE_WIDTH / width)))
        # maps have classes of colours, which must not be mixed
        method = cv2.INTER_AREA if photo else cv2.INTER_NEAREST
        picture = cv2.resize(picture, size, interpolation=method)
    suffix, kind = ('.jpg', 'jpeg') if photo else ('.png', 'png')
    data = base64.b64encode(cv2.imencode(suffix, picture)[1].tobytes()).decode()
    plain = html.escape(re.sub('<.*?>', '', caption), quote=True)
    return (
        f'<figure><img loading="lazy" alt="{plain}" src="data:image/{kind};base64,{data}">'
        f'<figcaption>{caption}</figcaption></figure>'
    )
