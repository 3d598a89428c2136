"""Fits a second of a seal campaign, and whether the time grows in proportion to the runs.

Every run has 200 lines (x and y probe, 400 readings), a speed and a pressure of its own, 1 % noise of unknown level;
K0, D, lam and Mf are fitted run by run. One process, processor time, the median of several campaigns after a first run
that compiles the model. Accuracy stands beside time: mean square distance from the truth in standard errors, 1 if
honest, with its own sampling error; expect a few percent less, because errors are widened where redchi is above 1 by
chance and not narrowed where it is below. With ``--shared`` the mass is fitted too, one value for all runs.

    python benchmarks/campaign_throughput.py

The exit code is 1 below 100 fits a second for 70 runs, or where a mean square exceeds 1 by more than 3.5 of its errors.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from reporting import RESULTS, environment, table, write_csv

import rotorfit as rf
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.from_arrays import perturbation_test

RUNS = (18, 35, 70, 140, 280)
LINES = 200
NOISE = 0.01
WANTED = 100.0
"""Fits a second that a campaign of 70 runs gives on one core."""
SIGMAS = 3.5
"""Sampling errors by which the mean square distance may exceed 1."""
KNOWN = {"M": 1.2, "K": 8000.0, "Ds": 8.0}
FITTED = ("K0", "D", "lam", "Mf")


@dataclass(frozen=True)
class Rate:
    """Throughput of one size of campaign.

    Attributes:
        runs: number of runs.
        shared: parameters fitted for all runs together.
        seconds: processor time of one campaign.
        fits_per_second: runs over time.
        pull: mean square of (estimate - truth) over standard error.
        pull_error: sampling error of that; the runs are independent, the parameters of a run are not.
    """

    runs: int
    shared: str
    seconds: float
    fits_per_second: float
    pull: float
    pull_error: float


def truth_at(pressure: float) -> dict[str, float]:
    """Seal parameters at a pressure, psi."""
    return KNOWN | {"K0": 2000 + 150 * pressure, "D": 300 + 4 * pressure, "lam": 0.45 - 0.002 * pressure, "Mf": 0.4}


def campaign_data(runs: int, seed: int, lines: int = LINES) -> tuple[PerturbationTest, dict[str, list[float]]]:
    """One table of runs, and the true values of each."""
    rng, model = np.random.default_rng(seed), rf.models.OneMode()
    half = np.linspace(2.0, 300.0, lines // 2)
    w = np.concatenate([-half[::-1], half])
    force, columns = 5.0 * np.exp(0.4j), {name: [] for name in ("run", "speed", "direction", "response", "pressure")}
    truths: dict[str, list[float]] = {name: [] for name in FITTED}
    for number in range(runs):
        pressure, speed = rng.uniform(3, 80), 100 + rng.normal()
        truth = truth_at(pressure)
        z = model.receptance(model.vector(truth), w, speed)[:, 0, 0] * np.where(w < 0, force.conj(), force)
        x = np.where(w < 0, z.conj(), z)
        level = NOISE * float(np.sqrt(np.mean(np.abs(z) ** 2)))
        for direction, reading in (("x", x), ("y", np.where(w < 0, 1j, -1j) * x)):
            noise = level * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
            row = {"run": f"r{number:03d}", "speed": speed, "direction": direction, "response": reading + noise}
            for name, value in (row | {"pressure": pressure}).items():
                columns[name].append(np.broadcast_to(np.asarray(value), w.shape))
        for name in FITTED:
            truths[name].append(truth[name])
    whole = {name: np.concatenate(parts) for name, parts in columns.items()}
    pressure_psi = whole.pop("pressure")
    test = perturbation_test(
        **whole, frequency=np.tile(w, 2 * runs), force_plane="journal", force=force, plane="journal",
        attributes={"pressure_psi": pressure_psi}, source="seal campaign",
    )  # fmt: skip
    return test, truths


def measure(runs: int, shared: tuple[str, ...], rounds: int) -> Rate:
    """Median processor time of a campaign; every round has data and speeds of its own, so that nothing is met again."""
    model = rf.models.OneMode()
    known = {name: value for name, value in KNOWN.items() if name not in shared}
    rf.campaign(model, campaign_data(1, rounds)[0], known=KNOWN)
    seconds, pulls = [], []
    for number in range(rounds):
        test, truths = campaign_data(runs, 1000 * runs + number)
        begin = time.process_time()
        found = rf.campaign(model, test, known=known, shared=shared)
        seconds.append(time.process_time() - begin)
        if not found.success:
            raise RuntimeError(found.summary())
        squares = []
        for name in FITTED:
            value, stderr = found.values(name)
            squares.append(((value - truths[name]) / stderr) ** 2)
        pulls.append(np.mean(squares, axis=0))  # of each run
    middle, squared = float(np.median(seconds)), np.concatenate(pulls)
    error = float(squared.std(ddof=1) / np.sqrt(squared.size))
    return Rate(runs, " ".join(shared) or "-", middle, runs / middle, float(squared.mean()), error)


def main() -> int:
    """Measure, write, judge."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--rounds", type=int, default=5)
    arguments.add_argument("--shared", action="store_true", help="measure the shared mass too")
    options = arguments.parse_args()
    rates = [measure(runs, (), options.rounds) for runs in RUNS]
    # Seconds against runs: the exponent of a power law, 1 for proportional.
    exponent = float(np.polyfit(np.log([r.runs for r in rates]), np.log([r.seconds for r in rates]), 1)[0])
    if options.shared:
        rates += [measure(runs, ("M",), options.rounds) for runs in RUNS[:3]]
    rows = [
        (str(r.runs), r.shared, f"{r.seconds:.3f}", f"{r.fits_per_second:.0f}", f"{r.pull:.3f} +- {r.pull_error:.3f}")
        for r in rates
    ]
    where = environment("casadi", "numpy", "scipy")
    command = f"python benchmarks/campaign_throughput.py{' --shared' if options.shared else ''}"
    lines = [
        "# Throughput of a seal campaign",
        "",
        f"`{command}` on {where}. {LINES} lines a run, one process, processor time.",
        "",
        *table(("runs", "shared", "seconds", "fits a second", "mean square pull"), rows),
        "",
        f"Time grows as runs to the power {exponent:.2f}.",
    ]
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "campaign_throughput.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    write_csv(rates, RESULTS / "campaign_throughput.csv", command, where)
    print("\n".join(lines))
    reached = next(rate.fits_per_second for rate in rates if rate.runs == 70)
    print(f"\n{reached:.0f} fits a second for 70 runs; {WANTED:.0f} wanted")
    dishonest = [rate.runs for rate in rates if rate.pull - 1 > SIGMAS * rate.pull_error]
    if dishonest:
        print(f"standard errors are too small for {', '.join(map(str, dishonest))} runs")
    return int(reached < WANTED or bool(dishonest))


if __name__ == "__main__":
    sys.exit(main())
