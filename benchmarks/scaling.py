"""Cost of identification against the number of lines (10^2 to 10^6) and of planes (2 to 20).

Lines: eq. (18), forces at both planes, both probes, so that a sweep of N lines has 4 N readings. Planes: a chain of n
masses (eqs 24 to 26) with a circular force at every plane and probes at all, 3 n + 1 parameters and 40 n^2 readings.
Times are processor times, the best of some repeats: of one evaluation of cost, gradient and Gauss-Newton matrix, of the
inversion of the measured response matrices alone (eq. 7), of the weighted closed form, and of a fit with its start.
Peak memory is what Python and NumPy hold in a fit beyond the data. These times are of the engine; "rf.fit" is what a
user calls, with the study of the noise, causes and errors, and its memory is of each reading.

    python benchmarks/scaling.py
"""

from __future__ import annotations

import argparse
import itertools
import shlex
import sys
import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from reporting import RESULTS, environment, table, write_csv
from rigs import RIGS, Rig, chain_rig, with_noise

import rotorfit as rf
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.minimisation.least_squares import minimise
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.closed_form import closed_form
from rotorfit.estimators.starting.force_balance import stiffness_matrices
from rotorfit.estimators.starting.starts import find_start

LINES = (100, 1000, 10_000, 100_000, 1_000_000)
PLANES = (2, 3, 5, 8, 12, 16, 20)
LINES_PER_SWEEP = 40
NOISE = 0.01
SLOW = 1.0  # seconds beyond which two repeats are enough
PACKAGES = ("numpy", "scipy", "casadi")


@dataclass(frozen=True)
class Cost:
    """Times of one size, in milliseconds, and peak memory of a fit.

    Attributes:
        against: what grows, "lines" or "planes".
        evaluation_ms: cost, gradient and Gauss-Newton matrix.
        stiffness_ms: inversion of the response matrices, eq. (7).
        closed_form_ms: weighted closed form.
        fit_ms: start and optimisation from a prepared problem.
        fit_mb: peak memory of that.
        evaluations: of the objective, in the fit.
        whole_ms: ``rf.fit`` of the test with everything that belongs to it.
        whole_kb: peak memory of that, kB a reading.
    """

    against: str
    size: int
    readings: int
    parameters: int
    evaluation_ms: float
    stiffness_ms: float
    closed_form_ms: float
    fit_ms: float
    fit_mb: float
    evaluations: int
    whole_ms: float
    whole_kb: float


def milliseconds(run: Callable[[], object], repeats: int = 7) -> float:
    """Best time of some repeats; two where it takes long, of which the first is given its memory."""
    times: list[float] = []
    for _ in range(repeats):
        begin = time.process_time()
        run()
        times.append(time.process_time() - begin)
        if len(times) > 1 and sum(times) > SLOW:
            break
    return 1e3 * min(times)


def fitted(problem: Problem) -> int:
    """Evaluations that a fit needs."""
    space = problem.space
    start = find_start(problem, {}).x
    solution = minimise(problem, start, lower=space.lower, upper=space.upper)
    if not solution.success:
        raise RuntimeError(f"{space.model.name} with {problem.n_data} data: {solution.message}")
    return solution.n_evaluations


def fresh(problem: Problem) -> Problem:
    """The same problem, of which nothing is worked out yet."""
    return replace(problem, blocks=tuple(replace(block) for block in problem.blocks if isinstance(block, Responses)))


