"""What error bars cost: time of each way beside that of the evaluations it needs, and accuracy beside both.

Eq. (18), ten free parameters, four responses of 400 lines, 1 % noise: one fit, then what its result offers. Evaluations
are parameter vectors for which the misfit (posterior), the misfit with its gradient (bootstrap) or with the
Gauss-Newton matrix (the others) is found; "in them" is the share of the processor time spent there, the rest being
random numbers, eigenvalues, judgement and Python. "Interpreter" and "calls" are shares of samples of the processor: in
Python itself, and in what NumPy does for a call besides its loops over elements (`time_shares.py`). The limit is what
the evaluations take as compiled code: kernels as measured here, and for a matrix the product of the derivatives by BLAS
on top. Warm: kernels loaded, medians over rounds; "first" is the first call in a process, with imports, kernels and the
equations of new variants of the model. Profiles are checked by SciPy's SLSQP with the quantity held at each end,
budgets by fits of readings moved by one standard deviation of each calibration, candidates by Newton's step with the
exact Hessian where the data determine all parameters.

    python benchmarks/uncertainty_speed.py
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

sys.path.insert(0, str(Path(__file__).parent))
from fit_speed import Case, make_case
from reporting import RESULTS, environment, table, write_csv
from time_shares import library_shares, python_shares

import rotorfit as rf
from rotorfit.base.array_types import Float
from rotorfit.estimators.misfit.kernels import Batch
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models import threshold_speed

Check = Callable[[Any], str]

PACKAGES = ("numpy", "scipy", "emcee", "numba")
ENGINE = {
    "misfit": (Batch, "channel_sums"), "gradient": (Batch, "cost_and_gradient"), "matrix": (Problem, "evaluate"),
    "cost": (Problem, "costs"), "residuals": (Problem, "residuals"), "hessian": (Problem, "hessian"),
}  # fmt: skip
GAIN, PHASE = 0.01, 0.5
"""Standard uncertainties of the probes' gains (relative) and phases (degrees) of the budget."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One way to an error bar, medians over the rounds.

    Attributes:
        what, unit: what was done, and what is counted.
        units: how many of them.
        ms, first_ms: time of one, and where nothing has been called before.
        evaluations: parameter vectors for one.
        inside, interpreter, calls: shares of the time spent in evaluations, in Python itself, and in calls of NumPy.
        limit_ms: what these evaluations take as compiled code.
        accuracy: in words.
    """

    what: str
    unit: str
    units: float
    ms: float
    first_ms: float
    evaluations: float
    inside: float
    interpreter: float
    calls: float
    limit_ms: float
    accuracy: str


# ---- evaluations counted ------------------------------------------------------------------------------------------


@dataclass
class Meter:
    """Parameter vectors evaluated by kind, and the time spent on them."""

    counts: dict[str, int]
    seconds: float = 0.0
    depth: int = 0


@contextmanager
def metered() -> Iterator[Meter]:
    """Count evaluations while the block runs; one inside another counts once."""
    meter = Meter(dict.fromkeys(ENGINE, 0))
    originals = {kind: getattr(owner, name) for kind, (owner, name) in ENGINE.items()}

    def counted(kind: str) -> Any:
        def call(self: Any, x: Float, *rest: Any, **options: Any) -> Any:
            meter.depth += 1
            begin = time.process_time()
            try:
                return originals[kind](self, x, *rest, **options)
            finally:
                meter.depth -= 1
                if not meter.depth:
                    meter.seconds += time.process_time() - begin
                    meter.counts[kind] += 1 if x.ndim == 1 else len(x)

        return call

    for kind, (owner, name) in ENGINE.items():
        setattr(owner, name, counted(kind))
    try:
        yield meter
    finally:
        for kind, (owner, name) in ENGINE.items():
            setattr(owner, name, originals[kind])


def seconds_of(run: Callable[[], object], rounds: int = 20) -> float:
    """Median processor time."""
    spent = []
    for _ in range(rounds):
        begin = time.process_time()
        run()
        spent.append(time.process_time() - begin)
    return float(np.median(spent))


def limits(case: Case) -> dict[str, float]:
    """Seconds of one evaluation of each kind as compiled code."""
    batch, x = Batch(case.problem, accelerate=True), np.tile(case.optimum, (500, 1))
    batch.channel_sums(x), batch.cost_and_gradient(x)
    misfit = seconds_of(lambda: batch.channel_sums(x)) / len(x)
    gradient = seconds_of(lambda: batch.cost_and_gradient(x)) / len(x)
    rows = np.random.default_rng(0).normal(size=(case.optimum.size, case.problem.n_data))
    matrix = gradient + seconds_of(lambda: [rows @ rows.T for _ in range(50)]) / 50
    hessian = 2 * case.optimum.size * gradient  # differences of gradients
    found = {"misfit": misfit, "gradient": gradient, "matrix": matrix}
    return {**found, "cost": misfit, "residuals": misfit, "hessian": hessian}


# ---- the ways --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Way:
    """One way to an error bar: what to run, how many units its result has, how to check it."""

    what: str
    unit: str
    run: Callable[[], Any]
    units: Callable[[Any], float]
    check: Check


def ways(case: Case, fit: rf.FitResult, size: float) -> list[Way]:
    """What a result offers, with lengths multiplied by ``size``."""
    names = fit.problem.space.names
    replicates = max(int(2000 * size), 50)
    return [
        Way(
            what="posterior, as `fit.sample()`",
            unit="effective sample",
            run=lambda: fit.sample(seed=1, noise="fixed"),
            units=lambda posterior: len(posterior.samples) / float(posterior.tau.max()),
            check=lambda posterior: spread_off(posterior.samples.std(axis=0), fit),
        ),
        Way(
            what=f"bootstrap of {replicates}",
            unit="replicate",
            run=lambda: fit.bootstrap(n=replicates, seed=1),
            units=lambda _: replicates,
            check=lambda found: spread_off(np.array(list(found.stderr.values())), fit),
        ),
        Way(
            what=f"profiles of {len(names)} parameters",
            unit="point",
            run=fit.profiles,
            units=lambda profiles: sum(p.values.size for p in profiles),
            check=lambda profiles: ends_off(fit, profiles),
        ),
        Way(
            what="profile of the threshold speed",
            unit="point",
            run=lambda: [fit.profile("threshold_speed")],
            units=lambda profiles: profiles[0].values.size,
            check=lambda profiles: ends_off(fit, profiles),
        ),
        Way(
            what="fit with causes, and its budget",
            unit="budget",
            run=lambda: rf.fit(fit.model, case.test, known=case.known).budget(),
            units=lambda _: 1,
            check=lambda budget: budget_off(case, fit, budget),
        ),
        Way(
            what="`rf.refine`",
            unit="candidate",
            run=lambda: rf.refine(fit),
            units=lambda refinement: len(refinement.steps) + 1,
            check=candidates_off,
        ),
    ]


def measure(way: Way, cost: dict[str, float], rounds: int) -> Row:
    """Time, evaluations and accuracy of one way."""
    begin = time.process_time()
    result = way.run()
    first = time.process_time() - begin
    units = way.units(result)
    spent = seconds_of(way.run, rounds)
    with metered() as meter:
        begin = time.process_time()
        way.run()
        whole = time.process_time() - begin
    interpreter, calls = python_shares(way.run)
    return Row(
        what=way.what,
        unit=way.unit,
        units=units,
        ms=1e3 * spent / units,
        first_ms=1e3 * first / units,
        evaluations=sum(meter.counts.values()) / units,
        inside=meter.seconds / whole,
        interpreter=interpreter,
        calls=calls,
        limit_ms=1e3 * sum(cost[kind] * count for kind, count in meter.counts.items()) / units,
        accuracy=way.check(result),
    )


# ---- checks ----------------------------------------------------------------------------------------------------------


def spread_off(spread: Float, fit: rf.FitResult) -> str:
    """Largest deviation from the standard errors of a fit whose posterior is nearly normal."""
    stderr = np.array([fit.params[name].stderr for name in fit.var_names])
    return f"spreads within {100 * np.abs(spread / stderr - 1).max():.1f} % of stderr"


def ends_off(fit: rf.FitResult, profiles: Sequence[rf.Profile]) -> str:
    """Rise of chi-squared at the ends over what it should be, by another optimiser."""
    problem, factor = fit.problem, np.linalg.cholesky(normalised(fit))
    scale = np.sqrt(np.diag(fit.covar))

    def place(z: Float) -> Float:
        return np.asarray(fit.x + scale * (factor @ z))

    off = []
    for profile in profiles:
        for end in profile.interval:
            found = minimize(
                lambda z: 2 * (problem.cost(place(z)) - problem.cost(fit.x)),
                np.zeros(fit.x.size),
                jac=lambda z: 2 * factor.T @ (scale * problem.gauss_newton(place(z))[1]),
                constraints={"type": "eq", "fun": lambda z, p=profile, e=end: held(fit, p, place(z)) / e - 1},
                method="SLSQP",
                options={"ftol": 1e-12, "maxiter": 200},
            )
            off.append(found.fun / (profile.goal * fit.widening) - 1)
    return f"rise at the ends within {max(np.abs(off)):.1g} of the level"


def normalised(fit: rf.FitResult) -> Float:
    scale = np.sqrt(np.diag(fit.covar))
    return np.asarray(fit.covar / np.outer(scale, scale))


def held(fit: rf.FitResult, profile: rf.Profile, x: Float) -> float:
    """The profiled quantity of a vector."""
    if profile.name in fit.var_names:
        return float(x[fit.var_names.index(profile.name)])
    onset = threshold_speed(fit.model, fit.problem.space.theta(x)[0])
    return float("inf") if onset is None else onset.speed


def budget_off(case: Case, fit: rf.FitResult, budget: rf.Budget) -> str:
    """Shift of every estimate when the readings of one plane are wrong by a known share, against the slope by it."""
    off = []
    for plane in fit.model.planes:
        wrong = np.where(case.test.plane == plane, 1 + GAIN, 1.0)
        test = replace(case.test, response=case.test.response * wrong)
        moved = rf.fit(fit.model, test, known=case.known, causes=None)
        for i, name in enumerate(fit.problem.space.names):
            row = budget[name]
            off.append(abs(abs(moved.x[i] - fit.x[i]) - GAIN * abs(row.slopes[f"gain[{plane}]"])) / row.stderr)
    return f"slopes by gains within {100 * max(off):.2g} % of the standard error"


def candidates_off(refinement: rf.Refinement) -> str:
    """Newton's step from each candidate's optimum, with the exact Hessian, in standard errors, where it is one."""
    off = []
    for candidate in refinement.steps:
        if candidate.identifiability.unresolved:
            continue
        size = np.sqrt(np.diag(candidate.covar))
        step = np.linalg.solve(
            candidate.problem.hessian(candidate.x) * np.outer(size, size),
            size * candidate.problem.gauss_newton(candidate.x)[1],
        )
        off.append(float(np.abs(step).max()))
    return f"optima within {max(off):.1g} standard errors"


# ---- output ------------------------------------------------------------------------------------------------------


def markdown(rows: Sequence[Row], cost: dict[str, float], shares: str, command: str) -> str:
    cells = [
        [
            row.what, row.unit, f"{row.units:,.0f}", f"{row.ms:.3g}", f"{row.first_ms:.3g}", f"{row.evaluations:.3g}",
            *(f"{100 * share:.0f}" for share in (row.inside, row.interpreter, row.calls)), f"{row.limit_ms:.2g}",
            row.accuracy,
        ]
        for row in rows
    ]  # fmt: skip
    header = ["way", "unit", "units", "ms a unit", "first", "evaluations a unit", "in them, %"]
    header += ["interpreter, %", "calls, %", "limit, ms a unit", "accuracy"]
    kinds = ", ".join(f"{name} {1e6 * cost[kind]:.2g} us" for name, kind in KINDS.items())
    lines = ["# Cost of error bars", "", f"Made by `{command}` on {environment(*PACKAGES)}.", ""]
    lines += [*(__doc__ or "").splitlines()[2:12], "", *table(header, cells), "", f"Limits of one evaluation: {kinds}."]
    lines += ["", f"The posterior's time by who asked for the work: {shares}."]
    return "\n".join(lines) + "\n"


KINDS = {"misfit": "misfit", "with its gradient": "gradient", "with the Gauss-Newton matrix": "matrix"}


def main(arguments: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--lines", type=int, default=400)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--size", type=float, default=1.0, help="multiplies the number of replicates")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(words)
    if hasattr(os, "sched_setaffinity"):  # threads of libraries would count several times
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    command = shlex.join(["python", "benchmarks/uncertainty_speed.py", *words])
    case = make_case(options.lines)
    fit = rf.fit(case.problem.space.model, case.test, known=case.known, causes=None)
    cost = limits(case)
    rows = []
    for way in ways(case, fit, options.size):
        rows.append(measure(way, cost, options.rounds))
        print(rows[-1], flush=True)
    asked = library_shares(lambda: fit.sample(seed=1, noise="fixed"), "Batch.channel_sums")
    shares = ", ".join(f"{owner} {100 * share:.0f} %" for owner, share in asked.items())
    text = markdown(rows, cost, shares.replace("Batch.channel_sums", "the likelihood"), command)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "uncertainty_speed.md").write_text(text, encoding="utf-8")
    write_csv(rows, options.out / "uncertainty_speed.csv", command, environment(*PACKAGES))
    print(text, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
