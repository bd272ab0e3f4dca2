# SPDX-License-Identifier: Apache-2.0
"""Real clicks in a headless Chromium: lengths appear that `measure` reports too (make browser).

Not a part of ``make test``: it needs a Chromium of the system.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from binocular_recon.cli.main import main
from binocular_recon.measurement.picks import read_picks
from test.browser.chromium import PROGRAM, Tab, chromium
from test.unit.measurement.measured_site import MeasuredSite, write_output

pytest.importorskip('viser')
pytestmark = [
    pytest.mark.skipif(not PROGRAM, reason='needs Chromium: apt-get install chromium'),
    pytest.mark.timeout(1200),  # WebGL in software beside other work; every wait has its own limit
]

# What the page shows of each measurement, as its list states it.
VALUES = "[...document.querySelectorAll('#measurements .value')].map(one => one.textContent)"
NAMES = "[...document.querySelectorAll('#picks input')].map(one => one.value)"


class Served(NamedTuple):
    """A running `view`."""

    address: str
    output: Path
    picks: Path
    site: MeasuredSite


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    site = MeasuredSite(0)
    output, picks = write_output(site, tmp_path / 'out', frames=2), tmp_path / 'out' / 'picks.yaml'
    shutil.copy(output / '000000_left.png', output / '000000_right.png')
    words = [sys.executable, '-m', 'binocular_recon', 'view', str(output), '--no-browser']
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield Served(process.stdout.readline().strip(), output, picks, site)
        process.terminate()


def ready(tab: Tab, address: str) -> None:
    """Open the page and wait for image and cloud."""
    tab.open(address, scale=0.5)  # WebGL in software takes a quarter of the time
    tab.wait_for("document.querySelector('#points').textContent.includes('points')")
    cloud = "document.querySelector('#cloud').contentDocument"
    tab.wait_for(f"[...{cloud}.querySelectorAll('canvas')].some(one => one.width > 100)")
    tab.wait_for(f"{cloud}.body.innerText.includes('view')")  # what the server has set last


def box(tab: Tab, selector: str) -> list[float]:
    """Return the left and top edge, width and height of an element."""
    found: list[float] = tab.value(
        '(({x, y, width, height}) => [x, y, width, height])'
        f'(document.querySelector({selector!r}).getBoundingClientRect())'
    )
    return found


def place(tab: Tab, pixel: list[float], image: str = '#image') -> tuple[float, float]:
    """Return where a pixel of an image is in the tab, once the image is fitted."""
    x, y, width, height = box(tab, image)
    columns, rows = 288, 180
    scale = min(width / columns, height / rows)
    return (
        x + (width - (columns - 1) * scale) / 2 + pixel[0] * scale,
        y + (height - (rows - 1) * scale) / 2 + pixel[1] * scale,
    )


def reported(served: Served, folder: Path) -> list[str]:
    """Return what `measure` says to the saved picks file."""
    words = ['measure', str(served.output), '--picks', str(served.picks)]
    assert main([*words, '--output', str(folder)]) == 0
    content = json.loads((folder / 'measurements.json').read_text())
    return [
        f'{main_one["value"]:.3f} +- {main_one["sigma"]:.3f} {main_one["unit"]}'
        for one in content['measurements']
        for main_one in [next(value for value in one.values() if isinstance(value, dict))]
    ]


def test_clicks_in_image_and_cloud_in_two_browsers(served: Served, tmp_path: Path) -> None:
    pixels = served.site.random_pixels(np.random.default_rng(4), 40)[0].tolist()
    first, second = pixels[0], pixels[2]
    with chromium(tabs=2) as (tab, other):
        ready(tab, served.address)
        tab.click(*place(tab, first))
        tab.wait_for(f"{NAMES}.join() === 'P1'")
        tab.click(*place(tab, second))
        (value,) = tab.wait_for(f'{VALUES}.length === 1 && {VALUES}')
        assert reported(served, tmp_path) == [value]
        # another browser shows the same; what it does appears here
        ready(other, served.address)
        other.wait_for(f'{VALUES}.length === 1')
        assert other.value(VALUES) == [value]
        # zoomed in, a click picks finer
        x, y = place(other, [100.0, 120.0])
        other.front()
        for _ in range(6):
            other.wheel(x, y, -400)
        other.click(x, y)
        tab.wait_for(f'{NAMES}.length === 3')
        other.press('z', control=True)
        tab.wait_for(f'{NAMES}.length === 2')
        # in the cloud, until a click meets a point
        tab.front()
        left, top, _, _ = box(tab, '[data-name=point]')
        tab.click(left + 20, top + 10)
        tab.wait_for("document.querySelector('[data-name=point]').ariaChecked === 'true'")
        left, top, width, height = box(tab, '#cloud')
        for down in (0.55, 0.6, 0.65, 0.7):
            tab.click(left + 0.5 * width, top + down * height)
            tab.wait_for(f"{NAMES}.length === 3 || !document.querySelector('#message').hidden")
            if tab.value(f'{NAMES}.length') == 3:
                break
        assert tab.value(f'{VALUES}.length') == 4  # a length, and x, y, z
        assert not [*tab.errors, *other.errors]
        own = served.address.split('//')[1]
        outside = [
            one for one in (*tab.requests, *other.requests)
            if not one.startswith((f'http://{own}', f'ws://{own}', 'data:', 'blob:'))
        ]  # fmt: skip
        assert not outside, 'the page is complete without the network'
        kept = tab.value(NAMES)
    # browsers that close lose nothing
    with chromium() as (tab,):
        ready(tab, served.address)
        assert tab.value(NAMES) == kept
        tab.screenshot()


def test_a_point_is_picked_in_both_images(served: Served) -> None:
    (u, v), *_ = served.site.random_pixels(np.random.default_rng(4), 40)[0].tolist()
    there = u - float(served.site.frame.disparity_px[round(v), round(u)])
    with chromium() as (tab,):
        ready(tab, served.address)
        left, top, width, height = box(tab, '#both')
        tab.click(left + width / 2, top + height / 2)
        right = '#right-image'
        tab.wait_for(f"document.querySelector('{right}').width > 100")
        tab.click(*place(tab, [u, v]))
        tab.wait_for("document.querySelector('#hint').textContent.includes('right image')")
        assert tab.value(f'{NAMES}.length') == 0
        tab.click(*place(tab, [there, v], right))
        tab.wait_for(f"{NAMES}.join() === 'P1'")
        assert not tab.errors
        tab.screenshot()
    both = read_picks(served.picks)[0]['P1'].right
    assert both is not None
    # the row of the mouse is a whole pixel of the screen
    np.testing.assert_allclose(both, [there, v], atol=0.5)
