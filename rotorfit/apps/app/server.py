"""The server: this machine alone, one address with a random token, a page of its own for every tab."""

from __future__ import annotations

import secrets
import socket
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rotorfit.apps.app.folder import folder_of

LOOPBACK = "127.0.0.1"
"""Address that other machines do not reach."""


def serve(files: Sequence[Path], *, port: int = 0, on_ready: Callable[[str], None]) -> None:
    """Serve the front until interrupted; the folder that holds the files is all that is read from and written to.
    ``on_ready`` is called with the address, at that port or, where it is 0, at any that is free.
    """
    folder, names = folder_of(files)
    try:
        import bokeh.util.warnings
        import panel as pn
        import tomli_w  # noqa: F401 - fails here, not when a study is to be downloaded
    except ImportError as reason:
        raise ValueError('the front in a browser needs panel: pip install "rotorfit[app]"') from reason

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
    server = pn.serve(
        {f"/{token}": lambda: page(folder, names)},
        address=LOOPBACK,
        port=port,
        websocket_origin=[f"{LOOPBACK}:{port}", f"localhost:{port}"],
        title="rotorfit",
        show=False,
        start=False,
        verbose=False,
        use_index=False,  # which would give the token away
        redirect_root=False,
    )
    server.io_loop.asyncio_loop.set_exception_handler(_but_closed_tabs)
    server.start()
    on_ready(f"http://{LOOPBACK}:{port}/{token}")
    server.io_loop.start()


def _but_closed_tabs(loop: Any, context: dict[str, Any]) -> None:
    """Report what went wrong in the server, but not that a tab was closed while something was sent to it."""
    from tornado.iostream import StreamClosedError
    from tornado.websocket import WebSocketClosedError

    if not isinstance(context.get("exception"), StreamClosedError | WebSocketClosedError):
        loop.default_exception_handler(context)
