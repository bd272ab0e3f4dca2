# SPDX-License-Identifier: Apache-2.0
"""Chromium shows the report's cloud, takes a click on it, and prints it on A4 (make clients)."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from binocular_recon.drawing.cloud_view import ViewedCloud, cloud_script, cloud_view
from binocular_recon.drawing.page import page, section

BROWSER = shutil.which('chromium') or shutil.which('chromium-browser')
OPTIONS = [
    '--headless', '--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader',
    '--virtual-time-budget=5000', '--no-pdf-header-footer', '--window-size=1000,1000',
]  # fmt: skip
PLACE = np.array([500_000.0, 5_000_000.0, 300.0])
# Clicks in the middle of the canvas once the page is there.
CLICK = """<script>setTimeout(() => {
  const canvas = document.querySelector('canvas'), box = canvas.getBoundingClientRect();
  canvas.setPointerCapture = () => {};
  document.querySelector('button[value=camera]').click();
  for (const kind of ['pointerdown', 'pointerup']) canvas.dispatchEvent(new PointerEvent(kind,
    { pointerId: 1, clientX: box.left + box.width / 2, clientY: box.top + box.height / 2 }));
}, 200);</script></body>"""

pytestmark = pytest.mark.skipif(BROWSER is None, reason='needs Chromium: apt-get install chromium')


def browse(*arguments: str) -> str:
    assert BROWSER is not None
    command = [BROWSER, *OPTIONS, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True, timeout=120).stdout


@pytest.fixture(scope='module')
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a page with a flat red cloud of 41 x 31 points, 10 m ahead of the camera."""
    x, z = np.meshgrid(np.linspace(-4, 4, 41), np.linspace(-3, 3, 31))
    xyz = np.stack([x, np.full_like(x, 10.0), z], axis=-1).reshape(-1, 3) + PLACE
    count = len(xyz)
    cloud = ViewedCloud(
        xyz, np.tile(np.array([255, 0, 0], np.uint8), (count, 1)), np.full(count, 0.0123),
        np.ones(count, bool), ('E', 'N', 'H'), 'sigma H', np.eye(3), PLACE, 0.02,
    )  # fmt: skip
    still = cv2.imencode('.jpg', np.full((90, 160, 3), 255, np.uint8))[1].tobytes()
    view = section('Point cloud', '', cloud_view(cloud, still, 'A cloud.'))
    path = tmp_path_factory.mktemp('page') / 'report.html'
    path.write_text(page('A site', [view], script=cloud_script()))
    return path


def test_the_cloud_is_drawn(report: Path) -> None:
    shot = report.with_suffix('.png')
    browse(f'--screenshot={shot}', report.as_uri())
    red = (cv2.imread(str(shot)) == [0, 0, 255]).all(axis=-1)
    assert red.sum() > 20_000


def test_a_click_tells_the_coordinates_of_the_point(report: Path) -> None:
    clicked = report.with_name('clicked.html')
    clicked.write_text(report.read_text().replace('</body>', CLICK))
    dom = browse('--dump-dom', clicked.as_uri())
    assert 'class="cloud live"' in dom
    found = re.search(
        r'<output>E ([\d.]+) +N ([\d.]+) +H ([\d.]+) m, sigma H ([\d.]+) m, measured</output>', dom
    )
    assert found, re.findall('<output>.*</output>', dom)
    *place, sigma = map(float, found.groups())
    # the camera looks at the middle of the cloud
    assert np.abs(np.array(place) - PLACE - [0, 10, 0]).max() < 0.15
    assert sigma == 0.012


def test_it_is_printed_on_a4(report: Path) -> None:
    pdf = report.with_suffix('.pdf')
    browse(f'--print-to-pdf={pdf}', report.as_uri())
    width, height = map(
        float, re.findall(rb'/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]', pdf.read_bytes())[0]
    )
    assert [width, height] == pytest.approx([595, 842], abs=2)
