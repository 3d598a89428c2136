"""The server: this machine alone, one address with a random token, a page of its own for every tab."""

from __future__ import annotations

import secrets
import socket
from collections.abc import Callable, Sequence
from pathlib import Path

from rotorfit.app.folder import folder_of

LOOPBACK = "127.0.0.1"
"""Address that other machines do not reach."""


def serve(files: Sequence[Path], *, port: int = 0, on_ready: Callable[[str], None]) -> None:
    """Serve the front until interrupted.

    Args:
        files: what is opened; the folder that holds them is all that the server reads from and writes to.
        port: of the server; 0: any that is free.
        on_ready: called with the address.
    """
    folder, names = folder_of(files)
    try:
        import panel as pn
        import tomli_w  # noqa: F401 - fails here, not when a study is to be downloaded
    except ImportError as reason:
        raise ValueError('the front in a browser needs panel: pip install "rotorfit[app]"') from reason

    from rotorfit.app.page import page

    pn.extension(notifications=False)
    pn.config.nthreads = 4  # what one tab waits for does not hold up another
    token = secrets.token_urlsafe(24)
    port = port or _free_port()
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
    server.start()
    on_ready(f"http://{LOOPBACK}:{port}/{token}")
    server.io_loop.start()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])
