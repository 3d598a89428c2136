"""Coverage of posteriors over a family of finite-element rigs: the structure chosen by BIC, and averaged over.

    python benchmarks/posterior_coverage.py --rigs 100

writes results/posterior_coverage.md and results/posterior_coverage.csv.
"""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests" / "rigs"))  # the finite-element rigs live with the tests

from fe_rigs import K3, random_rig  # noqa: E402

import rotorfit as rf  # noqa: E402

QUANTITIES = ("D", "lam", "Mf", "threshold")
SHARES = (0.68, 0.95, 0.99)


def levels(number: int, rng: np.random.Generator) -> tuple[list[float], list[float]]:
    """Share of the draws below the truth, for the chosen structure and for the average, and the chosen one's weight."""
    truth, rig, speeds, threshold = random_rig(rng)
    plain = rf.fit(rf.models.WhirlWhip(), rig.campaign(speeds, number), known={"K3": K3})
    average = rf.sample_models(rf.refine(plain).steps, seed=number, walkers=64)
    if not average.converged:
        raise RuntimeError(f"rig {number}: {average}")
    rows = []
    for posterior in (average.posteriors[0], average):
        row = [float(np.mean(posterior.parameter(name).samples < truth[name])) for name in ("D", "lam", "Mf")]
        rows.append([*row, float(np.mean(posterior.threshold_speed().samples < threshold))])
    return rows[0], [*rows[1], average.weights[0]]


def table(title: str, below: NDArray[np.float64]) -> list[str]:
    """Share of the rigs whose interval holds the truth."""
    lines = ["", f"{title}:", "", "| quantity | 68 % | 95 % | 99 % |", "|---|---|---|---|"]
    for place, name in enumerate(QUANTITIES):
        distance = np.abs(below[:, place] - 0.5)
        lines.append(f"| {name} | " + " | ".join(f"{np.mean(distance <= share / 2):.3f}" for share in SHARES) + " |")
    ranges = [stats.binom.ppf([0.025, 0.975], len(below), share) / len(below) for share in SHARES]
    lines.append("| expected | " + " | ".join(f"{low:.3f}-{high:.3f}" for low, high in ranges) + " |")
    return lines


def main() -> None:
    """Sample every rig, tabulate how often intervals hold the truth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=11)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    pairs = [levels(number, rng) for number in range(options.rigs)]
    chosen, averaged = (np.array(rows) for rows in zip(*pairs, strict=True))
    with (HERE / "results" / "posterior_coverage.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([*(f"chosen_{n}" for n in QUANTITIES), *(f"averaged_{n}" for n in QUANTITIES), "weight_chosen"])
        writer.writerows([[f"{value:.4f}" for value in row] for row in np.column_stack([chosen, averaged])])
    lines = [
        "# Intervals of posteriors over a family of finite-element rigs", "",
        f"Made with `python benchmarks/posterior_coverage.py --rigs {options.rigs} --seed {options.seed}`.", "",
        "Share of rigs whose central interval holds the truth, with the binomial 95 % range of the nominal share.",
        f"In {np.mean(averaged[:, -1] < 0.99):.0%} of the rigs the structure chosen has less than 99 % of the weight.",
        *table("Structure chosen by BIC (`rf.refine`, `fit.sample(refine=True)`)", chosen),
        *table("Averaged over structures (`rf.sample_models(rf.refine(fit).steps)`)", averaged),
    ]  # fmt: skip
    (HERE / "results" / "posterior_coverage.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
