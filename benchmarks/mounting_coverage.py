"""Coverage of intervals where weights are mounted a few times: the random effect of mountings, told from 7 of them.

    python benchmarks/mounting_coverage.py --campaigns 300

writes results/mounting_coverage.md and results/mounting_coverage.csv. Campaigns are of the size of the RK-4 data set
(7 mountings on two disks, two dwell speeds, four probes, three repeats) and come from
tests/rigs/campaigns_of_weights.py: formulas written out there, and mountings that scatter as no fitted structure
assumes (each probe by its own bracket, each weight by a complex fraction of itself). Exit status 1 says that coverage
is off by more than sampling error.
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

from campaigns_of_weights import TRUTH, campaign  # noqa: E402
from reporting import RESULTS, environment, table, write_csv  # noqa: E402

import rotorfit as rf  # noqa: E402

KINDS: dict[str, dict[str, float]] = {
    "as measured": {},
    "brackets alone": {"weight_error": 0.0},
    "weights alone": {"weight_error": 0.01, "mounting_um": 0.0},
    "no scatter of mountings": {"weight_error": 0.0, "mounting_um": 0.0},
}
"""What mountings do to the readings, as arguments of ``campaign``."""

TAIL = 1e-2
"""Chance that exact intervals fail a limit, over all of them together."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One parameter under one kind of scatter.

    Attributes:
        mountings: what a mounting does.
        parameter: name.
        spread: standard deviation of the estimates.
        stderr: root mean square of the standard errors.
        covered_68, covered_95: share of intervals that hold the truth.
        widened: share of fits whose errors were widened by a misfit.
    """

    mountings: str
    parameter: str
    spread: float
    stderr: float
    covered_68: float
    covered_95: float
    widened: float


def study(kind: str, campaigns: int, seed: int) -> list[Row]:
    """Coverage of each parameter and its mean error bar beside the spread of its estimates."""
    rng = np.random.default_rng(seed)
    model = rf.models.Modal(("disk1", "disk2"))
    fits = [rf.fit(model, campaign(rng, **KINDS[kind]), phase_offsets="common") for _ in range(campaigns)]

    def covered(name: str, level: float) -> float:
        ends = np.array([fit.interval(name, level) for fit in fits])
        return float(np.mean((ends[:, 0] <= TRUTH[name]) & (TRUTH[name] <= ends[:, 1])))

    return [
        Row(
            mountings=kind,
            parameter=name,
            spread=float(np.std([fit.params[name].value for fit in fits], ddof=1)),
            stderr=float(np.sqrt(np.mean([fit.params[name].stderr ** 2 for fit in fits]))),
            covered_68=covered(name, 0.68),
            covered_95=covered(name, 0.95),
            widened=float(np.mean([fit.widening > 1 for fit in fits])),
        )
        for name in TRUTH
    ]


def outside(rows: list[Row], campaigns: int) -> list[str]:
    """Sentences on coverage that sampling error does not explain."""
    found = []
    for row in rows:
        for level, share in ((0.68, row.covered_68), (0.95, row.covered_95)):
            inside = round(share * campaigns)
            chance = TAIL / (2 * len(rows))
            low, high = stats.binom.ppf([chance / 2, 1 - chance / 2], campaigns, level)
            if not low <= inside <= high:
                found.append(f"{row.mountings}, {row.parameter}: {inside} of {campaigns} inside {level:.0%}")
    return found


def main() -> int:
    """Run the study from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--campaigns", type=int, default=300)
    parser.add_argument("--seed", type=int, default=2025)
    options = parser.parse_args()
    rows = [row for kind in KINDS for row in study(kind, options.campaigns, options.seed)]
    write_csv(rows, RESULTS / "mounting_coverage.csv")
    problems = outside(rows, options.campaigns)
    verdict = "Outside sampling error: " + "; ".join(problems) if problems else "All coverage is within sampling error."
    head = [field.name for field in fields(Row)]
    cells = [[f"{v:.3g}" if isinstance(v, float) else v for v in vars(row).values()] for row in rows]
    lines = [
        "# Weights mounted a few times",
        "",
        f"{options.campaigns} campaigns of each kind, {environment('numpy', 'scipy')}.",
        "",
        *table(head, cells),
        "",
        verdict,
        "",
    ]
    (RESULTS / "mounting_coverage.md").write_text("\n".join(lines), encoding="utf-8")
    print("\n".join(lines))
    return bool(problems)


if __name__ == "__main__":
    sys.exit(main())
