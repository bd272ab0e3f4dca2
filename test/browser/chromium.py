# SPDX-License-Identifier: Apache-2.0
"""Drive a headless Chromium through its DevTools protocol: clicks, keys, screenshots, requests."""

from __future__ import annotations

import base64
import importlib
import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

PROGRAM = next(
    filter(None, map(shutil.which, ('chromium', 'chromium-browser', 'google-chrome'))), ''
)
# Only what hangs is ended by it: a busy machine may need a minute for a command.
_LIMIT_S = 240
# WebGL in software; nothing that Chromium does by itself goes to the network.
_OPTIONS = [
    '--headless=new', '--no-sandbox', '--remote-debugging-port=0', '--hide-scrollbars',
    '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--disable-background-networking',
    '--disable-component-update', '--no-first-run', '--disable-sync',
]  # fmt: skip


class Tab:
    """One tab.

    Attributes
    ----------
    requests : list of str
        Addresses that its page and the frames within have asked for.
    errors : list of str
        What the page's scripts have complained about.

    """

    def __init__(self, connection: Any) -> None:
        self._connection, self._last = connection, 0
        self._session: dict[str, str] = {}
        self.requests: list[str] = []
        self.errors: list[str] = []
        target = self.do('Target.createTarget', url='about:blank', newWindow=True)['targetId']
        session = self.do('Target.attachToTarget', targetId=target, flatten=True)['sessionId']
        self._session = {'sessionId': session}
        for domain in ('Page', 'Runtime', 'Network', 'Log'):
            self.do(f'{domain}.enable')
        self.do('Emulation.setFocusEmulationEnabled', enabled=True)

    def do(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and return its result."""
        self._send(method, **parameters)
        while True:
            message = json.loads(self._connection.recv(timeout=_LIMIT_S))
            if message.get('id') == self._last:
                assert 'error' not in message, message
                result: dict[str, Any] = message['result']
                return result
            self._note(message)

    def _send(self, method: str, **parameters: Any) -> None:
        self._last += 1
        command = {'id': self._last, 'method': method, 'params': parameters, **self._session}
        self._connection.send(json.dumps(command))

    def front(self) -> None:
        """Bring the tab to the front: one behind another may draw nothing and get no wheel."""
        self.do('Page.bringToFront')

    def _note(self, message: dict[str, Any]) -> None:
        what, facts = message.get('method'), message.get('params', {})
        if what == 'Network.requestWillBeSent':
            self.requests.append(facts['request']['url'])
        elif what == 'Network.webSocketCreated':
            self.requests.append(facts['url'])
        elif what == 'Runtime.exceptionThrown':
            self.errors.append(json.dumps(facts['exceptionDetails']))
        elif what == 'Log.entryAdded' and facts['entry']['level'] == 'error':
            self.errors.append(facts['entry']['text'])

    def open(self, address: str, size: tuple[int, int] = (1500, 640), scale: float = 1.0) -> None:
        """Open an address in a tab of ``size`` CSS px, of ``scale`` pixels of the screen each."""
        self.do(
            'Emulation.setDeviceMetricsOverride', width=size[0], height=size[1],
            deviceScaleFactor=scale, mobile=False,
        )  # fmt: skip
        self.do('Page.navigate', url=address)

    def value(self, script: str) -> Any:
        """Return the value of an expression in the page."""
        found = self.do('Runtime.evaluate', expression=script, returnByValue=True)
        assert 'exceptionDetails' not in found, found
        return found['result'].get('value')

    def wait_for(self, script: str) -> Any:
        """Wait until an expression in the page is true, and return it."""
        end = time.monotonic() + _LIMIT_S
        while time.monotonic() < end:
            if found := self.value(f'(() => {{ try {{ return {script} }} catch {{}} }})()'):
                return found
            time.sleep(0.05)
        text = self.value('document.body.innerText')
        raise AssertionError(f'{script} has not become true; the page shows {text}')

    def click(self, x: float, y: float) -> None:
        """Move the mouse there and click with its left button."""
        self.do('Input.dispatchMouseEvent', type='mouseMoved', x=x, y=y)
        for what in ('mousePressed', 'mouseReleased'):
            self.do(
                'Input.dispatchMouseEvent', type=what, x=x, y=y, button='left', clickCount=1,
                buttons=1 if what == 'mousePressed' else 0,
            )  # fmt: skip

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag with the left button."""
        steps = [(start, 'mousePressed', 1)]
        for i in range(1, 6):
            at = tuple(a + (b - a) * i / 5 for a, b in zip(start, end, strict=True))
            steps.append(((at[0], at[1]), 'mouseMoved', 1))
        steps.append((end, 'mouseReleased', 0))
        for (x, y), what, buttons in steps:
            self.do(
                'Input.dispatchMouseEvent', type=what, x=x, y=y, button='left', buttons=buttons,
                clickCount=int(what != 'mouseMoved'),
            )  # fmt: skip

    def wheel(self, x: float, y: float, amount: float) -> None:
        """Turn the wheel; a negative amount moves away from the person.

        Chromium answers when the scrolling that the page prevents has come to an end, which may
        be never: what counts is that the page has got the event.
        """
        self.value(
            'window.wheels ??= (addEventListener("wheel", () => { window.wheels += 1; },'
            ' {capture: true, passive: true}), 0)'
        )
        before = self.value('window.wheels')
        self._send(
            'Input.dispatchMouseEvent', type='mouseWheel', x=x, y=y, deltaX=0, deltaY=amount
        )
        self.wait_for(f'window.wheels > {before}')

    def press(self, key: str, *, control: bool = False) -> None:
        """Press a key."""
        text = '\r' if key == 'Enter' else key if len(key) == 1 and not control else ''
        code = {'Enter': 13, 'Escape': 27}.get(key, ord(key[0].upper()))
        for what in ('keyDown', 'keyUp'):
            self.do(
                'Input.dispatchKeyEvent', type=what, key=key, modifiers=2 if control else 0,
                text=text if what == 'keyDown' else '', windowsVirtualKeyCode=code,
            )  # fmt: skip

    def type(self, text: str) -> None:
        """Type a text where the focus is, in place of what is selected."""
        self.do('Input.insertText', text=text)

    def screenshot(self) -> bytes:
        """Return what the tab shows, PNG."""
        return base64.b64decode(self.do('Page.captureScreenshot', format='png')['data'])


@contextmanager
def chromium(tabs: int = 1) -> Iterator[list[Tab]]:
    """Start a Chromium with some tabs, and end it.

    Each tab has a connection of its own, which begins with its session.
    """
    client = importlib.import_module('websockets.sync.client')  # beside viser
    with TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        words = [PROGRAM, *_OPTIONS, f'--user-data-dir={profile}', 'about:blank']
        browser = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        connections: list[Any] = []
        try:
            place = Path(profile, 'DevToolsActivePort')
            end = time.monotonic() + _LIMIT_S
            while not (place.exists() and len(place.read_text().split()) == 2):
                assert browser.poll() is None, 'Chromium has ended'
                assert time.monotonic() < end, 'Chromium has not started'
                time.sleep(0.05)
            port, path = place.read_text().split()
            found = []
            for _ in range(tabs):
                connection = client.connect(f'ws://127.0.0.1:{port}{path}', max_size=None)
                connections.append(connection)
                found.append(Tab(connection))
            yield found
        finally:
            for connection in connections:
                connection.close()
            browser.terminate()
            browser.wait(timeout=_LIMIT_S)
