"""Campaigns on a local Dask cluster: speed-up, overhead a run, memory, and what killing workers does.

Runs of one machine with a pressure of their own, each of so many lines, in files of a hundred that are read where they
are fitted: by a plain loop, over 1, 2 and 4 worker processes, with fits kept in a store, and with a worker killed every
few seconds. Memory is the largest resident size that was seen of the process that sends the runs and of any other.

The process that sends the runs is the one that more workers do not relieve. What it needs for 100,000 runs is measured
by itself: two workers send it results of runs that were fitted, over and over, without fitting. From that and the
processor time of a fit the time over any number of workers is simulated, batch by batch.

    python benchmarks/cluster.py [--runs 5000] [--lines 400] [--kill-every 10]
"""

from __future__ import annotations

import argparse
import logging
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from heapq import heappop, heappush
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import campaign_throughput
from reporting import environment, table

import rotorfit as rf
from rotorfit.base.executors import carry_out, cluster
from rotorfit.studies.campaigns.runs import RUNS_OF_A_BATCH

KNOWN = campaign_throughput.KNOWN
FITTED = campaign_throughput.FITTED
REPLAYED = 100_000
"""Runs whose results are sent without being fitted."""
BATCH = 8 * RUNS_OF_A_BATCH
"""Runs of a part that go to a worker together."""
SIMULATED = (1, 2, 4, 64)
"""Numbers of workers whose speed-up is simulated."""
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
            self.own = max(self.own, resident(os.getpid()))
            self.other = max([self.other, *map(resident, descendants(os.getpid()))])
            self.seconds = time.thread_time()


def descendants(of: int) -> list[int]:
    """All processes that come from one."""
    parents: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                parents[int(entry.name)] = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except (FileNotFoundError, ProcessLookupError):
                continue
    found, new = [], {of}
    while new:
        new = {number for number, parent in parents.items() if parent in new}
        found += list(new)
    return found


def resident(number: int) -> float:
    """Resident size in MB, 0 of a process that has ended."""
    try:
        text = Path(f"/proc/{number}/status").read_text(encoding="utf-8")
    except (FileNotFoundError, ProcessLookupError):
        return 0.0
    return next((float(line.split()[1]) / 1024 for line in text.splitlines() if line.startswith("VmRSS")), 0.0)


@contextmanager
def killing(executor: Any, every: float | None, note: Callable[[int], None] = lambda pid: None) -> Iterator[list[int]]:
    """Kill one worker of a local cluster every so many seconds; gives the processes killed."""
    killed: list[int] = []
    ended = threading.Event()

    def work() -> None:
        while not ended.wait(every):
            pids = [worker.pid for worker in executor._client.cluster.workers.values() if worker.pid]
            if pids:
                killed.append(pids[len(killed) % len(pids)])
                os.kill(killed[-1], signal.SIGKILL)
                note(killed[-1])

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


def parts_of(folder: Path, runs: int, lines: int) -> list[Path]:
    """Files of the runs."""
    files = []
    for number in range(runs // RUNS_OF_A_PART):
        data, _ = campaign_throughput.campaign_data(RUNS_OF_A_PART, number, lines)
        files.append(folder / f"part-{number:03d}.nc")
        rf.write(data, files[-1])
    return files


def replayed(file: Path, batch: Sequence[Any]) -> list[Any]:
    """Results of a batch as a worker sends them, without fitting."""
    found = pickle.loads(file.read_bytes())
    return [found[number % len(found)] for number, _ in batch]


def replay(found: Any, folder: Path, executor: Executor) -> tuple[Row, float]:
    """What the sender needs for the results of many runs, and the memory that each of them keeps, kB."""
    runs = [(number % len(found.runs), dict(found.runs[0].attributes)) for number in range(REPLAYED)]
    batches = [runs[begin : begin + BATCH] for begin in range(0, REPLAYED, BATCH)]
    file = folder / "results.pickle"
    file.write_bytes(pickle.dumps(found.runs))
    before = resident(os.getpid())
    kept: list[Any] = []

    def work() -> Any:
        kept.extend(carry_out(partial(replayed, file), batches, executor))
        return found

    row, _ = measured(f"results of {REPLAYED} runs, without fits", work)
    return row, 1e3 * (resident(os.getpid()) - before) / REPLAYED


def simulated(workers: int, runs: int, fit: float, overhead: float) -> float:
    """Seconds until all batches are fitted by the workers, and taken in one after the other by the sender."""
    free, ends = [0.0] * workers, []
    for begin in range(0, runs, BATCH):
        ends.append(heappop(free) + fit * min(BATCH, runs - begin))
        heappush(free, ends[-1])
    taken = 0.0
    for end in sorted(ends):
        taken = max(taken, end) + overhead * BATCH
    return taken


def main() -> None:
    """Print the table and keep it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=5000)
    parser.add_argument("--lines", type=int, default=400)
    parser.add_argument("--kill-every", type=float, default=10.0)
    options = parser.parse_args()
    model = rf.models.OneMode()
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with TemporaryDirectory() as folder:
        parts = parts_of(Path(folder), options.runs, options.lines)
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
            sent, kept = replay(rf.campaign(model, parts[:1], known=KNOWN), Path(folder), executor)
    write(options, rows, len(killed), size, sent, kept)


def write(options: argparse.Namespace, rows: list[Row], killed: int, size: float, sent: Row, kept: float) -> None:
    """The table and the simulation of more workers."""
    plain = rows[0]
    fit, overhead = plain.sender / options.runs, sent.sender / REPLAYED  # processor times
    gains = [REPLAYED * fit / simulated(count, REPLAYED, fit, overhead) for count in SIMULATED]
    said = ", ".join(f"{gain:.1f} over {count}" for count, gain in zip(SIMULATED, gains, strict=True))
    lines = [
        "# Campaigns on a cluster",
        "",
        f"Made by `python benchmarks/cluster.py --runs {options.runs} --lines {options.lines} --kill-every "
        f"{options.kill_every:g}` on {environment('numpy', 'scipy', 'distributed')}: {options.runs} runs of "
        f"{options.lines} lines, {2 * options.lines} readings each, in files of {RUNS_OF_A_PART} runs ({size:.0f} MB). "
        "Times hold the start of the cluster, and the process that sends needs a processor too.",
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
        f"{killed} workers were killed. A run costs {1e3 * fit:.1f} ms of processor time to read and fit. The process "
        f"that sends, the scheduler included, took in the results of {REPLAYED:,} runs, replayed without fits, in "
        f"{sent.seconds:.0f} s with {1e3 * overhead:.2f} ms of processor time a run; it then held {kept:.1f} kB a run, "
        f"{sent.megabytes[0]:.0f} MB in all, and the largest worker {sent.megabytes[1]:.0f} MB. By simulation from the "
        f"two times {REPLAYED:,} runs gain, against a plain loop, {said} workers; more than {fit / overhead:.0f} are "
        f"of no use for runs of this size. {REPLAYED:,} runs take {REPLAYED * fit / 3600:.2f} core hours of fits and "
        f"{REPLAYED * overhead / 60:.1f} minutes of the process that sends them.",
    ]
    text = "\n".join(lines) + "\n"
    print(text)
    (Path(__file__).parent / "results" / "cluster.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
