"""Rotors read at one plane of two: how many fits end in a wrong minimum, how many without a word, at what cost.

    python benchmarks/local_minima.py --rotors 60

prints a table. Parameters are log-uniform over a decade around a typical rotor with a disk and a journal in fluid; 60
lines, two speeds, 1 % noise. Overhung rotors are forced in displacement and tilt, and read in displacement. A minimum
is wrong where a search from the truth ends deeper by more than 5 (chi-squared by 10).
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from rotorfit.estimators.minimisation.least_squares import Options
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.start_points import full_vector
from rotorfit.estimators.starting.starts import find_start
from rotorfit.identify.fitting.fit import solve
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.models import WhirlWhip

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests" / "rigs"))  # the families of rotors live with the tests

from synthetic import (  # noqa: E402
    MODELS,
    SPEEDS,
    circular_test,
    covering_frequencies,
    overhung_without_slopes,
    random_stable_rigs,
)

PLACES = (("journal", "journal"), ("disk", "disk"), ("disk", "journal"), ("journal", "disk"))
"""Planes of force and probe."""
DEEPER = 5.0


def read_at(force: str, probe: str, rotors: int, seed: int) -> Iterator[tuple[Problem, dict[str, float]]]:
    """Fits to solve, with the true values."""
    model, speeds = WhirlWhip(), SPEEDS["whirl-whip"]
    for number, truth in enumerate(random_stable_rigs("whirl-whip", rotors, seed)):
        theta = model.vector(truth)
        frequency = covering_frequencies(model, theta, speeds, 60)
        test = circular_test(
            model, theta, speeds=speeds, frequency=frequency, noise=0.01, seed=number, force_planes=[force]
        )
        yield build_problem(model, test.select(test.plane == probe), FitSettings(known={"K3": truth["K3"]})), truth


def overhung(rotors: int, seed: int) -> Iterator[tuple[Problem, dict[str, float]]]:
    """Overhung rotors whose slopes nobody read."""
    for number, truth in enumerate(random_stable_rigs("overhung", rotors, seed)):
        yield build_problem(MODELS["overhung"](), overhung_without_slopes(truth, number), FitSettings()), truth


def count(where: str, problems: Iterable[tuple[Problem, dict[str, float]]]) -> str:
    """A row of the table."""
    wrong = silent = alarms = 0
    seconds = []
    for problem, truth in problems:
        near = full_vector(problem, np.array([truth[name] for name in problem.space.base]))
        least = solve(problem, near, Options()).cost
        begin = time.process_time()
        start = find_start(problem, {})
        found = solve(problem, start.x, Options()).cost
        seconds.append(time.process_time() - begin)
        warned, missed = start.perhaps_local, found > least + DEEPER
        wrong, silent, alarms = wrong + missed, silent + (missed and not warned), alarms + (warned and not missed)
    return f"| {where} | {wrong} | {silent} | {alarms} | {np.median(seconds):.2f} | {max(seconds):.2f} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rotors", type=int, default=60)
    parser.add_argument("--seed", type=int, default=7)
    options = parser.parse_args()
    print(f"| force | probe | wrong of {options.rotors} | of these silent | false alarms | CPU median, s | worst, s |")
    print("|---|---|---|---|---|---|---|")
    for force, probe in PLACES:
        print(count(f"{force} | {probe}", read_at(force, probe, options.rotors, options.seed)), flush=True)
    print(count("overhung disk | disk, no slopes", overhung(options.rotors, options.seed)))


if __name__ == "__main__":
    main()
