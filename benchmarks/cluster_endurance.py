"""A long campaign on a local Dask cluster whose workers are killed, and whose sender is killed and started again.

Runs of one machine with a pressure of their own, in parts of a hundred that the workers make where they fit them. The
process that sends the runs keeps each fit in a store. A worker is killed every few seconds, and once, some time after
the begin, the sender itself; it is started again and takes up what is left. Memory of all processes is looked at every
ten seconds, from outside. In the end the table of runs is compared with that of a plain loop over every so many parts,
row by row, to the last digit.

    python benchmarks/cluster_endurance.py [--runs 100000] [--stop-after 300] [--kill-every 10]

The exit code is 1 where a row differs from that of the plain loop or is missing.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from campaign_throughput import KNOWN, campaign_data
from cluster import RUNS_OF_A_PART, descendants, killing, resident
from reporting import RESULTS, environment, table, write_csv

import rotorfit as rf
from rotorfit.base.executors import cluster
from rotorfit.lab.data.experiments import PerturbationTest

LOOK = 10.0
"""Seconds between looks at the memory."""


@dataclass(frozen=True)
class Look:
    """One look at all processes."""

    seconds: float  # since the begin
    runs: int  # done, those that were found in the store included
    sender: float  # resident size of the process that sends, scheduler included, MB
    worker: float  # of the largest other process, MB
    killed: int  # workers, until then
    starts: int  # of the sender


def part(number: int, lines: int) -> PerturbationTest:
    """A hundred runs, with names that no other part has."""
    data, _ = campaign_data(RUNS_OF_A_PART, number, lines)
    return replace(data, run=np.char.add(f"p{number:04d}-", data.run.astype(str)))


def parts_of(options: argparse.Namespace, step: int = 1) -> list[Any]:
    """Readers of the parts."""
    return [partial(part, number, options.lines) for number in range(0, options.runs // RUNS_OF_A_PART, step)]


def send(options: argparse.Namespace) -> None:
    """The process that sends: fits what the store lacks, and writes the table of all runs."""
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    done, killed = options.folder / "done", options.folder / "killed"

    def note(pid: int) -> None:
        with killed.open("a", encoding="utf-8") as stream:
            stream.write(f"{pid}\n")

    store = rf.Store(options.folder / "runs.db")
    with cluster(f"local:{options.workers}") as executor, killing(executor, options.kill_every, note):
        found = rf.campaign(
            rf.models.OneMode(), parts_of(options), known=KNOWN, executor=executor, store=store,
            progress=lambda count, _: done.write_text(str(count), encoding="utf-8"),
        )  # fmt: skip
    found.to_csv(options.folder / "runs.csv")


def watched(options: argparse.Namespace) -> list[Look]:
    """Start the sender, kill it once, start it again, and look at the memory until it is done."""
    command = [sys.executable, __file__, "--send", "--folder", str(options.folder)]
    for name in ("runs", "lines", "workers", "kill_every"):
        command += [f"--{name.replace('_', '-')}", str(getattr(options, name))]
    begin, looks, starts = time.monotonic(), [], 1
    sender = subprocess.Popen(command)
    while sender.poll() is None:
        time.sleep(LOOK)
        seconds = time.monotonic() - begin
        others = max([0.0, *map(resident, descendants(sender.pid))])
        looks.append(
            Look(seconds, _count(options.folder / "done"), resident(sender.pid), others, _lines(options.folder), starts)
        )
        print(looks[-1], flush=True)
        if starts == 1 and seconds > options.stop_after and sender.poll() is None:
            os.kill(sender.pid, signal.SIGKILL)
            sender.wait()
            sender, starts = subprocess.Popen(command), 2
    if sender.returncode:
        raise RuntimeError(f"the sender ended with exit code {sender.returncode}")
    return looks


def _count(file: Path) -> int:
    text = file.read_text(encoding="utf-8") if file.exists() else ""
    return int(text or 0)


def _lines(folder: Path) -> int:
    file = folder / "killed"
    return len(file.read_text(encoding="utf-8").splitlines()) if file.exists() else 0


def compared(options: argparse.Namespace) -> tuple[int, int, float]:
    """Runs of a plain loop over some parts, how many of them the long table holds as they are, and ms a run."""
    begin = time.process_time()
    plain = rf.campaign(rf.models.OneMode(), parts_of(options, options.sample_every), known=KNOWN).to_csv()
    seconds = time.process_time() - begin
    wanted = set(map(_hash, plain.splitlines()[1:]))
    with (options.folder / "runs.csv").open(encoding="utf-8") as stream:
        same = wanted & set(map(_hash, stream.read().splitlines()))
    return len(wanted), len(same), 1e3 * seconds / len(wanted)


def _hash(row: str) -> bytes:
    return hashlib.sha256(row.encode("utf-8")).digest()


def rows_in(file: Path) -> int:
    """Runs in a table that have a fit."""
    with file.open(encoding="utf-8", newline="") as stream:
        return sum(row["success"] == "True" for row in csv.DictReader(stream))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, compare, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=100_000)
    parser.add_argument("--lines", type=int, default=400)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--kill-every", type=float, default=10.0)
    parser.add_argument("--stop-after", type=float, default=300.0, help="seconds after which the sender is killed")
    parser.add_argument("--sample-every", type=int, default=20, help="parts of which the plain loop fits one")
    parser.add_argument("--folder", type=Path, help="where the store is kept; an interrupted run is taken up there")
    parser.add_argument("--send", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.send:
        send(options)
        return 0
    with TemporaryDirectory() as folder:
        options.folder = options.folder or Path(folder)
        options.folder.mkdir(exist_ok=True)
        looks = watched(options)
        wanted, same, each = compared(options)
        write(options, looks, wanted, same, each)
    return int(same < wanted)


def write(options: argparse.Namespace, looks: list[Look], wanted: int, same: int, each: float) -> None:
    """The table, and memory over time."""
    command = (
        f"python benchmarks/cluster_endurance.py --runs {options.runs} --lines {options.lines} --workers "
        f"{options.workers} --kill-every {options.kill_every:g} --stop-after {options.stop_after:g}"
    )
    where = environment("numpy", "scipy", "distributed")
    some = [next((look for look in looks if look.runs >= share * options.runs), looks[-1]) for share in _SHARES]
    text = "\n".join(
        [
            "# A long campaign whose processes are killed",
            "",
            f"Made by `{command}` on {where}: {options.runs:,} runs of {options.lines} lines, {2 * options.lines} "
            f"readings each, on {options.workers} workers of a machine with other work. The process that sends holds "
            f"the scheduler too. Every look is in [cluster_endurance.csv](cluster_endurance.csv).",
            "",
            *table(
                ["runs done", "s", "sender, MB", "largest worker, MB", "workers killed", "starts of the sender"],
                [
                    [
                        f"{look.runs:,}",
                        f"{look.seconds:.0f}",
                        f"{look.sender:.0f}",
                        f"{look.worker:.0f}",
                        str(look.killed),
                        str(look.starts),
                    ]
                    for look in some
                ],
            ),
            "",
            f"At most the sender had {max(look.sender for look in looks):.0f} MB and a worker "
            f"{max(look.worker for look in looks):.0f} MB. {looks[-1].killed} workers were killed, and the sender "
            f"{looks[-1].starts - 1} times. {rows_in(options.folder / 'runs.csv'):,} runs have a fit that converged. "
            f"Of {wanted:,} runs that a plain loop fitted ({each:.1f} ms of processor time each, making the readings "
            f"twice included), {same:,} rows of the table are the same to the last digit.",
        ]
    )
    print(text)
    (RESULTS / "cluster_endurance.md").write_text(text + "\n", encoding="utf-8")
    write_csv(looks, RESULTS / "cluster_endurance.csv", command, where)


_SHARES = (0.01, 0.1, 0.25, 0.5, 0.75, 1.0)
"""Shares of the runs at which the table shows a look."""


if __name__ == "__main__":
    sys.exit(main())
