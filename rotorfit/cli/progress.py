"""Progress of long work on the terminal."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic

from rotorfit.estimators.file_reading import shown


class ProgressLine:
    """One line on stderr: seconds since the start, stage at work, and a bar and the time left where these are known."""

    def __init__(self, *, enabled: bool) -> None:
        self._begin, self._enabled = monotonic(), enabled
        self._since, self._share = self._begin, 0.0  # when the stage with a bar began, and how far it was last

    def __call__(self, stage: str, done: float | None = None) -> None:
        """Show a stage."""
        if self._enabled:
            seconds = monotonic() - self._begin
            bar = "" if done is None else f"[{'#' * round(24 * done):<24}] {100 * done:3.0f} %  "
            left = "" if done is None else self._left(done)
            print(f"\r\033[K{seconds:5.1f} s  {bar}{shown(stage)} ...{left}", end="", file=sys.stderr, flush=True)

    def _left(self, done: float) -> str:
        """Time left, once it can be estimated from the work done."""
        if done < self._share or done == 0:  # another stage has begun
            self._since = monotonic()
        self._share = done
        spent = monotonic() - self._since
        if spent < 2.0 or not 0 < done < 1:  # in the first two seconds no estimate of the time left is worth much
            return ""
        seconds = spent * (1 - done) / done
        return f" about {seconds:.0f} s left" if seconds < 99 else f" about {seconds / 60:.0f} min left"

    def close(self) -> None:
        """Clear the line."""
        if self._enabled:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


@contextmanager
def progress_line(options: argparse.Namespace) -> Iterator[ProgressLine]:
    """The line of a command, which ends with the block; --quiet leaves it out."""
    line = ProgressLine(enabled=not getattr(options, "quiet", False) and sys.stderr.isatty())
    try:
        yield line
    finally:
        line.close()
