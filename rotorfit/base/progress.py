"""How far long work is, on one line of a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias

Progress: TypeAlias = bool | Callable[..., None] | None
"""Whether a line is shown, or what is called instead; ``None`` shows it on a terminal."""


@contextmanager
def progress_on_stderr(progress: Progress, words: Callable[..., str]) -> Iterator[Callable[..., None] | None]:
    """What work tells its state: a function that was given, or a line of ``words`` of that state, which ends with the
    work; ``None`` if nobody asks."""
    if callable(progress):
        yield progress
        return
    if not (sys.stderr.isatty() if progress is None else progress):
        yield None
        return
    begun = False

    def show(*state: Any) -> None:
        nonlocal begun
        begun = True
        print(f"\r{words(*state):<60}", end="", file=sys.stderr, flush=True)

    try:
        yield show
    finally:
        if begun:
            print(file=sys.stderr)
