# SPDX-License-Identifier: Apache-2.0
"""The drawing from which rods are made and put up: one A4 sheet, to scale."""

from __future__ import annotations

from itertools import pairwise
from textwrap import wrap

import numpy as np

from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray
from binocular_recon.drawing.sheet import Sheet
from binocular_recon.drawing.svg import FAINT, INK
from binocular_recon.number_text import counted, plain

# A4, landscape, mm.
_SHEET = (297.0, 210.0)
_MARGIN = 12.0
_SCALES = (1, 2, 5, 10, 20, 25, 50, 100, 200, 250, 500, 1000, 2000)
_DARK, _LIGHT = INK, '#ffffff'
# Areas of the sheet: left, top, width, height, mm.
_ROW = (24.0, 34.0, 118.0, 104.0)
_PLAN = (24.0, 162.0, 118.0, 12.0)
_ROD = (166.0, 34.0, 8.0, 118.0)
_NOTES = (205.0, 34.0)
_NOTE_CHARACTERS = 48
_BAR_MM = 100.0
# Lines of text closer than this cannot be read, mm.
_LINE_MM = 3.6


def rods_plan(board: RodBoard) -> Sheet:
    """Draw the rods of a board to scale.

    The sheet shows the row from the front and from above, one rod with its bands and the heights
    of the marks, and how to paint, measure and set up the rods. Printed at 100 %, its bar is
    100 mm long.

    Parameters
    ----------
    board : RodBoard
        The rods.

    Returns
    -------
    Sheet
        A4, landscape; `Sheet.svg` and `Sheet.pdf` are the files.

    """
    rods, marks = counted(board.count, 'rod'), counted(board.marks_per_rod, 'mark')
    sheet = Sheet(_SHEET, f'{rods} with {marks} each')
    sheet.text(_MARGIN, 17, sheet.title, size=6)
    facts = (
        f'diameter {_mm(board.rod_diameter_m)} mm; mark_type {board.mark_type.name}: edges between'
        f' dark and light bands, {board.mark_type.lowest_band} below the lowest mark; heights and'
        ' distances in mm'
    )
    sheet.text(_MARGIN, 23.5, facts, FAINT)
    _draw_row(sheet, board)
    _draw_plan(sheet, board)
    _draw_rod(sheet, board)
    _draw_notes(sheet, board)
    _draw_bar(sheet)
    return sheet


def _draw_row(sheet: Sheet, board: RodBoard) -> None:
    """Draw the row from the front."""
    left, top, width, height = _ROW
    x_m = board.rods_xz_m[:, 0] - board.rods_xz_m[0, 0]
    edges = band_edges_m(board)
    scale = _scale_of(
        (float(x_m[-1]) + board.rod_diameter_m, width), (float(edges[-1]), height - 6)
    )
    ground = top + height
    x = left + (500 * board.rod_diameter_m + 1000 * x_m) / scale
    for place in x:
        _draw_bands(sheet, board, float(place), ground, scale)
    sheet.line((left - 4, ground), (left + width + 4, ground), 0.4)
    sheet.text(left, top - 2, f'From the front, 1:{scale}', FAINT)
    _draw_distances(sheet, x, ground + 5, x_m)


def _draw_distances(sheet: Sheet, x: FloatArray, y: float, x_m: FloatArray) -> None:
    """Write the distance of each rod from the first one under it, in turn on two or more lines."""
    last = [-np.inf] * 4
    for index, (place, distance) in enumerate(zip(x, x_m, strict=True)):
        text = _mm(distance)
        half = 0.5 * 1.8 * len(text) + 0.6
        free = [row for row, end in enumerate(last) if place - half > end]
        if free:
            row = free[0]
            last[row] = place + half
            sheet.line((place, y - 4), (place, y - 3.2 + 3.2 * row), 0.1)
            sheet.text(float(place), y + 3.2 * row, text, anchor='middle')
        if index == 0:
            sheet.text(float(place) - 4, y, 'x', FAINT, 'end')


def _draw_plan(sheet: Sheet, board: RodBoard) -> None:
    """Draw the row from above: how far each rod stands in front of the plane, or behind it."""
    left, top, width, height = _PLAN
    x_m = board.rods_xz_m[:, 0] - board.rods_xz_m[0, 0]
    z_m = board.rods_xz_m[:, 1]
    spread = float(np.abs(z_m).max())
    scale = _scale_of(
        (float(x_m[-1]) + board.rod_diameter_m, width),
        (2 * spread + board.rod_diameter_m, height),
    )
    middle = top + height / 2
    sheet.text(left, top - 3, f'From above, 1:{scale}; cameras below, z towards them', FAINT)
    sheet.line((left - 4, middle), (left + width + 4, middle), 0.1)
    radius = max(0.25, 500 * board.rod_diameter_m / scale)
    for x, z in zip(x_m, z_m, strict=True):
        place = left + (500 * board.rod_diameter_m + 1000 * float(x)) / scale
        sheet.disc(place, middle + 1000 * float(z) / scale, radius)
        if z:
            sheet.text(place, top + height + 4, f'z {_mm(float(z))}', anchor='middle', size=2.5)


