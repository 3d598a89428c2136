"""The server: this machine alone, one address with a random token, a page of its own for every tab."""

from __future__ import annotations

import os
import secrets
import socket
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rotorfit.apps.app.folder import folder_of
from rotorfit.base.atomic_file import reading_only_within
from rotorfit.show.report.html import element

LOOPBACK = "127.0.0.1"
"""Address that other machines do not reach."""


def serve(files: Sequence[Path], *, port: int = 0, on_ready: Callable[[str], None]) -> None:
    """Serve the front until interrupted; the folder that holds the files is all that is read from and written to.
    ``on_ready`` is called with the address, at that port or, where it is 0, at any that is free.
    """
    largest_port = 65535
    if not 0 <= port <= largest_port:
        raise ValueError(f"--port {port}: ports are 1 to {largest_port}, and 0 is any that is free")
    folder, names = folder_of(files)
    try:
        import bokeh.util.warnings
        import panel as pn
        import tomli_w  # noqa: F401 - fails here, not when a study is to be downloaded
    except ImportError as reason:
        raise ValueError('the front in a browser needs panel: pip install "rotorfit[app]"') from reason

    from rotorfit.apps.app.guard import guard
    from rotorfit.apps.app.page import page

    repeated = "reference already known"  # a click that names a button by all that it is, understood all the same
    warnings.filterwarnings("ignore", repeated, bokeh.util.warnings.BokehUserWarning)
    pn.extension(notifications=False)
    pn.config.nthreads = 4  # what one tab waits for does not hold up another
    token = secrets.token_urlsafe(24)
    if not port:
        with socket.socket() as probe:
            probe.bind((LOOPBACK, 0))
            port = int(probe.getsockname()[1])
    hosts = [f"{LOOPBACK}:{port}", f"localhost:{port}"]
    server = pn.serve(
        {f"/{token}": lambda: page(folder, names)},
        address=LOOPBACK,
        port=port,
        websocket_origin=hosts,
        title="rotorfit",
        show=False,
        start=False,
        verbose=False,
        use_index=False,  # which would give the token away
        redirect_root=False,
    )
    guard(server._tornado, hosts)
    server.io_loop.asyncio_loop.set_exception_handler(_but_closed_tabs)
    with reading_only_within(folder.root):
        server.start()
        on_ready(f"http://{LOOPBACK}:{port}/{token}")
        server.io_loop.start()


@contextmanager
def way_to(address: str) -> Iterator[str]:
    """Address of a file, which only its owner may read, that leads to another address: all users of a machine see what
    a browser is started with. The file is gone when the block ends."""
    with TemporaryDirectory(prefix="rotorfit-") as folder:  # nobody else's, and of the mode 0700
        file = Path(folder) / "open.html"
        with open(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as stream:
            to = element("meta", http_equiv="refresh", content=f"0; url={address}")
            stream.write(f'<!doctype html><meta charset="utf-8">{to}{element("a", address, href=address)}')
        yield file.as_uri()


def _but_closed_tabs(loop: Any, context: dict[str, Any]) -> None:
    """Report what went wrong in the server, but not that a tab was closed while something was sent to it."""
    from tornado.iostream import StreamClosedError
    from tornado.websocket import WebSocketClosedError

    if not isinstance(context.get("exception"), StreamClosedError | WebSocketClosedError):
        loop.default_exception_handler(context)
