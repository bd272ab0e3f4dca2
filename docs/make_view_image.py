# SPDX-License-Identifier: Apache-2.0
"""Write the image of the page of `view`: ``make_view_image.py FOLDER``, with Chromium."""

from __future__ import annotations

import runpy
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

PATH = Path(__file__).with_name('images') / 'view.jpg'
DRIVER = Path(__file__).parents[1] / 'test' / 'browser' / 'chromium.py'
SIZE, WIDTH = (1500, 800), 1200
PICKS = """
picks:
- {name: rear, frame: 0, u: 214.0, v: 262.0}
- {name: engine, frame: 0, u: 400.0, v: 330.0}
- {name: seat, frame: 0, u: 250.0, v: 204.0}
- {name: lamp, frame: 0, u: 573.0, v: 127.0}
measurements:
- {name: wheel to engine, kind: distance, points: [rear, engine]}
- {name: height of seat, kind: height, points: [seat]}
- {name: seat to lamp, kind: vertical, points: [seat, lamp]}
"""
CLOUD = "document.querySelector('#cloud').contentDocument"


def main() -> None:
    """Start `view`, wait until its page is drawn, and save what it shows."""
    with tempfile.TemporaryDirectory() as folder:
        picks = Path(folder, 'picks.yaml')
        picks.write_text(PICKS)
        words = ['view', sys.argv[1], '--picks', str(picks), '--no-browser']
        with subprocess.Popen(
            [sys.executable, '-m', 'binocular_recon', *words], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            address = process.stdout.readline().strip()
            try:
                image = picture(address)
            finally:
                process.terminate()
    height = round(WIDTH * image.shape[0] / image.shape[1])
    small = cv2.resize(image, (WIDTH, height), interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(PATH), small, [cv2.IMWRITE_JPEG_QUALITY, 80])


def picture(address: str) -> cv2.typing.MatLike:
    """Return the page once its cloud is drawn, (H, W, 3) BGR."""
    with runpy.run_path(str(DRIVER))['chromium']() as (tab,):
        tab.open(address, SIZE)
        tab.wait_for(f"{CLOUD}.body.innerText.includes('view')")
        image = np.zeros((*SIZE[::-1], 3), np.uint8)
        end = time.monotonic() + 120
        while time.monotonic() < end:
            before = image
            # that WebGL is drawn by the processor is not for the reader
            tab.value(f"{CLOUD}.querySelector('.mantine-Notification-closeButton')?.click()")
            image = cv2.imdecode(np.frombuffer(tab.screenshot(), np.uint8), cv2.IMREAD_COLOR)
            said = tab.value(f"{CLOUD}.querySelector('.mantine-Notification-root') !== null")
            if image[250:650, 650:1150].std() > 30 and not said and (image == before).all():
                return image
            time.sleep(2)
    raise SystemExit('the cloud was not drawn')


if __name__ == '__main__':
    main()