def _draw_rod(sheet: Sheet, board: RodBoard) -> None:
    """Draw one rod with the height of each mark."""
    left, top, width, height = _ROD
    edges = band_edges_m(board)
    scale = _scale_of((board.rod_diameter_m, width), (float(edges[-1]), height))
    foot, x = top + height, left + width / 2
    sheet.text(left, top - 2, f'One rod, 1:{scale}', FAINT)
    _draw_bands(sheet, board, x, foot, scale)
    half = 500 * board.rod_diameter_m / scale
    places = foot - 1000 * board.marks_m / scale
    limits = top + 2, _SHEET[1] - 22
    gap = min(_LINE_MM, (limits[1] - limits[0]) / board.marks_per_rod)
    labels = spread_labels(places[::-1], gap, limits)[::-1]
    for place, label, mark in zip(places, labels, board.marks_m, strict=True):
        sheet.line((x + half, float(place)), (x + half + 3, float(place)), 0.15)
        sheet.line((x + half + 3, float(place)), (x + half + 7, float(label)), 0.15)
        sheet.text(x + half + 8, float(label) + gap / 3, _mm(float(mark)), size=gap / 1.2)
    sheet.line((x - half - 3, foot), (x + half + 3, foot), 0.4)
    sheet.text(x - half - 4, foot + 1, 'foot 0', anchor='end')


def _draw_bands(sheet: Sheet, board: RodBoard, x: float, foot: float, scale: int) -> None:
    wide = 1000 * board.rod_diameter_m / scale
    for light, (low, high) in zip(
        board.light_bands, pairwise(band_edges_m(board).tolist()), strict=True
    ):
        top, tall = foot - 1000 * high / scale, 1000 * (high - low) / scale
        sheet.box(x - wide / 2, top, wide, tall, _LIGHT if light else _DARK)


def _draw_notes(sheet: Sheet, board: RodBoard) -> None:
    left, y = _NOTES
    sheet.text(left, y - 2, 'Making and putting up', FAINT)
    for what, text in _notes(board).items():
        y += 2.0
        for line in wrap(f'{what}: {text}', _NOTE_CHARACTERS):
            y += _LINE_MM
            sheet.text(left, y, line, size=2.7)


def _notes(board: RodBoard) -> dict[str, str]:
    """Return what a crew must know, one paragraph each."""
    diameter, top = _mm(board.rod_diameter_m), _mm(float(band_edges_m(board)[-1]))
    girth = _mm(np.pi * board.rod_diameter_m)
    placement, height = _mm(board.placement_sigma_m), _mm(board.height_sigma_m)
    tilt = plain(1000 * board.tilt_sigma_rad, 3)
    return {
        'Rods': f'straight tubes of {diameter} mm, at least {top} mm long. Roll them on a flat'
        ' floor: what does not roll straight is not used.',
        'Marks': 'measure every height from the foot with one steel tape. Distances from mark to'
        ' mark would add up their errors. A mark is the edge of a band, not a line.',
        'Bands': 'matt black and matt white paint or tape, no gloss. Cut tape square: its edge'
        f' meets itself after one turn of {girth} mm.',
        'Top': 'the last band reaches at least as far above the highest mark as is drawn, so that'
        ' this mark is an edge too.',
        'Feet': 'a plate or a spike. Height 0 is where the lowest band begins; all feet within'
        f' {height} mm of one level.',
        'Place': f'along a stretched tape; each rod within {placement} mm of its distance and of'
        ' the straight line.',
        'Plumb': f'a spirit level on two sides of each rod; within {tilt} mm per metre.',
        'Tolerances': 'are one standard deviation each. State what was kept in rods.yaml'
        ' (placement_sigma, height_sigma, tilt_sigma): the calibration allows for it.',
    }


def _draw_bar(sheet: Sheet) -> None:
    """Draw the bar that tells whether the print is to scale."""
    x, y = _MARGIN + 12, _SHEET[1] - 14
    for index in range(10):
        sheet.box(x + index * 10, y, 10, 2, _LIGHT if index % 2 else _DARK)
    sheet.text(x + _BAR_MM + 4, y + 2, '100 mm when printed at 100 %, without fitting to the page')


def band_edges_m(board: RodBoard) -> FloatArray:
    """Return the limits of the bands (M + 2,), m: the foot, the marks, the top as it is drawn.

    ``rods.yaml`` does not state the top; the last band is drawn as tall as the one below it.
    """
    marks = board.marks_m
    return np.concatenate([[0.0], marks, [2 * marks[-1] - marks[-2]]])


def spread_labels(places: FloatArray, gap: float, limits: tuple[float, float]) -> FloatArray:
    """Return where labels of growing ``places`` (M,) stand: ``gap`` apart, within ``limits``.

    Of all such positions those with the least squares of the distances from their places, by
    pooling neighbours that are too close.
    """
    steps = gap * np.arange(places.size)
    pools: list[tuple[float, int]] = []
    for value in (places - steps).tolist():
        pools.append((value, 1))
        while len(pools) > 1 and pools[-2][0] > pools[-1][0]:
            (a, m), (b, n) = pools[-2:]
            pools[-2:] = [((a * m + b * n) / (m + n), m + n)]
    values, counts = zip(*pools, strict=True)
    spread = np.repeat(values, counts).clip(limits[0], limits[1] - steps[-1])
    return np.asarray(spread + steps, np.float64)


def _scale_of(*lengths: tuple[float, float]) -> int:
    """Return the largest usual scale, 1:n, at which all lengths (m) fit their room (mm)."""
    need = max(1000 * length_m / room for length_m, room in lengths)
    return next((scale for scale in _SCALES if scale >= need), _SCALES[-1])


def _mm(length_m: float) -> str:
    return plain(round(1000 * length_m, 1))
