"""Campaigns on a local Dask cluster: speed-up, overhead a run, memory, and what killing workers does.

Runs of one machine with a pressure of their own, each of so many lines, in files of a hundred that are read where they
are fitted: by a plain loop, over 1, 2 and 4 worker processes, with fits kept in a store, and with a worker killed every
few seconds. Memory is the largest resident size that was seen of the process that sends the runs and of any other. Of
more workers there is arithmetic: a run costs its fit, on a worker, and its overhead, in the process that sends it.

    python benchmarks/cluster.py [--runs 5000] [--lines 400] [--kill-every 10]
"""

from __future__ import annotations

import argparse
import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import campaign_throughput
from reporting import environment, table

import rotorfit as rf
from rotorfit.executors import cluster

KNOWN = campaign_throughput.KNOWN
FITTED = campaign_throughput.FITTED
SIMULATED = 64
"""Workers whose speed-up is worked out."""
RUNS_OF_A_PART = 100
"""Runs in a file."""


@dataclass(frozen=True)
class Row:
    """One way to fit all runs."""

    name: str
    seconds: float
    sender: float  # processor time of the process that sends the runs, s
    megabytes: tuple[float, float]  # of the process that sends, and of the largest other
    same: bool  # every digit that of the plain loop


class Memory(threading.Thread):
    """Watches the largest resident sizes of this process and of those it has started."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.own, self.other, self.ended = 0.0, 0.0, threading.Event()
        self.seconds = 0.0  # processor time of watching, s

    def run(self) -> None:
        """Look once a second."""
        while not self.ended.wait(1.0):
            self.own = max(self.own, _resident(os.getpid()))
            self.other = max([self.other, *map(_resident, _children())])
            self.seconds = time.thread_time()


def _children() -> list[int]:
    """All processes that come from this one."""
    parents: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                parents[int(entry.name)] = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except (FileNotFoundError, ProcessLookupError):
                continue
    found, new = [], {os.getpid()}
    while new:
        new = {number for number, parent in parents.items() if parent in new}
        found += list(new)
    return found


def _resident(number: int) -> float:
    """Resident size in MB, 0 of a process that has ended."""
    try:
        text = Path(f"/proc/{number}/status").read_text(encoding="utf-8")
    except (FileNotFoundError, ProcessLookupError):
        return 0.0
    return next((float(line.split()[1]) / 1024 for line in text.splitlines() if line.startswith("VmRSS")), 0.0)


@contextmanager
def killing(executor: Any, every: float | None) -> Iterator[list[int]]:
    """Kill one worker of a local cluster every so many seconds; gives the processes killed."""
    killed: list[int] = []
    ended = threading.Event()

    def work() -> None:
        while not ended.wait(every):
            pids = [worker.pid for worker in executor._client.cluster.workers.values() if worker.pid]
            if pids:
                killed.append(pids[len(killed) % len(pids)])
                os.kill(killed[-1], signal.SIGKILL)

    if every is not None:
        threading.Thread(target=work, daemon=True).start()
    try:
        yield killed
    finally:
        ended.set()


def measured(name: str, work: Callable[[], Any], reference: str | None = None) -> tuple[Row, str]:
    """Time, memory and agreement of one way."""
    memory = Memory()
    memory.start()
    begin, own = time.perf_counter(), time.process_time()
    found = work()
    seconds, sender = time.perf_counter() - begin, time.process_time() - own
    memory.ended.set()
    memory.join()
    sender -= memory.seconds
    text = found.to_csv()
    row = Row(name, seconds, sender, (memory.own, memory.other), reference in (None, text))
    print(row, flush=True)
    return row, text


def parts_of(folder: Path, runs: int) -> list[Path]:
    """Files of the runs."""
    files = []
    for number in range(runs // RUNS_OF_A_PART):
        data, _ = campaign_throughput.campaign_data(RUNS_OF_A_PART, number)
        files.append(folder / f"part-{number:03d}.nc")
        rf.write(data, files[-1])
    return files


def main() -> None:
    """Print the table and keep it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=5000)
    parser.add_argument("--lines", type=int, default=400)
    parser.add_argument("--kill-every", type=float, default=10.0)
    options = parser.parse_args()
    campaign_throughput.LINES = options.lines
    model = rf.models.OneMode()
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with TemporaryDirectory() as folder:
        parts = parts_of(Path(folder), options.runs)
        size = sum(part.stat().st_size for part in parts) / 1e6

        def fitted(executor: Executor | None = None, store: rf.Store | None = None) -> Any:
            return rf.campaign(model, parts, known=KNOWN, executor=executor, store=store)

        plain, reference = measured("plain loop", fitted)
        rows = [plain]
        for count in (1, 2, 4):
            with cluster(f"local:{count}") as executor:
                name = f"{count} worker{'s' * (count > 1)}"
                rows.append(measured(name, lambda e=executor: fitted(e), reference)[0])
        with cluster("local:2") as executor, killing(executor, options.kill_every) as killed:
            name = f"2 workers, one killed every {options.kill_every:g} s"
            rows.append(measured(name, lambda: fitted(executor), reference)[0])
        store = rf.Store(Path(folder) / "runs.db")
        with cluster("local:2") as executor:
            rows.append(measured("2 workers, kept in a store", lambda: fitted(executor, store), reference)[0])
            rows.append(measured("the same again, from the store", lambda: fitted(executor, store), reference)[0])
    write(options, rows, len(killed), size)


