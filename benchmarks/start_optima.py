"""Rotors read at every plane: how often the search that begins at the closed form ends beside the optimum.

    python benchmarks/start_optima.py --rotors 70

prints a table. Parameters are log-uniform over a decade around the typical rotor of each model; 200 lines, 1 and 5 %
noise. An optimum is missed where a search from the truth ends deeper by more than 0.05 (chi-squared by 0.1).

    python benchmarks/start_optima.py --costs before.json
    python benchmarks/start_optima.py --costs after.json --against before.json

compares two versions of the code: how many fits end deeper, and how many less deep, than those of the file.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rotorfit.estimators.minimisation.least_squares import Options
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.start_points import full_vector
from rotorfit.estimators.starting.starts import find_start
from rotorfit.identify.fitting.fit import solve
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.settings import FitSettings

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests" / "rigs"))  # the families of rotors live with the tests

from synthetic import (  # noqa: E402
    MODELS,
    SPEEDS,
    circular_test,
    covering_frequencies,
    known_of,
    random_stable_rigs,
)

NOISES = (0.01, 0.05)
DEEPER = 0.05
"""Difference of costs beyond which two optima are not the same: a search ends within a thousandth of it."""


@dataclass(frozen=True, kw_only=True)
class Family:
    """Ends of the searches for the rotors of one model at one noise."""

    name: str
    costs: list[float]  # where the search from the start ended
    missed: int  # searches that ended beside the optimum that the truth leads to
    kinds: Counter[str]  # starts that were taken
    seconds: list[float]  # CPU time of start and search


def problems(name: str, noise: float, rotors: int, seed: int) -> Iterator[tuple[Problem, dict[str, float]]]:
    """Fits to solve, with the true values."""
    model = MODELS[name]()
    for number, truth in enumerate(random_stable_rigs(name, rotors, seed)):
        theta = model.vector(truth)
        frequency = covering_frequencies(model, theta, SPEEDS[name], 200)
        test = circular_test(
            model, theta, speeds=SPEEDS[name], frequency=frequency, noise=noise, seed=number, sigma_known=True
        )
        yield build_problem(model, test, FitSettings(known=known_of(name, truth))), truth


def family(name: str, noise: float, rotors: int, seed: int) -> Family:
    """Searches from the start and from the truth."""
    costs, kinds, seconds, missed = [], Counter[str](), [], 0
    for problem, truth in problems(name, noise, rotors, seed):
        near = full_vector(problem, np.array([truth[base] for base in problem.space.base]))
        least = solve(problem, near, Options()).cost
        begin = time.process_time()
        start = find_start(problem, {})
        costs.append(float(solve(problem, start.x, Options()).cost))
        seconds.append(time.process_time() - begin)
        kinds[start.kind] += 1
        missed += costs[-1] > least + DEEPER
    return Family(name=f"{name}, {100 * noise:g} %", costs=costs, missed=missed, kinds=kinds, seconds=seconds)


def row(found: Family, before: list[float] | None) -> str:
    """A row of the table."""
    kinds = ", ".join(f"{kind} {count}" for kind, count in found.kinds.most_common())
    cells = [found.name, str(len(found.costs)), str(found.missed)]
    if before is not None:
        change = np.array(found.costs) - before
        cells += [str(np.sum(change > DEEPER)), str(np.sum(change < -DEEPER))]
    cells += [kinds, f"{1e3 * np.median(found.seconds):.1f}", f"{1e3 * max(found.seconds):.0f}"]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rotors", type=int, default=70)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--models", nargs="+", default=list(MODELS), choices=list(MODELS))
    parser.add_argument("--costs", type=Path, help="file for the costs at which the searches ended")
    parser.add_argument("--against", type=Path, help="such a file, written before with the same options")
    options = parser.parse_args()
    before = json.loads(options.against.read_text()) if options.against else {}
    compared = ["less deep than before", "deeper"] if options.against else []
    head = ["rotors", "of", "optimum missed", *compared, "starts taken", "CPU median, ms", "worst, ms"]
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    costs = {}
    for name in options.models:
        for noise in NOISES:
            found = family(name, noise, options.rotors, options.seed)
            costs[found.name] = found.costs
            print(row(found, before[found.name] if options.against else None), flush=True)
    if options.costs:
        options.costs.write_text(json.dumps(costs))


if __name__ == "__main__":
    main()
