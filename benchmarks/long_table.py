"""How long, and in how much memory, is a table of millions of readings read and checked?

    python benchmarks/long_table.py --readings 5000000

The table has four probes at 1,000 frequencies in each run. ``rotorfit info`` reads and checks it in a process of its
own, whose processor time, time in all and most memory are those that the system counts.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from reporting import RESULTS, environment, table

LINES = 1000
"""Frequencies of a run."""
PROBES = [(plane, direction) for plane in ("disk", "journal") for direction in "xy"]
HEADER = "run,speed_rpm,frequency_rpm,force_plane,force_N,force_phase_deg,plane,direction,amplitude_um,phase_deg\n"


def write_table(path: Path, readings: int, seed: int = 1) -> None:
    """Write a table of runs that differ in speed and in the plane of the force, with noise of 1 %."""
    rng = np.random.default_rng(seed)
    frequencies = np.linspace(300.0, 3600.0, LINES)
    with path.open("w", encoding="utf-8") as file:
        file.write(HEADER)
        for run in range(readings // (LINES * len(PROBES))):
            head = f"run-{run},{1000 + run % 10 * 100}"
            force = f"{'disk' if run % 2 == 0 else 'journal'},2.5,30"
            amplitude, phase = 10.0 + 0.1 * rng.normal(size=(LINES, 4)), -40.0 + rng.normal(size=(LINES, 4))
            file.writelines(
                f"{head},{w:.2f},{force},{plane},{direction},{a:.4f},{p - 90 * (direction == 'y'):.3f}\n"
                for w, own, turned in zip(frequencies, amplitude, phase, strict=True)
                for (plane, direction), a, p in zip(PROBES, own, turned, strict=True)
            )


def measured(path: Path) -> tuple[float, float, float]:
    """Processor time and time in all of ``rotorfit info``, s, and its most memory, bytes."""
    begin = time.monotonic()
    process = subprocess.Popen([sys.executable, "-m", "rotorfit", "info", str(path)], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    if os.waitstatus_to_exitcode(status):
        raise RuntimeError(f"rotorfit info ended with {os.waitstatus_to_exitcode(status)}")
    return used.ru_utime + used.ru_stime, time.monotonic() - begin, 1024.0 * used.ru_maxrss


def main() -> None:
    """Make the table of results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--readings", type=int, default=5_000_000)
    parser.add_argument("--out", type=Path, default=RESULTS / "long_table.md")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        path = Path(made) / "table.csv"
        write_table(path, given.readings)
        load = os.getloadavg()[0]
        processor, whole, memory = measured(path)
        size = path.stat().st_size
    head = ["readings", "file, MB", "processor time, s", "time in all, s", "load before", "most memory, GB"]
    row = [
        f"{given.readings}", f"{size / 1e6:.0f}", f"{processor:.0f}", f"{whole:.0f}", f"{load:.1f}",
        f"{memory / 1e9:.2f}",
    ]  # fmt: skip
    title = f"`benchmarks/long_table.py --readings {given.readings}`: {environment('numpy', 'pandas')}."
    text = "\n".join(["# Long tables", "", title, "", *table(head, [row]), ""])
    given.out.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
