"""The command line as a process of its own: the script ``rotorfit`` and ``python -m rotorfit``."""

from __future__ import annotations

import gc
import io
import os
import sys
from typing import TextIO

from rotorfit.base.file_reading import shown_lines

_ERASE = "\r\033[K"
"""Erases a line, as a line of progress does."""


class _PlainStream(io.TextIOWrapper):
    """Output in which names from files cannot steer the terminal, and what it has no letter for is escaped."""

    def write(self, text: str, /) -> int:
        return super().write(_ERASE.join(map(shown_lines, text.split(_ERASE))))


def _plain(stream: TextIO | None, closed: int) -> TextIO:
    """An output of this process made plain; one that was closed is nothing, to be read or to be written to."""
    if stream is None:
        return os.fdopen(os.open(os.devnull, closed), "w", encoding="utf-8")
    if not isinstance(stream, io.TextIOWrapper):
        return stream
    return _PlainStream(
        stream.buffer, encoding=stream.encoding, errors="backslashreplace", line_buffering=stream.line_buffering
    )


def main() -> int:
    """Run the command line of this process. Returns the exit code."""
    # New objects after which Python looks for unused ones, in place of 700. Nearly all that imports and drawing make
    # stays: looking through it again and again takes a tenth of a fit's time.
    gc.set_threshold(100_000)
    # What is printed must arrive somewhere, as in other programs; of errors and warnings there is the exit code.
    sys.stdout, sys.stderr = _plain(sys.stdout, os.O_RDONLY), _plain(sys.stderr, os.O_WRONLY)
    from rotorfit.apps.cli.main import main as run

    try:
        return run()
    finally:
        gc.freeze()  # the process ends: its memory goes as a whole, not object by object


if __name__ == "__main__":
    raise SystemExit(main())
