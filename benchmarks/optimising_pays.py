"""Where optimising pays against the closed form: one rotor in tests of many kinds, errors and intervals of both.

Each test is made with known values and noise of its own, on the rigs of ``rigs.py``, and identified by
``rf.closed_form``, by ``rf.fit(causes=None)`` and, where causes act, by ``rf.fit`` with its causes.

    python benchmarks/optimising_pays.py
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from reporting import RESULTS, environment, table
from rigs import RIGS

import rotorfit as rf
from rotorfit.base.array_types import Float
from rotorfit.estimators.starting.closed_form import ClosedFormError
from rotorfit.models import Muszynska, OneMode, RotorModel, TwoDisk

LEVEL = 0.95
PAPER, CLOSED, PLAIN, JOINT = "closed form, unweighted", "closed form, weighted", "optimised", "optimised with causes"
GAINS = 0.01  # standard deviation of the factors of probes and of the force where causes act
SPEEDS = 0.002  # and of the speed's


@dataclass(frozen=True, kw_only=True)
class Situation:
    """A kind of test of one rotor."""

    name: str
    model: RotorModel
    truth: Mapping[str, float]
    made: Callable[[np.random.Generator], rf.PerturbationTest]
    known: Mapping[str, float | None]
    caused: bool = False  # whether causes beside the model act


@dataclass(frozen=True, kw_only=True)
class Pay:
    """What an estimator made of a situation; errors over those of the optimised estimate."""

    situation: str
    estimator: str
    rmse: float  # median over the parameters
    worst: float  # the worst parameter's
    covered: float  # share of 95 % intervals that hold the truth, %
    milliseconds: float  # processor time of an estimate
    draws: int
    failures: int


def situations() -> list[Situation]:
    whirl = RIGS["whirl-whip"]
    told = {name: whirl.truth[name] for name in whirl.known}

    def of(name: str, lines: int, level: float, change: Callable[..., rf.PerturbationTest] | None = None, **more: Any):
        def made(rng: np.random.Generator) -> rf.PerturbationTest:
            test = whirl.test(lines, level, rng)
            return test if change is None else change(test, rng)

        return Situation(name=name, model=whirl.model, truth=whirl.truth, made=made, known=told, **more)

    return [
        of("all planes forced and read, 100 lines, 1 % noise", 100, 0.01),
        of("10 % noise", 100, 0.1),
        of("few lines: 12", 12, 0.01),
        of("few lines: 12, 10 % noise", 12, 0.1),
        of("noise in proportion to each reading, 3 %, not told", 100, 1e-9, _proportional),
        of("a plane without a probe: the disk", 100, 0.01, _journal_alone),
        of("forced at the journal alone", 100, 0.01, _forced_at_journal),
        _free_factors("a factor of a probe free (beta2)", {"outboard": 0.95}, ()),
        _free_factors("a gain of all probes free, a disk weighed", {"inboard": 0.95, "outboard": 0.95}, ("M1",)),
        _law(),
        of("gains of 1 %, speeds of 0.2 % off", 100, 0.003, _with_causes, caused=True),
    ]


def _proportional(test: rf.PerturbationTest, rng: np.random.Generator) -> rf.PerturbationTest:
    noise = 0.03 * np.abs(test.response) * (rng.normal(size=(2, test.run.size)).T @ [1, 1j])
    return replace(test, response=test.response + noise, sigma=np.full(test.run.size, np.nan))


def _journal_alone(test: rf.PerturbationTest, rng: np.random.Generator) -> rf.PerturbationTest:
    return test.select(test.plane == "journal")


def _forced_at_journal(test: rf.PerturbationTest, rng: np.random.Generator) -> rf.PerturbationTest:
    return test.select(test.force_plane == "journal")


def _with_causes(test: rf.PerturbationTest, rng: np.random.Generator) -> rf.PerturbationTest:
    """Two probes and the force by a factor each, and the speed that was noted."""
    disk, journal, force = 1 + GAINS * rng.normal(size=3)
    factor = np.where(test.plane == "disk", disk, journal)
    return replace(
        test,
        response=factor * test.response,
        sigma=factor * test.sigma,
        force=force * test.force,
        speed=test.speed * (1 + SPEEDS * rng.normal()),
    )


def _free_factors(name: str, factor: Mapping[str, float], told: Sequence[str]) -> Situation:
    """Probes that read low, their factors fitted; what is told fixes the scale where all of them are."""
    two = RIGS["two-disk"]
    names = {plane: f"beta{place}" for place, plane in enumerate(two.model.planes, 1)}
    truth = {**two.truth, **{names[plane]: value for plane, value in factor.items()}}

    def made(rng: np.random.Generator) -> rf.PerturbationTest:
        test = two.test(100, 0.01, rng)
        scale = np.array([factor.get(plane, 1.0) for plane in test.plane.tolist()])
        return replace(test, response=scale * test.response, sigma=scale * test.sigma)

    known: dict[str, float | None] = {beta: None if plane in factor else 1.0 for plane, beta in names.items()}
    known |= {parameter: truth[parameter] for parameter in told}
    return Situation(name=name, model=TwoDisk(), truth=truth, made=made, known=known)


LAW_RIG = OneMode(law=Muszynska(), clearance_um=200)
LAW_TRUTH = {**RIGS["one-mode"].truth, "n_K": 1.5, "n_D": 1.0, "b": 0.4}


@cache
def _sweeps_with_law() -> rf.PerturbationTest:
    """Integrated in time, without noise."""
    rpm = np.r_[-2000:-199:225, 200:2001:225].tolist()
    forces = {"speed_rpm": [1200, 1600], "frequency_rpm": rpm, "force": [0.2, 1.0, 2.0]}
    return rf.simulate(LAW_RIG, LAW_TRUTH, **forces, noise=0.0)


def _law() -> Situation:
    def made(rng: np.random.Generator) -> rf.PerturbationTest:
        exact = _sweeps_with_law()
        sigma = 0.01 * float(np.sqrt(np.mean(np.abs(exact.response) ** 2)))
        noise = sigma * (rng.normal(size=(2, exact.run.size)).T @ [1, 1j])
        return replace(exact, response=exact.response + noise, sigma=np.full(exact.run.size, sigma))

    known = {name: LAW_TRUTH[name] for name in ("K", "Ds")}
    name = "a law of eccentricity, orbits up to half"
    return Situation(name=name, model=LAW_RIG, truth=LAW_TRUTH, made=made, known=known)


def _estimate(estimator: str, case: Situation, test: rf.PerturbationTest) -> rf.FitResult:
    if estimator in (PAPER, CLOSED):
        return rf.closed_form(case.model, test, known=case.known, weighted=estimator == CLOSED)
    if estimator == PLAIN:
        return rf.fit(case.model, test, known=case.known, causes=None)
    return rf.fit(case.model, test, known=case.known)


def study_pay(case: Situation, draws: int, seed: int) -> list[Pay]:
    """What each estimator makes of draws of a situation; the closed form may be refused in all."""
    rng, found = np.random.default_rng(seed), {}
    tests = [case.made(rng) for _ in range(draws)]
    for estimator in (PAPER, CLOSED, PLAIN, *([JOINT] if case.caused else [])):
        errors, inside, failures, begun = [], [], 0, time.process_time()
        for test in tests:
            try:
                fit = _estimate(estimator, case, test)
            except ClosedFormError:
                failures += 1
                continue
            names = [name for name in case.truth if fit.params[name].vary]
            errors.append([fit.params[name].value - case.truth[name] for name in names])
            if estimator == PAPER:  # which has no errors
                continue
            spans = [fit.interval(name, level=LEVEL) for name in names]
            inside.append([low < case.truth[n] < high for n, (low, high) in zip(names, spans, strict=True)])
        elapsed = 1000 * (time.process_time() - begun) / draws
        found[estimator] = np.array(errors), np.array(inside), elapsed, failures
    unit = _rms(found[PLAIN][0])
    rows = []
    for estimator, (errors, inside, elapsed, failures) in found.items():
        share = _rms(errors) / unit if len(errors) else np.array([np.nan])
        rows.append(
            Pay(
                situation=case.name,
                estimator=estimator,
                rmse=float(np.median(share)),
                worst=float(share.max()),
                covered=100 * float(inside.mean()) if inside.size else np.nan,
                milliseconds=elapsed,
                draws=draws,
                failures=failures,
            )
        )
    return rows


def _rms(errors: Float) -> Float:
    return np.asarray(np.sqrt(np.mean(np.square(errors), axis=0)))


def pay_table(rows: Sequence[Pay], command: str) -> str:
    """The results as Markdown."""
    cells = []
    for row in rows:
        ratio = f"{row.rmse:.2f} ({row.worst:.2f})"
        covered = "" if np.isnan(row.covered) else f"{row.covered:.1f} %"
        numbers = [ratio, covered] if row.failures < row.draws else ["none", ""]
        cells.append([row.situation, row.estimator, *numbers, f"{row.milliseconds:.0f}", str(row.failures)])
    lines = [
        "# Where optimising pays",
        "",
        f"Made by `{command}` ({environment('numpy', 'scipy', 'casadi')}).",
        "",
        f"{rows[0].draws} draws of each kind of test, through `rf.closed_form` and `rf.fit(causes=None)`; where causes "
        "act, through `rf.fit` with its causes too. RMSE over that of the optimised estimate, median over the "
        "parameters and, in brackets, the worst; how many of the estimator's own 95 % intervals hold the truth; "
        "processor time of an estimate with its errors, ms; draws without an estimate. The rotor is whirl-whip, that "
        "of the law one-mode, that of the factors two-disk.",
        "",
        *table(["test", "estimator", "RMSE", "covered", "ms", "none"], cells),
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    rows: list[Pay] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rf.DataWarning)
        for seed, case in enumerate(situations()):
            rows += study_pay(case, options.draws, seed)
            print(f"{case.name}: {rows[-1].covered:.1f} % covered", flush=True)
    command = " ".join(["python benchmarks/optimising_pays.py", *sys.argv[1:]])
    (options.out / "optimising_pays.md").write_text(pay_table(rows, command), encoding="utf-8")


if __name__ == "__main__":
    main()
