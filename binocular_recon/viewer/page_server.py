# SPDX-License-Identifier: Apache-2.0
"""One port of this machine that serves the page, its messages, and viser's client and cloud."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import io
import json
import logging
import socket
from collections.abc import Awaitable, Callable, Iterator
from http import HTTPStatus
from importlib import resources
from typing import Any

import cv2

from binocular_recon.errors import BinocularReconError, ConfigError, DependencyError
from binocular_recon.machine import optional_package
from binocular_recon.viewer.actions import answer, state_of
from binocular_recon.viewer.guard import Guard, safe_headers
from binocular_recon.viewer.scene import Scene
from binocular_recon.viewer.shared_view import SharedView

HOST = '127.0.0.1'
# Files of the page by their paths; nothing else of the disk is served.
_FILES = {
    '': ('index.html', 'text/html; charset=utf-8'),
    'page.css': ('page.css', 'text/css; charset=utf-8'),
    'page.js': ('page.js', 'text/javascript; charset=utf-8'),
    'image_pane.js': ('image_pane.js', 'text/javascript; charset=utf-8'),
}
_PURPOSE = 'pages to look and click'
_SESSION, _CLOUD = 'session', 'cloud'
_IMAGES = 'left.png', 'right.png'
_Handler = Callable[[Any], Awaitable[None]]


class PageServer:
    """Serves a view to browsers of this machine, until it is closed.

    Parameters
    ----------
    view : SharedView
    port : int
        0 = any that is free.

    Attributes
    ----------
    address : str
        What to open in a browser. It holds a token, without which nothing is served.
    view : SharedView
    scene : Scene

    Raises
    ------
    DependencyError
        If viser is not installed, or too old or new to be guarded.
    ConfigError
        If the port is in use.

    """

    def __init__(self, view: SharedView, port: int = 0) -> None:
        viser = optional_package('viser', _PURPOSE)
        self._websockets = optional_package('websockets', _PURPOSE)  # viser has loaded its parts
        self.view, self._guard = view, Guard()
        self._pages: set[Any] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        with _bound(port) as bound:
            self.address = f'http://{HOST}:{bound.getsockname()[1]}{self._guard.root}'
            # it prints an address that does not work
            quiet = contextlib.redirect_stdout(io.StringIO())
            with self._in_place_of_its_own_server(bound) as guarded, quiet:
                self._viser = viser.ViserServer(HOST, 0, verbose=False)
                if not guarded:
                    self._viser.stop()
                    raise DependencyError('this viser cannot be guarded; install viser 1.1')
        # it would carry the cloud to a server of others
        self._viser.request_share_url = lambda *_, **__: None
        self.scene = Scene(self._viser, view, lambda text: self._send({'problem': text}))
        view.listeners += [self.scene.update, self._send_state]

    def close(self) -> None:
        """End the server; browsers say so."""
        for listener in (self.scene.update, self._send_state):
            self.view.listeners.remove(listener)
        with contextlib.redirect_stdout(io.StringIO()):
            self._viser.stop()

    @contextlib.contextmanager
    def _in_place_of_its_own_server(self, bound: socket.socket) -> Iterator[list[bool]]:
        """Let viser start on our socket, behind our guard and beside our page.

        viser takes connections of every web page and has no setting against that. Yields a list
        that is empty until it has started so.
        """
        server = self._websockets.asyncio.server
        plain = server.serve
        guarded: list[bool] = []

        @functools.wraps(plain)
        def serve(handler: _Handler, *_: object, process_request: Any, **options: Any) -> Any:
            guarded.append(True)
            log = logging.getLogger(__name__)
            log.setLevel(logging.CRITICAL)  # what others send us is not our fault
            return plain(
                functools.partial(self._connected, handler),
                sock=bound.dup(),
                process_request=functools.partial(self._requested, process_request),
                logger=log,
                **options,
            )

        server.serve = serve
        try:
            yield guarded
        finally:
            server.serve = plain

    async def _requested(self, of_viser: Callable[..., Any], connection: Any, request: Any) -> Any:
        """Return the answer to a request, or None for a connection that is to stay."""
        path = self._guard.path(request.path, request.headers)
        if path is None:
            return self._response(
                HTTPStatus.FORBIDDEN, b'open the address that view has printed\n'
            )
        if request.headers.get('Upgrade', '').lower() == 'websocket':
            if path in (_SESSION, _CLOUD):
                return None
        elif path == f'{_CLOUD}/':
            request.path = '/'
            page = of_viser(connection, request)
            for name, value in safe_headers(of_viser=True).items():
                page.headers[name] = value
            return page
        elif path in _IMAGES:
            image = await asyncio.to_thread(self._image, path)
            if image is not None:
                return self._response(HTTPStatus.OK, image, 'image/png')
        elif path in _FILES:
            name, kind = _FILES[path]
            return self._response(HTTPStatus.OK, _page_file(name), kind)
        return self._response(HTTPStatus.NOT_FOUND, b'there is nothing here\n')

    def _response(self, status: HTTPStatus, body: bytes, kind: str = 'text/plain') -> Any:
        fields = {'Content-Type': kind, 'Content-Length': str(len(body)), 'Connection': 'close'}
        headers = self._websockets.datastructures.Headers({**fields, **safe_headers()})
        return self._websockets.http11.Response(status, status.phrase, headers, body)

    async def _connected(self, of_viser: _Handler, connection: Any) -> None:
        if not connection.request.path.startswith(f'{self._guard.root}{_SESSION}'):
            await of_viser(connection)
            return
        self._loop = asyncio.get_running_loop()
        self._pages.add(connection)
        try:
            await connection.send(await asyncio.to_thread(state_of, self.view))
            async for message in connection:
                await connection.send(await asyncio.to_thread(answer, self.view, message))
        finally:
            self._pages.discard(connection)

    def _image(self, path: str) -> bytes | None:
        view = self.view
        image = view.displayed.image
        if path == _IMAGES[1]:
            try:
                image = view.folder.right_bgr(view.shown.frame)
            except BinocularReconError:  # it was not kept, or is gone
                return None
        options = [cv2.IMWRITE_PNG_COMPRESSION, 1]
        return bytes(cv2.imencode('.png', image, options)[1])

    def _send_state(self) -> None:
        self._send_text(state_of(self.view))

    def _send(self, content: dict[str, str]) -> None:
        self._send_text(json.dumps(content))

    def _send_text(self, text: str) -> None:
        """Send a message to all pages; from any thread."""
        if self._loop is not None:
            broadcast = self._websockets.asyncio.server.broadcast
            self._loop.call_soon_threadsafe(lambda: broadcast(self._pages, text))


@contextlib.contextmanager
def _bound(port: int) -> Iterator[socket.socket]:
    with socket.socket() as bound:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            bound.bind((HOST, port))
        except (OSError, OverflowError) as error:
            raise ConfigError(
                f'port {port} cannot be used: {getattr(error, "strerror", None) or error}; choose'
                ' another, or leave --port out'
            ) from error
        yield bound


def _page_file(name: str) -> bytes:
    return (resources.files('binocular_recon.viewer') / 'page' / name).read_bytes()
