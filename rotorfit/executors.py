"""The same work on many items over any ``concurrent.futures`` executor; what a lost worker had is done again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, as_completed
from typing import TypeVar

Item = TypeVar("Item")
T = TypeVar("T")


def carry_out(
    work: Callable[[Item], T], items: Sequence[Item], executor: Executor | None, done: Callable[[Item], None]
) -> list[T]:
    """``work(item)`` for every item, in their order. An item whose worker was lost is sent again, and worked on here in
    the end: none is lost. What the work itself raises is raised when it is done here."""
    results: dict[int, T] = {}
    left = list(range(len(items)))
    for _ in range(0 if executor is None else 3):  # an item is sent again twice before it is worked on here
        left = _round(work, items, left, executor, results, done)
        if not left:
            break
    for number in left:
        results[number] = work(items[number])
        done(items[number])
    return [results[number] for number in range(len(items))]


def _round(
    work: Callable[[Item], T],
    items: Sequence[Item],
    numbers: Sequence[int],
    executor: Executor | None,
    results: dict[int, T],
    done: Callable[[Item], None],
) -> list[int]:
    """Send items; returns those that came to nothing."""
    waiting: dict[Future[T], int] = {}
    lost: list[int] = []
    for number in numbers:
        try:
            waiting[executor.submit(work, items[number])] = number  # type: ignore[union-attr]
        except RuntimeError:  # an executor that lost its workers, or was shut down, takes nothing more
            lost.append(number)
    for future in as_completed(waiting):
        number = waiting[future]
        if future.cancelled() or future.exception() is not None:
            lost.append(number)
            continue
        results[number] = future.result()
        done(items[number])
    return sorted(lost)
