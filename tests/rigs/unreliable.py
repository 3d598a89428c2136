"""An executor that loses some of its work, as workers that are killed do."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from typing import Any


class Unreliable(Executor):
    """Loses some of what it is given."""

    def __init__(self, losses: int) -> None:
        self.losses, self.attempts = losses, 0

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.attempts += 1
        future: Future[Any] = Future()
        if self.attempts <= self.losses:
            future.set_exception(OSError("worker lost"))
        else:
            future.set_result(fn(*args, **kwargs))
        return future
