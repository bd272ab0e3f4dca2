# SPDX-License-Identifier: Apache-2.0
"""Who may talk to the server of a page: programs of this machine that know its address.

Any web page that is open in a browser can send requests to 127.0.0.1, and a name of its own may
be made to lead there (DNS rebinding). Three checks keep such pages out: the host that a request
is addressed to, the page that it comes from, and a token in the path that only the address holds.
"""

from __future__ import annotations

import secrets
from collections.abc import Mapping

_HOSTS = {'127.0.0.1', 'localhost'}
_OURS = (
    "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none';"
    " form-action 'none'"
)
# viser's client runs scripts from within its page, in workers, in WebAssembly and from text.
_OF_VISER = (
    "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:;"
    " style-src 'self' 'unsafe-inline'; worker-src blob:; frame-ancestors 'self';"
    " base-uri 'none'; form-action 'none'"
)
_HEADERS = {
    'Cache-Control': 'no-store',
    'Cross-Origin-Resource-Policy': 'same-origin',
    'Referrer-Policy': 'no-referrer',
    'X-Content-Type-Options': 'nosniff',
}


class Guard:
    """Tells which requests are let in.

    Attributes
    ----------
    root : str
        First part of every path that is let in, ``/token/``.

    """

    def __init__(self) -> None:
        self.root = f'/{secrets.token_urlsafe(16)}/'

    def path(self, target: str, headers: Mapping[str, str]) -> str | None:
        """Return the path of a request behind the token, without its query.

        None if it is not let in. A program that is no browser names no origin.
        """
        host = headers.get('Host', '')
        if host.partition(':')[0] not in _HOSTS:
            return None
        if headers.get('Origin', f'http://{host}') != f'http://{host}':
            return None
        path = target.partition('?')[0]
        if not secrets.compare_digest(path[: len(self.root)].encode(), self.root.encode()):
            return None
        return path[len(self.root) :]


def safe_headers(*, of_viser: bool = False) -> dict[str, str]:
    """Return the headers that keep a page to this server, whatever its scripts try."""
    return {**_HEADERS, 'Content-Security-Policy': _OF_VISER if of_viser else _OURS}
