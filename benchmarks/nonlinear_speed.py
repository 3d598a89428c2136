"""Time of fits and posteriors of nonlinear rotors: sweeps of force levels, alone and joined with other tests.

A sweep is 440 complex readings of one mode with Muszynska's law, four force levels, orbits up to 0.68 of the clearance,
1 % noise, eight free parameters; "heavier" is the same with masses, stiffness, damping and forces four times as large,
further from typical values. Beside rotorfit stands lmfit with a residual that solves the orbits of all readings at
once in NumPy (nonlinear_rival.py), from typical values; rotorfit has no start given. lmfit knows no causes beside the
model, as "rf.fit(causes=None)"; "rf.fit" solves them too. Times are processor times, medians
over rounds in which all contenders take turns; distances are from the exact optimum, in standard errors. "Misfit" fits
a law with which no start explains the data. Effective samples are ArviZ's bulk ESS of the worst parameter over the time
of all of `fit.sample` at its defaults with fixed noise; its means and standard deviations are held against importance
sampling with the rival's residual, or with the cost of the fit's problem where tests are joined.

    python benchmarks/nonlinear_speed.py
"""

from __future__ import annotations

import argparse
import cProfile
import os
import pstats
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "tests" / "rigs")]  # the formulas live with the tests

import nonlinear_rival  # noqa: E402
from fit_speed import exact_optimum  # noqa: E402
from law_data import CLEARANCE, CLEARANCE_UM, LIGHT, ONE_MODE, impulse, off_centre, squeeze, static, sweep  # noqa: E402
from posterior_speed import bulk_ess  # noqa: E402
from reporting import RESULTS, environment, table, write_csv  # noqa: E402

import rotorfit as rf  # noqa: E402
from rotorfit.base.array_types import Float  # noqa: E402
from rotorfit.estimators.misfit.problem import Problem  # noqa: E402
from rotorfit.identify.fitting.problem_setup import build_problem  # noqa: E402
from rotorfit.identify.fitting.settings import FitSettings  # noqa: E402
from rotorfit.lab.data.rows import Experiment  # noqa: E402

LEVELS = (0.7, 1.8, 3.4, 5.2)
HEAVIER = {n: v * (4.0 if n in ("M", "K", "Ds", "K0", "D", "Mf") else 1.0) for n, v in ONE_MODE.items()}
KNOWN = ("K", "Ds")
LAW = rf.models.Muszynska()
PLAIN, JOINT = "rf.fit(causes=None)", "rf.fit"
PACKAGES = ("numpy", "scipy", "casadi", "lmfit", "emcee", "numba")


@dataclass(frozen=True, eq=False)
class Case:
    """Tests, the model fitted to them and what is known.

    Attributes:
        arrays: what the rival takes, of a sweep alone.
    """

    name: str
    model: rf.models.RotorModel
    tests: list[Experiment]
    known: dict[str, float]
    arrays: dict[str, Any] | None = None

    @property
    def problem(self) -> Problem:
        return build_problem(self.model, self.tests, FitSettings(known=self.known))

    def fit(self) -> rf.FitResult:
        """The fit that the rival's is, without causes beside the model."""
        return rf.fit(self.model, self.tests, known=self.known, causes=None)

    def fit_with_causes(self) -> rf.FitResult:
        return rf.fit(self.model, self.tests, known=self.known)


@dataclass(frozen=True)
class FitRow:
    """One way of fitting one case.

    Attributes:
        ms, fastest_ms: median and best time.
        distance: largest distance of a parameter from the exact optimum, standard errors.
    """

    data: str
    readings: int
    contender: str
    ms: float
    fastest_ms: float
    distance: float


@dataclass(frozen=True)
class PosteriorRow:
    """One posterior; see the module.

    Attributes:
        first_seconds: of the first run, compiling (or machine code from disk) included.
        mean_off, sd_off: largest distance from the reference over the parameters, in standard deviations and as a
            fraction.
        expected: what Monte Carlo error makes of ``mean_off``, 99 % point of the largest of ten.
    """

    data: str
    likelihood: str
    first_seconds: float
    seconds: float
    ess: float
    rate: float
    us_per_vector: float
    mean_off: float
    sd_off: float
    expected: float


def cases() -> list[Case]:
    one = rf.models.OneMode(law=LAW, clearance_um=CLEARANCE_UM)
    swept = sweep(ONE_MODE, levels=LEVELS, lines=110, top=270.0)
    known = {name: ONE_MODE[name] for name in KNOWN}
    heavier = sweep(HEAVIER, levels=[4 * level for level in LEVELS], lines=110, top=270.0)
    light = sweep(LIGHT, levels=(0.5, 1.4, 2.8, 4.5), lines=110)
    own = {name: LIGHT[name] for name in KNOWN}
    parabola = rf.models.OneMode(law=rf.models.EvenPolynomial(1), clearance_um=CLEARANCE_UM)
    return [
        _with_arrays(Case("sweep", one, [swept], known)),
        _with_arrays(Case("sweep, heavier", one, [heavier], {name: HEAVIER[name] for name in KNOWN})),
        Case("sweep, misfit", parabola, [swept], known),
        Case("sweep, static loads", one, [light, static(LIGHT)], own),
        Case("sweep, impulses", one, [light, impulse(LIGHT)], own),
        Case("sweep, off-centre", one, [light, off_centre(LIGHT)], own),
        Case("sweep, static, impulses, squeeze film, off-centre", one,
             [light, static(LIGHT), impulse(LIGHT), squeeze(LIGHT), off_centre(LIGHT)], own),
    ]  # fmt: skip


