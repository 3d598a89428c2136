"""Time of one fit beside lmfit with a hand-vectorised NumPy residual, on the same data and to the same optimum.

Without causes beside the model, which lmfit has not. Eq. (18) with ten free parameters, four responses of 400 lines,
1 % noise. Warm times are medians of processor time over rounds in which all contenders take turns, everything
imported and used before; "one of 500" is the share of one fit in 500 data sets that differ by their noise, fitted at
once. Cold times are processor times of whole fresh processes, from the interpreter through imports and reading to one
fit. Accuracy stands beside time: distance from the exact optimum. An experiment met before keeps its layout; every
fit makes a closed form of its own.

    python benchmarks/fit_speed.py
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import lmfit_rival
from reporting import RESULTS, environment, table, write_csv
from rigs import FORCE, RIGS

from rotorfit.base.array_types import Float
from rotorfit.estimators.minimisation.batch import batch_fit
from rotorfit.estimators.minimisation.least_squares import minimise
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.starts import find_start
from rotorfit.identify.fitting.fit import fit as rf_fit
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.lab.data.experiments import PerturbationTest

LINES = 400
SPEED = 150.0
NOISE = 0.01
TOGETHER = 500
TIGHT = {"ftol": 1e-15, "xtol": 1e-15, "gtol": 1e-15}

COLD = """
import sys
import numpy as np
import rotorfit as rf
columns = dict(np.load(sys.argv[1]))
known = {"K3": float(columns.pop("K3"))}
fit = rf.fit(rf.models.WhirlWhip(), rf.perturbation_test(**columns), known=known, causes=None)
print(*[p.value for p in fit.params.values() if p.vary])
"""


@dataclass(frozen=True)
class Timing:
    """One contender.

    Attributes:
        ms: median time of a fit.
        fastest_ms: best time of a fit.
        evaluations: of the residual, or of the objective with its derivatives.
        distance: largest distance of a parameter from the exact optimum, standard errors.
    """

    contender: str
    start: str
    ms: float
    fastest_ms: float
    evaluations: int | None
    distance: float


@dataclass(frozen=True, eq=False)
class Case:
    """One data set as an experiment, as a prepared problem and as bare arrays, and its exact optimum.

    Attributes:
        typical: values of the parameters in the model's table, what one types where there is no closed form.
    """

    test: PerturbationTest
    problem: Problem
    arrays: dict[str, Any]
    known: dict[str, float]
    typical: Float
    optimum: Float
    stderr: Float

    def named(self, x: Float) -> dict[str, float]:
        return dict(zip(self.problem.space.names, x.tolist(), strict=True))

    def distance(self, x: Float) -> float:
        return float(np.max(np.abs((x - self.optimum) / self.stderr)))


def make_case(lines: int = LINES) -> Case:
    rig = replace(RIGS["whirl-whip"], speeds=(SPEED,))
    test = rig.test(lines, NOISE, np.random.default_rng(1))
    known = {name: rig.truth[name] for name in rig.known}
    problem = build_problem(rig.model, test, FitSettings(known=known))
    measured, weight = np.empty((2, 2, lines), dtype=complex), np.empty((2, 2, lines))
    for row, plane in enumerate(rig.model.planes):
        for column, force_plane in enumerate(rig.model.planes):
            mine = (test.plane == plane) & (test.force_plane == force_plane)
            order = np.argsort(test.frequency[mine])
            measured[row, column] = test.response[mine][order] / FORCE
            weight[row, column] = FORCE / test.sigma[mine][order]
    arrays = {"w": rig.sweep(lines), "measured": measured, "weight": weight, "speed": SPEED, "K3": known["K3"]}
    typical = np.array([rig.model.parameter(name).scale for name in problem.space.names])
    optimum, stderr = exact_optimum(problem)
    return Case(test, problem, arrays, known, typical, optimum, stderr)


def exact_optimum(problem: Problem) -> tuple[Float, Float]:
    """Optimum to round-off, by Newton's method with the exact Hessian, and standard errors."""
    x = minimise(problem, find_start(problem, {}).x).x
    size = np.abs(x)
    for _ in range(4):
        hessian = problem.hessian(x) * np.outer(size, size)
        x = x - size * np.linalg.solve(hessian, size * problem.gauss_newton(x)[1])
    information = problem.gauss_newton(x)[2] * np.outer(size, size)
    return x, size * np.sqrt(np.diag(np.linalg.inv(information)))


# ---- contenders ---------------------------------------------------------------------------------------------

Contender = Callable[[], tuple[Float, int | None]]


