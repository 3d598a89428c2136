"""The same work on many items over any ``concurrent.futures`` executor; what a lost worker had is done again."""

from __future__ import annotations

import logging
import os
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import connection, get_context, parent_process
from typing import Any, Protocol, TypeVar

from rotorfit.base.version import VERSIONS

Item = TypeVar("Item")
T = TypeVar("T")

PATIENCE = 300.0
"""Seconds without any result after which workers count as lost: a cluster scaled to zero, a scheduler that is gone.
Well above what the longest piece of work takes. Chosen."""


class Kept(Protocol):
    """Where results are kept as they come, so that the same work takes up where it stopped: a store."""

    def find(self, keys: Sequence[str]) -> Mapping[str, bytes]:
        """Results that are kept, by their keys."""
        ...

    def keep(self, pieces: Mapping[str, bytes]) -> None:
        """Keep results by their keys."""
        ...


def carry_out(
    work: Callable[[Item], T],
    items: Sequence[Item],
    executor: Executor | None,
    done: Callable[[Item, T], None] = lambda item, result: None,
    *,
    patience: float = PATIENCE,
) -> list[T]:
    """``work(item)`` for every item, in their order. An item whose worker was lost is sent again, and worked on here in
    the end, as all are when no worker has answered for ``patience`` seconds: none is lost, and nothing is waited for
    without end. What the work itself raises is raised when it is done here."""
    results: dict[int, T] = {}
    left = list(range(len(items)))
    sent = _Sent(work, items, results, done, patience)
    attempts = 3  # times that an item is sent before it is worked on here. Chosen.
    for _ in range(0 if executor is None else attempts):
        left = sent.round(left, executor)  # type: ignore[arg-type]
        if not left or sent.stalled:
            break
    if left and executor is not None:
        warnings.warn(f"{len(left)} of {len(items)} pieces of work done here: {sent.reason}", stacklevel=2)
    for number in left:
        results[number] = work(items[number])
        done(items[number], results[number])
    return [results[number] for number in range(len(items))]


class _Sent:
    """Items on their way."""

    def __init__(
        self,
        work: Callable[[Any], Any],
        items: Sequence[Any],
        results: dict[int, Any],
        done: Callable[[Any, Any], None],
        patience: float,
    ) -> None:
        self.work, self.items, self.results, self.done, self.patience = work, items, results, done, patience
        self.stalled = False
        self.reason = ""

    def round(self, numbers: Sequence[int], executor: Executor) -> list[int]:
        """Send items, some at a time; returns those that came to nothing."""
        waiting: dict[Future[Any], int] = {}
        lost: list[int] = []
        left = iter(numbers)
        in_flight = 256  # items that are sent and not answered at a time, so that no machine holds all of them. Chosen.
        while not self.stalled:
            for number in left:
                self._send(number, executor, waiting, lost)
                if len(waiting) >= in_flight:
                    break
            if not waiting:
                break
            finished = self._answered(waiting, executor)
            self.stalled = not finished
            lost += [number for future in finished if not self._taken(future, number := waiting.pop(future))]
        if self.stalled and not _is_closed(executor):
            for future in waiting:
                future.cancel()
        return sorted([*lost, *waiting.values(), *left])

    def _answered(self, waiting: Mapping[Future[Any], int], executor: Executor) -> set[Future[Any]]:
        """What has come to an end, nothing where no answer is to be expected any more."""
        end = time.monotonic() + self.patience
        between_looks = 5.0  # seconds between looks at a cluster that does not answer. Chosen.
        while not _is_closed(executor) and (left := end - time.monotonic()) > 0:
            finished = wait(waiting, timeout=min(left, between_looks), return_when=FIRST_COMPLETED).done
            if finished:
                return finished
        closed = _is_closed(executor)
        self.reason = "the cluster was lost" if closed else f"no worker has answered for {self.patience:g} s"
        return set()

    def _send(self, number: int, executor: Executor, waiting: dict[Future[Any], int], lost: list[int]) -> None:
        try:
            waiting[executor.submit(self.work, self.items[number])] = number
        except Exception as problem:  # an executor that lost its workers, or was closed, takes nothing more
            self.reason = str(problem) or type(problem).__name__
            lost.append(number)

    def _taken(self, future: Future[Any], number: int) -> bool:
        """True if the result is there."""
        problem = None if future.cancelled() else future.exception()
        if future.cancelled() or problem is not None:
            self.reason = "it was cancelled" if problem is None else str(problem) or type(problem).__name__
            return False
        self.results[number] = future.result()
        self.done(self.items[number], self.results[number])
        return True


def _is_closed(executor: Executor) -> bool:
    """True for that of a Dask client which has given its scheduler up."""
    return getattr(getattr(executor, "_client", None), "status", "") == "closed"


# ---- where the work goes --------------------------------------------------------------------------------------------


@contextmanager
def process_pool(count: int) -> Iterator[Executor]:
    """An executor of processes on this machine, which end with the one that started them, however that ends."""
    with ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_end_with_parent) as pool:
        yield pool


def _end_with_parent() -> None:
    """End this process as soon as the one that started it has ended: it may have been killed and say nothing."""
    parent = parent_process()
    if parent is not None:
        ended = threading.Thread(target=lambda: (connection.wait([parent.sentinel]), os._exit(1)), daemon=True)
        ended.start()


@contextmanager
def cluster(address: str) -> Iterator[Executor | None]:
    """An executor of a Dask cluster: ``local:8`` starts eight processes here, ``tcp://host:8786`` is a scheduler's.

    Raises:
        ValueError: another address, no Dask, or workers with another version of rotorfit.
        OSError: no scheduler answers there.
    """
    kind, _, rest = address.partition(":")
    if kind not in ("local", "tcp", "tls", "ucx", "ws", "wss") or (kind == "local" and not rest.isdecimal()):
        raise ValueError(f"--cluster takes local:N or the address of a scheduler, tcp://host:8786; got {address!r}")
    if kind == "local" and not int(rest):
        raise ValueError("--cluster local:N takes a number of processes from 1")
    try:
        from distributed import Client, LocalCluster
    except ImportError as reason:
        raise ValueError('a cluster needs Dask: pip install "rotorfit[cluster]"') from reason
    if kind == "local":
        pages = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}  # of the scheduler: for this machine alone
        quiet = {"scheduler_kwargs": pages, "silence_logs": logging.CRITICAL}
        with LocalCluster(n_workers=int(rest), threads_per_worker=1, **quiet) as workers, Client(workers) as client:
            yield client.get_executor(pure=False)
        return
    time_to_connect = 15.0  # seconds that a scheduler may take to answer. Chosen.
    try:
        found = Client(address, timeout=time_to_connect)
    except OSError as problem:
        raise OSError(f"no Dask scheduler answers at {address}: {problem}") from problem
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # what is lost is said where it is done again
    with found as client:
        _check_versions(client, address)
        yield client.get_executor(pure=False)


def _check_versions(client: Any, address: str) -> None:
    """Refuse workers that would compute something else."""
    try:
        there = client.run(version_here)
    except Exception as problem:
        raise ValueError(f"the workers at {address} cannot run rotorfit: {problem}; install it there") from problem
    odd = sorted({version for version in there.values() if version != VERSIONS})
    if odd:
        raise ValueError(f"workers at {address} have rotorfit {', '.join(odd)}, here is {VERSIONS}; install the same")


def version_here() -> str:
    """Version of rotorfit where this runs."""
    return VERSIONS
