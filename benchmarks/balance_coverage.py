"""Coverage of the intervals of correction weights, of sizes, angles and of the vibration expected.

    python benchmarks/balance_coverage.py --draws 1200

writes results/balance_coverage.md and results/balance_coverage.csv. Each draw is another rotor of four probes at two
speeds with random vibration and influences (tests/rigs/kept_weights.py), balanced in two planes with the first trial
weight left in. Exact weights come from least squares on real and imaginary parts, with limits from projected
gradients. Exit status 1 says that coverage is off by more than sampling error.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from scipy import stats

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
sys.path.insert(0, str(HERE.parent / "tests" / "rigs"))  # the formulas live with the tests

from kept_weights import MORE, Complex, best_weights, held, random_rig, runs  # noqa: E402
from reporting import RESULTS, environment, table, write_csv  # noqa: E402

import rotorfit as rf  # noqa: E402
from rotorfit.base.significance import quantile  # noqa: E402

KINDS: dict[str, tuple[bool, tuple[Complex, ...], float]] = {
    "noise given": (True, (), np.inf),
    "noise from two runs more": (False, MORE, np.inf),
    "limits of 6 g mm": (True, (), 6e-6),
}
"""Whether the noise is given, runs beyond the three that are needed, and the largest weight, kg m."""

TAIL = 1e-2
"""Chance that exact intervals fail a limit, over all of them together."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One kind of campaign.

    Attributes:
        campaign: what is known and allowed.
        weights: share of the 95 % intervals of sizes and angles that hold the exact weight.
        vibration: share of those of real and imaginary parts of the vibration expected.
        at_limit: share of weights as large as they may be.
    """

    campaign: str
    weights: float
    vibration: float
    at_limit: float


def study(kind: str, draws: int, seed: int) -> Row:
    """Coverage over so many rotors."""
    given, further, limit = KINDS[kind]
    rng = np.random.default_rng(seed)
    weights: list[bool] = []
    vibration: list[bool] = []
    at_limit = 0
    for _ in range(draws):
        residual, influence = random_rig(rng)
        found = rf.balance(rf.influence(runs(rng, residual, influence, further, given=given)), limits=limit)
        weights += held(found, best_weights(residual, influence, limit))
        off = residual + influence @ found.weight - found.expected
        within = quantile(0.95, found.freedom) * found.stderr
        vibration += [*(np.abs(off.real) <= within), *(np.abs(off.imag) <= within)]
        at_limit += len(found.at_limit)
    return Row(
        campaign=kind,
        weights=float(np.mean(weights)),
        vibration=float(np.mean(vibration)),
        at_limit=at_limit / (2 * draws),
    )


def main() -> int:
    """Run the study from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--draws", type=int, default=1200)
    parser.add_argument("--seed", type=int, default=2026)
    options = parser.parse_args()
    rows = [study(kind, options.draws, options.seed) for kind in KINDS]
    write_csv(rows, RESULTS / "balance_coverage.csv")
    # the intervals of a draw share its noise: no more independent ones are counted than draws
    low, high = stats.binom.ppf([TAIL / 6, 1 - TAIL / 6], options.draws, 0.95) / options.draws
    outside = [row.campaign for row in rows if not low <= row.weights <= high]
    verdict = f"Outside sampling error: {', '.join(outside)}." if outside else "All coverage is within sampling error."
    head = [field.name for field in fields(Row)]
    cells = [[f"{v:.3f}" if isinstance(v, float) else v for v in vars(row).values()] for row in rows]
    lines = [
        "# Correction weights",
        "",
        f"{options.draws} rotors of each kind, {environment('numpy', 'scipy')}. Weights within {low:.3f} to {high:.3f} "
        "are sampling error. The vibration is compared without the scatter of one mounting more, which its interval "
        "holds where it is known.",
        "",
        *table(head, cells),
        "",
        verdict,
        "",
    ]
    (RESULTS / "balance_coverage.md").write_text("\n".join(lines), encoding="utf-8")
    print("\n".join(lines))
    return bool(outside)


if __name__ == "__main__":
    sys.exit(main())