def contenders(case: Case) -> dict[tuple[str, str], Contender]:
    """Fits by (what is timed, where it starts): each returns the estimate and the evaluations."""
    space = case.problem.space
    closed = find_start(case.problem, {}).x

    def lmfit(start: Float, **settings: float) -> tuple[Float, int | None]:
        result = lmfit_rival.fit(case.arrays, case.named(start), **settings)
        return np.array([parameter.value for parameter in result.params.values()]), result.nfev

    def engine(start: Float) -> tuple[Float, int | None]:
        found = minimise(case.problem, start, lower=space.lower, upper=space.upper)
        return found.x, found.n_evaluations

    def prepared() -> tuple[Float, int | None]:
        fresh = tuple(replace(block) for block in case.problem.blocks)  # data keep the passes of their closed form
        return engine(find_start(replace(case.problem, blocks=fresh), {}).x)

    def whole() -> tuple[Float, int | None]:
        result = rf_fit(space.model, replace(case.test), known=case.known, causes=None)
        return result.x, result.nfev

    def again() -> tuple[Float, int | None]:
        result = rf_fit(space.model, case.test, known=case.known, causes=None)
        return result.x, result.nfev

    turn, other = count(1), replace(case.test)  # met before as well, and not by the others

    def otherwise() -> tuple[Float, int | None]:
        known = {name: value * (1 + 1e-12 * next(turn)) for name, value in case.known.items()}
        result = rf_fit(space.model, other, known=known, causes=None)
        return result.x, result.nfev

    return {
        ("lmfit", "typical values"): lambda: lmfit(case.typical),
        ("lmfit, tight tolerances", "typical values"): lambda: lmfit(case.typical, **TIGHT),
        ("rotorfit engine", "typical values"): lambda: engine(case.typical),
        ("lmfit", "closed form, given"): lambda: lmfit(closed),
        ("rotorfit engine", "closed form, given"): lambda: engine(closed),
        ("rotorfit engine", "closed form, included"): prepared,
        ("rf.fit, from the experiment to the result", "closed form, included"): whole,
        ("rf.fit, of an experiment met before", "closed form, kept"): again,
        ("rf.fit, the same with another known value", "closed form, included"): otherwise,
    }


def warm(case: Case, rounds: int) -> list[Timing]:
    entries = contenders(case)
    results = {key: run() for key, run in entries.items()}
    seconds: dict[tuple[str, str], list[float]] = {key: [] for key in entries}
    for _ in range(rounds):
        for key, run in entries.items():
            begin = time.process_time()
            run()
            seconds[key].append(time.process_time() - begin)
    return [
        Timing(*key, 1e3 * float(np.median(seconds[key])), 1e3 * min(seconds[key]), evaluations, case.distance(x))
        for key, (x, evaluations) in results.items()
    ]