def _with_arrays(case: Case) -> Case:
    block: Any = case.problem.blocks[0]
    base, line = block.base, block.base.line
    arrays = {
        "w": base.frequency[line], "speed": base.speed[line], "force": base.force[line, 0].real, "known": case.known,
        "clearance": CLEARANCE, "eps": block.eccentricity[0, line], "measured": block.measured,
        "weight": 1 / block.sigma,
    }  # fmt: skip
    return Case(case.name, case.model, case.tests, case.known, arrays)


def typical(case: Case) -> dict[str, float]:
    """What one types where there is no closed form: the model's table, and the law's own start."""
    values = {q.name: q.scale for q in case.model.parameters if q.name not in case.known}
    return values | LAW.start(values["K0"], values["D"])


# ---- fits --------------------------------------------------------------------------------------------------------


def time_fits(case: Case, rounds: int) -> list[FitRow]:
    optimum, stderr = exact_optimum(case.problem)
    contenders: dict[str, Callable[[], Float]] = {
        PLAIN: lambda: case.fit().x,
        JOINT: lambda: case.fit_with_causes().x,
    }
    arrays = case.arrays
    if arrays is not None:
        begin = typical(case)

        def rival() -> Float:
            found = nonlinear_rival.fit(arrays, begin).params
            return np.array([found[name].value for name in case.problem.space.names])

        contenders["lmfit"] = rival
    found = {name: run() for name, run in contenders.items()}
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, run in contenders.items():
            start = time.process_time()
            run()
            seconds[name].append(time.process_time() - start)
    return [
        FitRow(
            case.name,
            case.problem.n_data // 2,
            name,
            1e3 * float(np.median(seconds[name])),
            1e3 * min(seconds[name]),
            float(np.max(np.abs((found[name] - optimum) / stderr))) if name != JOINT else np.nan,
        )
        for name in contenders
    ]


# ---- posteriors --------------------------------------------------------------------------------------------------


def log_density(case: Case, problem: Problem) -> Callable[[Float], float]:
    """By the rival's formulas where it has them, else by the fit's own problem."""
    arrays = case.arrays
    if arrays is None:
        return lambda x: -problem.cost(x)
    names = problem.space.names

    def by_hand(x: Float) -> float:
        p = dict(zip(names, x.tolist(), strict=True)) | case.known
        miss = (nonlinear_rival.response(p, arrays) - arrays["measured"]) * arrays["weight"]
        return -0.5 * float(np.vdot(miss, miss).real)

    return by_hand


def reference(case: Case, fit: rf.FitResult, draws: int) -> tuple[Float, Float, float]:
    """Means, standard deviations and effective size by self-normalised importance sampling."""
    from scipy.stats import multivariate_t

    scale = np.sqrt(np.diag(fit.covar))
    proposal = multivariate_t(np.zeros(fit.x.size), fit.covar / np.outer(scale, scale), df=6)
    z = proposal.rvs(draws, random_state=11)
    density = log_density(case, fit.problem)
    log_weight = np.array([density(x) for x in fit.x + z * scale]) - proposal.logpdf(z)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    mean = weight @ z
    sd = np.sqrt(weight @ (z - mean) ** 2)
    return fit.x + mean * scale, sd * scale, float(1 / (weight**2).sum())


def time_posteriors(case: Case, rounds: int, ess: float, draws: int) -> list[PosteriorRow]:
    fit = case.fit()
    mean, sd, size = reference(case, fit, draws)
    rows = []
    for accelerate, words in ((False, "NumPy"), (True, "numba")):
        seconds, sizes, chains = [], [], []
        for number in range(rounds + 1):
            begin = time.process_time()
            posterior = fit.sample(noise="fixed", ess=ess, seed=number, accelerate=accelerate)
            seconds.append(time.process_time() - begin)
            if not posterior.converged:
                raise RuntimeError(f"{case.name}: {posterior.message}")
            chains.append(posterior.samples)
            sizes.append(bulk_ess(posterior.chain.transpose(1, 0, 2)))
        flat = np.concatenate(chains[1:])
        rates = np.array(sizes[1:]) / np.array(seconds[1:])
        rows.append(
            PosteriorRow(
                case.name,
                words,
                seconds[0],
                float(np.median(seconds[1:])),
                float(np.median(sizes[1:])),
                float(np.median(rates)),
                1e6 * _per_vector(fit, posterior.samples, accelerate),
                float(np.max(np.abs(flat.mean(axis=0) - mean) / sd)),
                float(np.max(np.abs(flat.std(axis=0) / sd - 1))),
                3.3 * float(np.sqrt(1 / sum(sizes[1:]) + 1 / size)),
            )
        )
        print(rows[-1], flush=True)
    return rows


