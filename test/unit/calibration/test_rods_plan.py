# SPDX-License-Identifier: Apache-2.0
"""The drawing of the rods is to scale, in both formats."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from binocular_recon.calibration.report.rods_plan import rods_plan, spread_labels
from binocular_recon.calibration.target.rods import RodBoard, load_rods, save_rods
from binocular_recon.cli.main import main
from test.conftest import REPOSITORY

SVG = '{http://www.w3.org/2000/svg}'
BOARD = RodBoard.from_mapping(
    {
        'rods': [{'x': 0.0}, {'x': 0.5, 'z': 0.2}, {'x': 1.7}],
        'marks': [0.2, 0.5, 0.9, 1.6],
        'mark_type': 'band_edge_light',
        'rod_diameter': 0.04,
        'placement_sigma': 0.003,
    }
)


def numbers(element: ET.Element, *names: str) -> list[float]:
    return [float(element.get(name, 'nan')) for name in names]


def test_rods_and_bands_are_to_scale() -> None:
    root = ET.fromstring(rods_plan(BOARD).svg())
    assert (root.get('width'), root.get('height')) == ('297mm', '210mm')
    texts = [text.text or '' for text in root.iter(f'{SVG}text')]
    (scale,) = (float(m[1]) for m in map(re.compile('From the front, 1:(.*)').match, texts) if m)
    boxes = [box for box in root.iter(f'{SVG}rect') if box.get('x')]
    places = np.array([numbers(box, 'x', 'y', 'width', 'height') for box in boxes])
    first = places[0]
    for index, (x, y, width, height) in enumerate(places[: 3 * 5]):  # three rods, five bands
        rod, band = divmod(index, 5)
        low, high = [0.0, 0.2, 0.5, 0.9, 1.6, 2.3][band : band + 2]
        assert width == pytest.approx(40 / scale, abs=0.002)
        assert height == pytest.approx(1000 * (high - low) / scale, abs=0.002)
        assert y - first[1] == pytest.approx(1000 * (0.2 - high) / scale, abs=0.002)
        assert x - first[0] == pytest.approx(1000 * [0, 0.5, 1.7][rod] / scale, abs=0.002)
        assert boxes[index].get('fill') == ('#ffffff' if band % 2 == 0 else '#22313f')
    assert {'200', '500', '900', '1600', '1700', 'z 200'} <= set(texts)
    bar = places[-10:]
    assert bar[-1, 0] + bar[-1, 2] - bar[0, 0] == pytest.approx(100)


def test_nothing_leaves_the_sheet() -> None:
    close = {
        'rods': [{'x': 0.1 * i, 'z': 0.05 * (-1) ** i} for i in range(30)],
        'marks': np.linspace(0.05, 0.9, 60).tolist(),
        'rod_diameter': 0.02,
        'placement_sigma': 0.0,
    }
    long = {'rods': [{'x': 0.0}], 'marks': [1.0, 20.0], 'rod_diameter': 0.1, 'placement_sigma': 0}
    for board in map(RodBoard.from_mapping, (close, long)):
        root = ET.fromstring(rods_plan(board).svg())
        for shape in (*root.iter(f'{SVG}text'), *root.iter(f'{SVG}rect')):
            x, y = float(shape.get('x', '0')), float(shape.get('y', '0'))
            assert 0 <= x <= 290 and 0 <= y <= 205


def test_labels_are_apart_and_near_their_marks() -> None:
    places = np.array([0.0, 10.0, 10.5, 11.0, 30.0])
    labels = spread_labels(places, 3.0, (-5.0, 40.0))
    np.testing.assert_allclose(labels, [0, 7.5, 10.5, 13.5, 30])
    tight = spread_labels(places, 3.0, (9.0, 25.0))
    assert tight[0] >= 9 and tight[-1] <= 25
    assert min(b - a for a, b in pairwise(tight.tolist())) > 3 - 1e-9


def test_a_pdf_is_one_page_of_the_same_shapes() -> None:
    sheet = rods_plan(BOARD)
    pdf = sheet.pdf()
    assert pdf.startswith(b'%PDF-1.4') and pdf.endswith(b'%%EOF\n')
    (start,) = re.findall(rb'startxref\n(\d+)', pdf)
    assert pdf[int(start) :].startswith(b'xref\n0 7\n')
    for number, place in enumerate(re.findall(rb'(\d{10}) 00000 n', pdf), 1):
        assert pdf[int(place) :].startswith(b'%d 0 obj' % number)
    box = re.search(rb'/MediaBox \[0 0 (\S+) (\S+)\]', pdf)
    assert box is not None
    np.testing.assert_allclose([float(box[1]), float(box[2])], [841.89, 595.28], atol=0.01)
    (length,) = re.findall(rb'/Length (\d+)', pdf)
    stream = pdf[pdf.index(b'stream\n') + 7 :]
    assert stream[int(length) :].startswith(b'\nendstream')
    root = ET.fromstring(sheet.svg())
    boxes = [box for box in root.iter(f'{SVG}rect') if box.get('x')]
    assert stream.count(b' re B') == len(boxes)
    assert stream.count(b' Tj ET') == len([*root.iter(f'{SVG}text')])
    assert stream.count(b' l S') == len([*root.iter(f'{SVG}line')])
    assert stream.count(b' c f') == BOARD.count


def test_the_command_writes_what_the_ending_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_rods(BOARD, tmp_path / 'rods.yaml')
    for name, head in (('plan.pdf', b'%PDF'), ('plan.svg', b'<svg')):
        words = ['rods-plan', tmp_path / 'rods.yaml', '--output', tmp_path / name]
        assert main([str(word) for word in words]) == 0
        assert (tmp_path / name).read_bytes().startswith(head)
        assert 'print at 100 %' in capsys.readouterr().out
    rods = str(REPOSITORY / 'config' / 'rods.yaml')
    assert load_rods(rods).count == 5
    assert main(['rods-plan', rods, '--output', str(tmp_path / 'plan.dxf')]) == 2
    assert '--output must end with .pdf or .svg, got plan.dxf' in capsys.readouterr().err
    assert main(['rods-plan', str(tmp_path / 'none.yaml'), '--output', 'plan.svg']) == 1
    assert 'none.yaml' in capsys.readouterr().err