def write(options: argparse.Namespace, rows: list[Row], killed: int, size: float) -> None:
    """The table and the arithmetic of more workers."""
    plain = rows[0]
    one = next(row for row in rows if row.name == "1 worker")
    fit, overhead = plain.sender / options.runs, one.sender / options.runs  # processor times
    many = min(SIMULATED, fit / overhead)
    lines = [
        "# Campaigns on a cluster",
        "",
        f"Made by `python benchmarks/cluster.py --runs {options.runs} --lines {options.lines} --kill-every "
        f"{options.kill_every:g}` on {environment('numpy', 'scipy', 'distributed')}: {options.runs} runs of "
        f"{options.lines} lines, {2 * options.lines} readings each, in files of {RUNS_OF_A_PART} runs ({size:.0f} MB). "
        "Two cores do not show what four workers give, and other work ran on them at the same time: times in seconds "
        "say little, processor times more.",
        "",
        *table(
            [
                "way",
                "s",
                "fits a second",
                "speed-up",
                "sender, ms a run",
                "sender, MB",
                "largest worker, MB",
                "digits of the plain loop",
            ],
            [
                [
                    row.name,
                    f"{row.seconds:.0f}",
                    f"{options.runs / row.seconds:.0f}",
                    f"{plain.seconds / row.seconds:.2f}",
                    f"{1e3 * row.sender / options.runs:.2f}",
                    f"{row.megabytes[0]:.0f}",
                    f"{row.megabytes[1]:.0f}" if row is not plain else "-",
                    "all" if row.same else "not all",
                ]
                for row in rows
            ],
        ),
        "",
        f"{killed} workers were killed. By processor time a run costs {1e3 * fit:.1f} ms to read and fit, and "
        f"{1e3 * overhead:.2f} ms of the process that sends it, the scheduler included: by arithmetic {SIMULATED} "
        f"workers give {many:.0f} times the plain loop, and more than {fit / overhead:.0f} are of no use for runs of "
        f"this size. 100,000 runs, which were not made, take {100_000 * fit / 3600:.2f} core hours of fits and "
        f"{100_000 * overhead / 60:.1f} minutes of the process that sends them.",
    ]
    text = "\n".join(lines) + "\n"
    print(text)
    (Path(__file__).parent / "results" / "cluster.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
