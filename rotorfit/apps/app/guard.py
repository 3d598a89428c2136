"""What the server refuses: other hosts and origins, tokens of sockets that are none, script that is not its own."""

from __future__ import annotations

import secrets
from collections.abc import Collection
from http import HTTPStatus
from time import time
from typing import Any
from urllib.parse import urlsplit

from bokeh.server.views.doc_handler import DocHandler
from bokeh.util.token import get_token_payload
from tornado.web import Application, HTTPError

_POLICY = (
    "default-src 'none'; script-src 'self' 'nonce-{nonce}'; style-src 'self' 'unsafe-inline'; img-src 'self' data: "
    "blob:; font-src 'self' data:; connect-src 'self' {sockets}; frame-src 'self'; base-uri 'none'; form-action "
    "'none'; frame-ancestors 'none'"
)
"""Content-Security-Policy: script is run from files of the server and where its own page begins with it, not from
whatever text comes to stand on that page. Bokeh and Panel set styles in the page."""


class Guarded:
    """What stands before a handler of requests."""

    hosts: Collection[str]  # names of this server with its port
    nonce: str  # by which the answer knows its own script
    request: Any
    set_header: Any

    async def prepare(self) -> None:
        """Refuse, or go on."""
        origin = self.request.headers.get("Origin")
        asks_for_socket = self.request.headers.get("Upgrade", "").lower() == "websocket"
        if self.request.host.lower() not in self.hosts:
            raise HTTPError(HTTPStatus.FORBIDDEN, "asked for by the name of another host")
        if (origin is None and asks_for_socket) or (origin is not None and urlsplit(origin).netloc not in self.hosts):
            raise HTTPError(HTTPStatus.FORBIDDEN, "asked for by a page of another origin")
        if asks_for_socket and not _is_token(self.request.headers.get("Sec-WebSocket-Protocol", "")):
            raise HTTPError(HTTPStatus.BAD_REQUEST, "the token of the socket is none that a page was given")
        if (more := super().prepare()) is not None:  # type: ignore[misc]
            await more

    def set_default_headers(self) -> None:
        """Headers of every answer."""
        super().set_default_headers()  # type: ignore[misc]
        self.nonce = secrets.token_urlsafe(16)
        sockets = " ".join(f"ws://{host}" for host in self.hosts)
        self.set_header("Content-Security-Policy", _POLICY.format(nonce=self.nonce, sockets=sockets))
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("X-Content-Type-Options", "nosniff")

    def write(self, chunk: Any) -> None:
        """Mark script of the page as its own: all that it begins with is Bokeh's and Panel's."""
        if isinstance(self, DocHandler):
            chunk = chunk.replace("<script", f'<script nonce="{self.nonce}"')
        super().write(chunk)  # type: ignore[misc]


def guard(application: Application, hosts: Collection[str]) -> None:
    """Have every request looked at before it is answered."""
    for rule in application.wildcard_router.rules:
        rule.target = type(rule.target.__name__, (Guarded, rule.target), {"hosts": hosts})


def _is_token(protocols: str) -> bool:
    """True if a socket names Bokeh's protocol and a token that opens a session, which is not over."""
    protocol, _, token = protocols.partition(",")
    try:
        return protocol == "bokeh" and float(get_token_payload(token.strip())["session_expiry"]) > time()
    except Exception:  # Bokeh's reader says in a dozen ways that bytes are none
        return False
