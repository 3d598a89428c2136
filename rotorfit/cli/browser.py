"""``rotorfit open``: look at data, fit and judge in a browser."""

from __future__ import annotations

import argparse
import webbrowser

from rotorfit.cli.answer import ExitCode, checked
from rotorfit.cli.arguments import add_paths, option

HELP = "view, fit and judge tests and recordings in a browser, on this machine only"


def add_options(to: argparse.ArgumentParser) -> None:
    """Options of ``rotorfit open``."""
    words = "test files and recordings, or a folder of them [this folder]; nothing outside their folder is touched"
    add_paths(to, words, "*")
    option(to, "--port N", "port of the server [any free one]", int, default=0)
    option(to, "--no-browser", "print the address and start no browser")


def run(options: argparse.Namespace) -> int:
    """Serve until interrupted; returns the exit code."""
    from rotorfit.app.server import serve

    def tell(address: str) -> None:
        print(f"rotorfit is at {address}\nCtrl-C ends it", flush=True)
        if not options.no_browser:
            webbrowser.open(address)

    checked(lambda: serve(options.files, port=options.port, on_ready=tell))
    return ExitCode.DONE