def _per_vector(fit: rf.FitResult, samples: Float, accelerate: bool) -> float:
    """Seconds of one log density among 64 at once, what half an ensemble proposes."""
    from rotorfit.estimators.inference.log_posterior import LogPosterior

    target = LogPosterior(fit.problem, "fixed", accelerate=accelerate)
    chosen = samples[:: max(1, len(samples) // 64)][:64]
    target(chosen)
    seconds = []
    for _ in range(5):
        begin = time.process_time()
        target(chosen)
        seconds.append(time.process_time() - begin)
    return float(np.median(seconds)) / len(chosen)


def profile(case: Case, ess: float) -> list[str]:
    """Where the time of a fit and of a posterior goes: functions by their own time, as Markdown."""
    fit = case.fit()
    lines = []
    for title, run in (
        ("fit", case.fit),
        ("posterior, NumPy", lambda: fit.sample(noise="fixed", ess=ess, seed=1, accelerate=False)),
    ):
        profiler = cProfile.Profile()
        profiler.enable()
        run()
        profiler.disable()
        stats: Any = pstats.Stats(profiler)
        rows = sorted(stats.stats.items(), key=lambda item: -item[1][2])
        total = sum(row[2] for _, row in rows)
        cells = [
            [f"{Path(file).stem}.{function}" if file != "~" else function, str(calls), f"{100 * own / total:.0f}",
             f"{100 * whole / total:.0f}"]
            for (file, _, function), (_, calls, own, whole, _) in rows[:8]
        ]  # fmt: skip
        head = ["function", "calls", "own time, %", "with what it calls, %"]
        lines += ["", f"Profile, {case.name}, {title}:", "", *table(head, cells)]
    return lines


# ---- output ------------------------------------------------------------------------------------------------------


def report(fits: Sequence[FitRow], posteriors: Sequence[PosteriorRow], profiles: Sequence[str], command: str) -> str:
    doc = (__doc__ or "").splitlines()
    fit_cells = [
        [
            r.data,
            str(r.readings),
            r.contender,
            f"{r.ms:.3g}",
            f"{r.fastest_ms:.3g}",
            "" if np.isnan(r.distance) else f"{r.distance:.1e}",
        ]
        for r in fits
    ]
    times = {(r.data, r.contender): r.ms for r in fits}
    ratios = [
        [d, *(f"{times[d, 'lmfit'] / times[d, who]:.2g}" for who in (PLAIN, JOINT))]
        for d, who in times
        if who == "lmfit"
    ]
    posterior_cells = [
        [r.data, r.likelihood, f"{r.first_seconds:.3g}", f"{r.seconds:.3g}", f"{r.ess:,.0f}", f"{r.rate:,.0f}",
         f"{r.us_per_vector:.0f}", f"{r.mean_off:.3f} ({r.expected:.3f})", f"{100 * r.sd_off:.1f}"]
        for r in posteriors
    ]  # fmt: skip
    lines = ["# Speed of nonlinear fits and posteriors", "", f"Made by `{command}` on {environment(*PACKAGES)}.", ""]
    lines += [*doc[2 : doc.index("    python benchmarks/nonlinear_speed.py") - 1], ""]
    header = ["data", "readings", "what is timed", "ms, median", "ms, fastest", "distance / standard errors"]
    lines += [*table(header, fit_cells), ""]
    lines += [*table(["times of lmfit over those of (above 1: rotorfit is faster)", PLAIN, JOINT], ratios), ""]
    header = ["data", "likelihood", "s, first run", "s", "ESS", "ESS per s", "us a vector",
              "mean off / sd (99 % of chance)", "sd off, %"]  # fmt: skip
    lines += [*table(header, posterior_cells)]
    return "\n".join([*lines, *profiles]) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--posterior-rounds", type=int, default=2)
    parser.add_argument("--ess", type=float, default=4000.0)
    parser.add_argument("--draws", type=int, default=6000, help="of the reference")
    parser.add_argument("--case", action="append", help="only these, by number")
    parser.add_argument("--skip-posteriors", action="store_true")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(words)
    if hasattr(os, "sched_setaffinity"):  # threads of libraries would count several times
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    command = shlex.join(["python", "benchmarks/nonlinear_speed.py", *words])
    chosen = [case for number, case in enumerate(cases()) if not options.case or str(number) in options.case]
    fits: list[FitRow] = []
    posteriors: list[PosteriorRow] = []
    profiles: list[str] = []
    for case in chosen:
        fits += time_fits(case, options.rounds)
        print(fits[-1], flush=True)
        if options.skip_posteriors or case.name == "sweep, misfit":
            continue
        posteriors += time_posteriors(case, options.posterior_rounds, options.ess, options.draws)
        if case in (chosen[0], chosen[-1]):
            profiles += profile(case, options.ess)
    text = report(fits, posteriors, profiles, command)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "nonlinear_speed.md").write_text(text, encoding="utf-8")
    write_csv(fits, options.out / "nonlinear_speed.csv", command, environment(*PACKAGES))
    print(text, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
