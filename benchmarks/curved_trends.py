"""Coverage of polynomials through the runs of a campaign: K0 that grows with the flow squared, as in Fig. 19.

Every campaign has ten sweeps, forward and backward, at flows drawn from 3 to 12 l/min, with 3 % noise of unknown level;
K0, D, lam and Mf are fitted run by run, then K0 is followed against the flow by a straight line and by polynomials.
Counted is how often 95 % intervals hold the truth: of the curve at 7 l/min, of its slope at the mean, of the
coefficient of the flow squared.

    python benchmarks/curved_trends.py

The exit code is 1 where intervals of the parabola or the cubic hold in less than 95 %, beyond chance.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from reporting import RESULTS, environment, table

import rotorfit as rf
from rotorfit.studies.campaigns.trends import Trend

STRUCTURE = {"M": 1.2, "K": 5e3, "Ds": 8.0}
RUNS, NOISE, AT, LEVEL = 10, 0.03, 7.0, 0.95
BASE, SQUARE = 2000.0, 60.5  # N/m, N/m per (l/min)^2


def campaign(seed: int) -> rf.Campaign:
    """One campaign of sweeps at random flows."""
    rng, model = np.random.default_rng(seed), rf.models.OneMode()
    half = np.linspace(15.0, 260.0, 20)
    w, tests = np.r_[-half[::-1], half], []
    for number, flow in enumerate(rng.uniform(3.0, 12.0, RUNS)):
        truth = STRUCTURE | {"K0": BASE + SQUARE * flow**2, "D": 250 + 1.2 * flow**2, "lam": 0.45, "Mf": 0.35}
        z = 3.0 * model.receptance(model.vector(truth), w, 105.0)[:, 0, 0]
        level = NOISE * np.sqrt(np.mean(abs(z) ** 2))
        noisy = z + level * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
        test = rf.perturbation_test(
            run=f"r{number}", speed=105.0, frequency=w, force_plane="journal", force=3.0, plane="journal",
            direction="z", response=noisy, sigma=level,
        )  # fmt: skip
        tests.append(replace(test, attributes={"flow": np.full(w.size, flow)}))
    return rf.campaign(model, tests, split=None, known=STRUCTURE)


def held(trend: Trend) -> list[bool]:
    """Whether the intervals of the curve at a flow, of its slope and of the square's coefficient hold the truth."""
    mean = float(np.mean(trend.x))
    pairs = [(trend.at(AT), BASE + SQUARE * AT**2), (trend.slope, 2 * SQUARE * mean)]
    if trend.degree > 1:
        pairs.append((trend.coefficients[2], SQUARE))
    inside = []
    for quantity, truth in pairs:
        low, high = quantity.interval(LEVEL)
        inside.append(low <= truth <= high)
    return inside


def main() -> int:
    """Draw campaigns, count, write, judge."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--draws", type=int, default=300)
    draws = arguments.parse_args().draws
    found: dict[int, list[list[bool]]] = {1: [], 2: [], 3: []}
    scatter: dict[int, list[float]] = {1: [], 2: [], 3: []}
    for seed in range(draws):
        runs = campaign(seed)
        for degree, inside in found.items():
            (trend,) = runs.trends("K0", against="flow", degree=degree)
            inside.append(held(trend))
            scatter[degree].append(trend.scatter)
    rows, worst = [], 1.0
    for degree, inside in found.items():
        share = np.mean(inside, axis=0)
        worst = worst if degree == 1 else min(worst, share.min())
        cells = [f"{100 * value:.1f} %" for value in share] + ["-"] * (3 - share.size)
        rows.append((str(degree), *cells, f"{np.median(scatter[degree]):.2f}"))
    chance = np.sqrt(LEVEL * (1 - LEVEL) / draws)
    lines = [
        "# Curved trends of a campaign",
        "",
        f"`python benchmarks/curved_trends.py --draws {draws}` on {environment('casadi', 'numpy', 'scipy')}. "
        f"{RUNS} runs each; share of 95 % intervals that hold the truth, to within {100 * chance:.1f} % by chance.",
        "",
        *table(("degree", f"K0 at {AT:g} l/min", "slope at the mean", "of the flow squared", "scatter"), rows),
        "",
        "Intervals are widened where runs scatter more than their errors say, by chance too, and never narrowed.",
    ]
    (RESULTS / "curved_trends.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
    return int(worst < LEVEL - 3 * chance)


if __name__ == "__main__":
    sys.exit(main())
