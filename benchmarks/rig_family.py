"""Coverage of refined fits over a family of finite-element rigs that no model of rotorfit has in it.

    python benchmarks/rig_family.py --rigs 300

writes results/rig_family.md and results/rig_family.csv.
"""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path

import numpy as np
from scipy import stats

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests" / "rigs"))  # the finite-element rigs live with the tests

from fe_rigs import QUANTITIES, pulls_of, random_rig  # noqa: E402


def main() -> None:
    """Fit and refine every rig, tabulate how often intervals hold the truth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=300)
    parser.add_argument("--seed", type=int, default=20)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    rows = []
    for number in range(options.rigs):
        pulls, before, after = pulls_of(*random_rig(rng), number)
        rows.append([*pulls, before, after])
    table = np.array(rows)
    with (HERE / "results" / "rig_family.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([*(f"pull_{name}" for name in QUANTITIES), "redchi_printed", "redchi_refined"])
        writer.writerows([[f"{value:.4f}" for value in row] for row in rows])
    command = f"python benchmarks/rig_family.py --rigs {options.rigs} --seed {options.seed}"
    printed, refined = np.median(table[:, -2:], axis=0)
    lines = [
        "# Intervals of refined fits over a family of finite-element rigs", "", f"Made with `{command}`.", "",
        f"redchi of the printed model {printed:.1f} (median), of the refined one {refined:.2f}.",
        "Share of rigs whose interval holds the truth, with the binomial 95 % range of the nominal share:", "",
        "| quantity | rms error / stderr | 68 % | 95 % | 99 % |", "|---|---|---|---|---|",
    ]  # fmt: skip
    shares = (0.68, 0.95, 0.99)
    for place, name in enumerate(QUANTITIES):
        pull = np.abs(table[:, place])
        cells = [f"{np.mean(pull < stats.norm.ppf(0.5 + share / 2)):.3f}" for share in shares]
        lines.append(f"| {name} | {np.sqrt(np.mean(pull**2)):.2f} | " + " | ".join(cells) + " |")
    ranges = [stats.binom.ppf([0.025, 0.975], len(rows), share) / len(rows) for share in shares]
    lines.append("| expected | 1 | " + " | ".join(f"{low:.3f}-{high:.3f}" for low, high in ranges) + " |")
    (HERE / "results" / "rig_family.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
