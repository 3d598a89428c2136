"""Inertia, eccentricity and side load from lines that tell little but their ratios: time, convergence, coverage.

    python benchmarks/shaft_valley.py --tests 100 --lines 30

prints processor times of fits, how many converge, how many call J determined, how many of those are off by more than
five standard errors, how often the 95 % interval by the misfit holds J, and the share of other pulls below two. Exit
status 1 says that a J called determined was off so far.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "rigs"))  # the shaft lives with the tests

from line_tests import ALL, TORSION, VALUES, line_test

import rotorfit as rf

TRUTH = VALUES | TORSION
OTHERS = ("M", "D", "K", "dK_cos", "dK_sin", "nu_t", "zeta_t")


def main() -> int:
    """Fit all tests and print what came of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tests", type=int, default=100)
    parser.add_argument("--lines", type=int, default=30, help="frequencies of the sweep")
    settings = parser.parse_args()
    model, sweep = rf.models.AnisotropicShaft(), -np.linspace(30.0, 310.0, settings.lines)
    times, converged, determined, wrong, held, pulls = [], 0, 0, 0, 0, []
    for seed in range(settings.tests):
        test = line_test(model, TRUTH, ALL, np.random.default_rng(seed), sweep=sweep)
        begin = time.process_time()
        fit = rf.fit(model, test)
        times.append(time.process_time() - begin)
        converged += fit.success
        pull = {name: (fit.params[name].value - TRUTH[name]) / fit.params[name].stderr for name in ("J", *OTHERS)}
        pulls += [pull[name] for name in OTHERS]
        determined += fit.params["J"].resolved
        wrong += fit.params["J"].resolved and not abs(pull["J"]) < 5
        profile = fit.profile("J", points=3)
        held += profile.lower <= TRUTH["J"] <= profile.upper
    print(f"{settings.tests} tests of {settings.lines} frequencies, four kinds of line")
    print(f"processor time of a fit: median {np.median(times):.2f} s, longest {max(times):.2f} s")
    print(f"converged {converged}; J called determined {determined}, of those off by five standard errors {wrong}")
    print(f"95 % interval of J by the misfit holds it in {held}")
    share = 100 * np.mean(np.abs(pulls) < 2)
    print(f"|pull| < 2 of {', '.join(OTHERS)}: {share:.0f} %, largest {np.abs(pulls).max():.1f}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