def measure(against: str, size: int, rig: Rig, lines: int) -> Cost:
    rng = np.random.default_rng(size)
    problem, test = with_noise(rig.problem(lines, NOISE), rng), rig.test(lines, NOISE, rng)
    known = {name: rig.truth[name] for name in rig.known}
    block = problem.blocks[0]
    if not isinstance(block, Responses):
        raise TypeError("the benchmark measures responses")
    x = np.array([rig.truth[name] for name in problem.space.names])
    problem.gauss_newton(x)
    elsewhere = (x * (1 + 1e-9 * step) for step in itertools.count(1))  # what was asked for last is kept
    evaluations = fitted(problem)
    fit = milliseconds(lambda: fitted(fresh(problem)))
    tracemalloc.start()
    fitted(fresh(problem))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.reset_peak()
    held = tracemalloc.get_traced_memory()[0]
    rf.fit(rig.model, test, known=known)
    whole = tracemalloc.get_traced_memory()[1] - held
    tracemalloc.stop()
    return Cost(
        against,
        size,
        block.measured.size,
        problem.space.size,
        milliseconds(lambda: problem.gauss_newton(next(elsewhere))),
        milliseconds(lambda: stiffness_matrices(block)),
        milliseconds(lambda: closed_form(problem.space, fresh(problem).blocks)),
        fit,
        peak / 1e6,
        evaluations,
        milliseconds(lambda: rf.fit(rig.model, test, known=known), 3),
        whole / 1e3 / block.measured.size,
    )


# ---- output -----------------------------------------------------------------------------------------------------


def write_markdown(costs: Sequence[Cost], path: Path, command: str) -> None:
    text = ["# Cost against lines and planes", "", f"Made by `{command}` on {environment(*PACKAGES)}.", ""]
    text += [*(__doc__ or "").splitlines()[2:8], ""]
    for against in ("lines", "planes"):
        rows = [
            [
                f"{cost.size:,}", f"{cost.readings:,}", str(cost.parameters), f"{cost.evaluation_ms:.3g}",
                f"{1e6 * cost.evaluation_ms / cost.readings:.3g}", f"{cost.stiffness_ms:.3g}",
                f"{cost.closed_form_ms:.3g}", f"{cost.fit_ms:.3g}", f"{cost.fit_mb:.3g}", str(cost.evaluations),
                f"{cost.whole_ms:.3g}", f"{cost.whole_kb:.3g}",
            ]
            for cost in costs
            if cost.against == against
        ]  # fmt: skip
        header = [
            against, "readings", "parameters", "evaluation, ms", "ns per reading", "eq. (7), ms", "closed form, ms",
            "fit, ms", "peak, MB", "evaluations", "rf.fit, ms", "kB a reading",
        ]  # fmt: skip
        text += [*table(header, rows), ""]
    path.write_text("\n".join(text), encoding="utf-8")


def draw_figure(costs: Sequence[Cost], path: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    series = {
        "rf.fit": "whole_ms",
        "fit, with its start": "fit_ms",
        "closed form": "closed_form_ms",
        "inversion, eq. (7)": "stiffness_ms",
        "cost, gradient, Gauss-Newton": "evaluation_ms",
    }
    for axis, against, label in zip(axes, ("lines", "planes"), ("lines in a sweep", "planes"), strict=True):
        chosen = [cost for cost in costs if cost.against == against]
        for name, field in series.items():
            axis.plot([c.size for c in chosen], [getattr(c, field) for c in chosen], "o-", ms=3.5, label=name)
        axis.set(xscale="log", yscale="log", xlabel=label, ylabel="time / ms")
        axis.grid(alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    ticks = [cost.size for cost in costs if cost.against == "planes"]
    axes[1].set_xticks(ticks, [str(tick) for tick in ticks])
    axes[1].minorticks_off()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--lines", type=int, nargs="+", default=list(LINES))
    parser.add_argument("--planes", type=int, nargs="+", default=list(PLANES))
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(words)
    command = shlex.join(["python", "benchmarks/scaling.py", *words])
    costs = []
    one_speed = replace(RIGS["whirl-whip"], speeds=(150.0,))
    cases = [("lines", lines, one_speed, lines) for lines in options.lines]
    cases += [("planes", planes, chain_rig(planes), LINES_PER_SWEEP) for planes in options.planes]
    for against, size, rig, lines in cases:
        costs.append(measure(against, size, rig, lines))
        last = costs[-1]
        print(f"{against} {size}: evaluation {last.evaluation_ms:.3g} ms, fit {last.fit_ms:.3g} ms", flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    write_csv(costs, options.out / "scaling.csv", command, environment(*PACKAGES))
    write_markdown(costs, options.out / "scaling.md", command)
    draw_figure(costs, options.out / "scaling.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