def together(case: Case, rounds: int, number: int = TOGETHER) -> list[Timing]:
    """The share of one fit in many at once, from the closed form of the first; that first one is judged."""
    problem, rng = case.problem, np.random.default_rng(2)
    start = find_start(problem, {}).x
    sigma = np.concatenate([block.sigma for block in problem.blocks])
    own = np.concatenate([block.measured for block in problem.blocks])
    noise = rng.normal(size=(number, sigma.size)) + 1j * rng.normal(size=(number, sigma.size))
    measured = np.concatenate(problem.predict(case.optimum)) + sigma * noise
    measured[0] = own
    timings = []
    for accelerate, name in ((False, "NumPy"), (True, "compiled by numba")):
        found = batch_fit(problem, measured, start, accelerate=accelerate)
        if not found.converged.all():
            raise RuntimeError(f"{(~found.converged).sum()} of {number} fits did not converge")
        seconds = []
        for _ in range(max(3, rounds // 20)):
            begin = time.process_time()
            batch_fit(problem, measured, start, accelerate=accelerate)
            seconds.append((time.process_time() - begin) / number)
        entry = f"rotorfit, one of {number}, {name}", "closed form, given"
        timings.append(
            Timing(*entry, 1e3 * float(np.median(seconds)), 1e3 * min(seconds), None, case.distance(found.x[0]))
        )
    return timings


def cold(case: Case, rounds: int) -> list[Timing]:
    """Fresh processes, in turns; the bare interpreter with NumPy stands beside them."""
    test = case.test
    columns: dict[str, Any] = {
        name: getattr(test, name)
        for name in ("run", "speed", "frequency", "force_plane", "force", "plane", "direction", "response", "sigma")
    }
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = Path(folder) / "test.npz", Path(folder) / "arrays.npz"
        np.savez(ours, **columns | case.known)
        np.savez(theirs, **case.arrays, names=np.array(case.problem.space.names), start=case.typical)
        rival = str(Path(lmfit_rival.__file__))
        commands = {
            ("lmfit, fresh process", "typical values"): [sys.executable, rival, str(theirs)],
            ("rf.fit, fresh process", "closed form, included"): [sys.executable, "-c", COLD, str(ours)],
            ("interpreter and NumPy alone", "-"): [sys.executable, "-c", "import numpy"],
        }
        seconds: dict[tuple[str, str], list[float]] = {key: [] for key in commands}
        answers: dict[tuple[str, str], str] = {}
        for _ in range(rounds):
            for key, command in commands.items():
                before = os.times()
                answers[key] = subprocess.run(command, check=True, capture_output=True, text=True).stdout
                after = os.times()
                seconds[key].append(
                    after.children_user + after.children_system - before.children_user - before.children_system
                )
    timings = []
    for key, answer in answers.items():
        x = np.array(answer.split(), dtype=float)
        distance = case.distance(x) if x.size else float("nan")
        timings.append(Timing(*key, 1e3 * float(np.median(seconds[key])), 1e3 * min(seconds[key]), None, distance))
    return timings


# ---- output -------------------------------------------------------------------------------------------------


def report(timings: Sequence[Timing], command: str) -> str:
    def cells(timing: Timing) -> list[str]:
        evaluations = "-" if timing.evaluations is None else str(timing.evaluations)
        distance = "-" if np.isnan(timing.distance) else f"{timing.distance:.1e}"
        return [timing.contender, timing.start, f"{timing.ms:.3g}", f"{timing.fastest_ms:.3g}", evaluations, distance]

    times = {(timing.contender, timing.start): timing.ms for timing in timings}
    guess, included = "typical values", "closed form, included"
    ratios = {
        "engine over lmfit, both from typical values": ("rotorfit engine", guess, "lmfit", guess),
        "engine over lmfit, both from the closed form": (
            "rotorfit engine", "closed form, given", "lmfit", "closed form, given",
        ),
        "engine with its closed form over lmfit from typical values": ("rotorfit engine", included, "lmfit", guess),
        "the whole of rf.fit over lmfit from typical values": (
            "rf.fit, from the experiment to the result", included, "lmfit", guess,
        ),
        "rf.fit of an experiment met before over lmfit from typical values": (
            "rf.fit, of an experiment met before", "closed form, kept", "lmfit", guess,
        ),
        f"one of {TOGETHER} with NumPy over lmfit from typical values": (
            f"rotorfit, one of {TOGETHER}, NumPy", "closed form, given", "lmfit", guess,
        ),
        f"one of {TOGETHER} compiled over lmfit from typical values": (
            f"rotorfit, one of {TOGETHER}, compiled by numba", "closed form, given", "lmfit", guess,
        ),
        f"one of {TOGETHER} compiled over lmfit, both from the closed form": (
            f"rotorfit, one of {TOGETHER}, compiled by numba", "closed form, given", "lmfit", "closed form, given",
        ),
        "fresh processes": ("rf.fit, fresh process", included, "lmfit, fresh process", guess),
    }  # fmt: skip
    lines = [
        "# Time of one fit",
        "",
        f"Made by `{command}` on {environment('numpy', 'scipy', 'casadi', 'lmfit')}.",
        "",
        *(__doc__ or "").splitlines()[2:8],
        "",
        *table(
            ["what is timed", "start", "ms, median", "ms, fastest", "evaluations", "distance / standard errors"],
            [cells(timing) for timing in timings],
        ),
        "",
        *table(
            ["speed ratio (above 1: rotorfit is faster)", "times"],
            [[what, f"{times[c, d] / times[a, b]:.2g}"] for what, (a, b, c, d) in ratios.items()],
        ),
    ]
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--lines", type=int, default=LINES)
    parser.add_argument("--rounds", type=int, default=100)
    parser.add_argument("--cold-rounds", type=int, default=7)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(words)
    command = shlex.join(["python", "benchmarks/fit_speed.py", *words])
    case = make_case(options.lines)
    timings = warm(case, options.rounds) + together(case, options.rounds) + cold(case, options.cold_rounds)
    text = report(timings, command)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "fit_speed.md").write_text(text, encoding="utf-8")
    write_csv(timings, options.out / "fit_speed.csv", command, environment("numpy", "scipy", "casadi", "lmfit"))
    print(text, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
