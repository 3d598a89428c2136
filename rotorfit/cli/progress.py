"""What long work shows while it runs."""

from __future__ import annotations

import sys
from time import monotonic

_BAR = 24  # characters of the bar of progress


class ProgressLine:
    """One line on stderr: the stage at work, a bar where it is known how far it is, the seconds since the start."""

    def __init__(self, *, enabled: bool) -> None:
        self._begin, self._enabled = monotonic(), enabled

    def __call__(self, stage: str, done: float | None = None) -> None:
        """Show a stage."""
        if self._enabled:
            seconds = monotonic() - self._begin
            bar = "" if done is None else f"[{'#' * round(_BAR * done):<{_BAR}}] {100 * done:3.0f} %  "
            print(f"\r\033[K{seconds:5.1f} s  {bar}{stage} ...", end="", file=sys.stderr, flush=True)

    def close(self) -> None:
        """Clear the line."""
        if self._enabled:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
