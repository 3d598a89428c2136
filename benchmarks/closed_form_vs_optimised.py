"""Closed-form against optimised estimates, over many draws of the noise and against the Cramer-Rao bound.

For each model and noise level the same noisy tests go to three estimators: the closed form unweighted, as
the paper has it, the closed form weighted by the propagated noise, and the weighted nonlinear least squares
started from the latter. Bias, variance and root-mean-square error of each parameter are given over the
Cramer-Rao bound. Exit status 1 says that an optimised estimate missed the bound where the noise is small
enough for it to apply, or that at 1 % noise or less one was not the optimum found from the true parameters.

    python benchmarks/closed_form_vs_optimised.py
    python benchmarks/closed_form_vs_optimised.py --models one-mode whirl-whip --levels 0.01 --draws 10000 \
        --within 0.05 --name variance_10000
"""

from __future__ import annotations

import argparse
import math
import shlex
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
from nonlinearity import second_order
from reporting import RESULTS, environment, table, write_csv
from rigs import RIGS, Rig, true_vector, with_noise

from rotorfit.base.array_types import Float
from rotorfit.estimators.minimisation.least_squares import minimise
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.closed_form import closed_form
from rotorfit.estimators.starting.starts import find_start

OPTIMISED = "optimised"
ESTIMATORS = ("closed form, unweighted", "closed form, weighted", OPTIMISED)
PACKAGES = ("numpy", "scipy", "casadi")
LEVELS = (0.001, 0.003, 0.01, 0.03, 0.1)
SAME = 1e-6  # relative difference of cost below which two minima are one
REQUIRED = 1.0  # noise in percent up to which no other minimum may be found
TWO_SIDED = 1.96
"""Standard errors of a 95 % interval."""
SIGMAS = 3.5
"""Sampling errors by which a variance may differ from the bound."""


@dataclass(frozen=True)
class Row:
    """One parameter under one noise level and estimator; errors are over the Cramer-Rao bound.

    Attributes:
        noise_percent: noise over the rms response of its channel.
        bound: Cramer-Rao bound of the standard error, in ``unit``.
        nonlinearity, expected_bias: of the optimised estimate, see nonlinearity.py.
        bound_applies: whether the noise is small enough for the optimised estimate to scatter as it says.
        failures: draws without an estimate, or whose optimisation did not converge.
        other_minima: draws whose optimised estimate is worse than the optimum found from the true parameters.
        covered: share of the weighted closed form's own 95 % intervals that hold the truth, NaN of others.
        milliseconds: processor time of an estimate, that of its start within the optimised one's.
    """

    model: str
    noise_percent: float
    parameter: str
    unit: str
    truth: float
    bound: float
    nonlinearity: float
    expected_bias: float
    bound_applies: bool
    estimator: str
    bias: float
    variance: float
    rmse: float
    draws: int
    failures: int
    other_minima: int
    covered: float
    milliseconds: float


class Estimates(NamedTuple):
    """Those of every draw, shape ``(3, draws, p)`` as in :data:`ESTIMATORS`, with failures and time of each, other
    minima, and which of the weighted closed form's own intervals hold the truth, shape ``(draws, p)``."""

    values: Float
    failures: NDArray[np.intp]
    seconds: Float
    other_minima: int
    inside: NDArray[np.bool_]


def estimates(problem: Problem, truth: Float, draws: int, seed: int) -> Estimates:
    """Draws of the noise, through each estimator."""
    space = problem.space
    rng = np.random.default_rng(seed)
    result = np.full((3, draws, space.size), np.nan)
    failures, seconds, other_minima = np.zeros(3, dtype=np.intp), np.zeros(3), 0
    inside = np.zeros((draws, space.size), dtype=bool)
    for draw in range(draws):
        noisy = with_noise(problem, rng)
        for number, weighted in enumerate((False, True)):
            begun = time.process_time()
            closed = closed_form(space, noisy.blocks, weighted=weighted)
            seconds[number] += time.process_time() - begun
            result[number, draw] = closed.x
        inside[draw] = np.abs(closed.x - truth) < TWO_SIDED * np.sqrt(np.diag(closed.covar))
        begun = time.process_time()
        start = find_start(noisy, {}).x
        found = minimise(noisy, start, lower=space.lower, upper=space.upper)
        seconds[2] += time.process_time() - begun
        result[2, draw] = found.x
        failures += [*np.isnan(result[:2, draw]).any(axis=1), not found.success]
        other_minima += found.cost > (1 + SAME) * minimise(noisy, truth, lower=space.lower, upper=space.upper).cost
    return Estimates(result, failures, seconds, other_minima, inside)


def study(rig: Rig, level: float, draws: int, lines: int, seed: int) -> list[Row]:
    """All rows of one model at one noise level."""
    problem = rig.problem(lines, level)
    truth = true_vector(problem, rig.truth)
    theory = second_order(problem, truth)
    found = estimates(problem, truth, draws, seed)
    errors, other_minima = (found.values - truth) / theory.stderr, found.other_minima
    rows = []
    for i, name in enumerate(problem.space.names):
        for number, estimator in enumerate(ESTIMATORS):
            sample = errors[number, :, i]
            sample = sample[np.isfinite(sample)]
            rows.append(
                Row(
                    model=rig.model.name,
                    noise_percent=100 * level,
                    parameter=name,
                    unit=rig.model.parameter(name).unit,
                    truth=float(truth[i]),
                    bound=float(theory.stderr[i]),
                    nonlinearity=float(theory.nonlinearity[i]),
                    expected_bias=float(theory.bias[i]),
                    bound_applies=other_minima == 0 and bound_applies(float(theory.nonlinearity[i]), draws),
                    estimator=estimator,
                    bias=float(sample.mean()),
                    variance=float(sample.var(ddof=1)),
                    rmse=float(np.sqrt(np.mean(sample**2))),
                    draws=draws,
                    failures=int(found.failures[number]),
                    other_minima=other_minima,
                    covered=100 * float(found.inside[:, i].mean()) if estimator == ESTIMATORS[1] else math.nan,
                    milliseconds=1000 * float(found.seconds[number]) / draws,
                )
            )
    return rows


def bound_applies(nonlinearity: float, draws: int) -> bool:
    """Whether the variance is expected to exceed the bound by less than one sampling error of the variance.

    For the reciprocal of a linear parameter, as compliance is of stiffness, the relative excess is
    4 nonlinearity^2, most of it from the third order of the expansion.
    """
    return 4 * nonlinearity**2 < math.sqrt(2 / draws)


def misses(rows: Iterable[Row], within: float | None) -> list[Row]:
    """Optimised rows that miss the bound where it applies (``within``: anywhere, by that much), or the optimum."""
    found = []
    for row in rows:
        if row.estimator == OPTIMISED and row.other_minima and row.noise_percent <= REQUIRED:
            found.append(row)
            continue
        if row.estimator == OPTIMISED and (within is not None or row.bound_applies):
            allowed = SIGMAS * float(np.sqrt(2 / row.draws)) if within is None else within
            if not abs(row.variance - 1) <= allowed:
                found.append(row)
    return found


# ---- output ------------------------------------------------------------------------------------------------


def write_markdown(rows: Sequence[Row], path: Path, command: str) -> None:
    cases = list(dict.fromkeys((row.model, row.noise_percent) for row in rows))
    text = [
        "# Closed form against optimised",
        "",
        f"Made by `{command}`: {rows[0].draws} draws of the noise for each model and level ({environment(*PACKAGES)}).",
        "",
        *_overview(rows, cases),
        "",
        *_where_the_bound_applies(rows, cases),
        "",
        *_parameters(rows),
    ]
    path.write_text("\n".join(text) + "\n", encoding="utf-8")


def _overview(rows: Sequence[Row], cases: Sequence[tuple[str, float]]) -> list[str]:
    lines = []
    for model, noise in cases:
        case = [row for row in rows if (row.model, row.noise_percent) == (model, noise)]
        cells = []
        for estimator in ESTIMATORS:
            rmse = {row.parameter: row.rmse for row in case if row.estimator == estimator}
            worst = max(rmse, key=lambda name: rmse[name])
            cells.append(f"{np.median(list(rmse.values())):.3g} ({worst} {rmse[worst]:.3g})")
        held = [row.covered for row in case if row.estimator == ESTIMATORS[1]]
        times = ", ".join(f"{row.milliseconds:.1f}" for row in case[: len(ESTIMATORS)])
        counts = str(case[-1].failures), str(case[-1].other_minima)
        lines.append([model, f"{noise:g} %", *cells, f"{np.mean(held):.1f} % ({min(held):.1f})", times, *counts])
    return [
        "RMSE over the Cramer-Rao bound, median over the parameters and, in brackets, the worst parameter. Covered: "
        "the weighted closed form's own 95 % intervals that hold the truth, and those of the worst parameter. ms: "
        "processor time of an estimate without its errors, by the three in turn. The last columns count draws whose "
        "optimisation did not converge, or ended in another minimum than from the truth.",
        "",
        *table(["model", "noise", *ESTIMATORS, "covered", "ms", "not converged", "other minimum"], lines),
    ]


def _where_the_bound_applies(rows: Sequence[Row], cases: Sequence[tuple[str, float]]) -> list[str]:
    lines = []
    for model, noise in cases:
        case = [row for row in rows if (row.model, row.noise_percent, row.estimator) == (model, noise, OPTIMISED)]
        inside = [row.variance for row in case if row.bound_applies]
        span = f"{min(inside):.3f} to {max(inside):.3f} ({len(inside)} of {len(case)})" if inside else "nowhere"
        outside = [f"{r.parameter} ({r.nonlinearity:.2g}: {r.variance:.3g})" for r in case if not r.bound_applies]
        lines.append([model, f"{noise:g} %", span, ", ".join(outside) or "-"])
    draws = rows[0].draws
    return [
        f"Variance of the optimised estimates over the bound's square. {draws} draws give it to within "
        f"{np.sqrt(2 / draws):.3f} (one standard error). The bound applies where four times the squared "
        "nonlinearity of a parameter (standard deviation of its estimate's second-order term over the bound) "
        "is below that, and no draw ended in another minimum.",
        "",
        *table(["model", "noise", "where the bound applies", "where it does not (nonlinearity: variance)"], lines),
    ]


def _parameters(rows: Sequence[Row]) -> list[str]:
    """Every parameter at the noise level nearest to 1 %."""
    noise = min({row.noise_percent for row in rows}, key=lambda value: abs(np.log(value)))
    chosen = [row for row in rows if row.noise_percent == noise]
    lines = []
    for start in range(0, len(chosen), len(ESTIMATORS)):
        group = chosen[start : start + len(ESTIMATORS)]
        first = group[0]
        cells = [f"{row.bias:+.3f}, {row.rmse:.3f}" for row in group]
        bound = f"{100 * first.bound / abs(first.truth):.2g}"
        lines.append([first.model, first.parameter, bound, *cells, f"{first.expected_bias:+.3f}"])
    return [
        f"Every parameter at {noise:g} % noise: bias and RMSE over the bound, and the bias that the second order "
        "of the optimised estimate predicts (Box 1971).",
        "",
        *table(["model", "parameter", "bound, %", *(f"{e}: bias, RMSE" for e in ESTIMATORS), "predicted bias"], lines),
    ]


def draw_figure(rows: Sequence[Row], path: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    models = list(dict.fromkeys(row.model for row in rows))
    figure, axes = plt.subplots(
        1,
        len(models),
        figsize=(2.6 * len(models) + 0.8, 3.4),
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for axis, model in zip(axes[0], models, strict=True):
        for estimator, colour in zip(ESTIMATORS, ("tab:orange", "tab:blue", "black"), strict=True):
            chosen = [row for row in rows if (row.model, row.estimator) == (model, estimator)]
            noise = sorted({row.noise_percent for row in chosen})
            values = [[row.rmse for row in chosen if row.noise_percent == n] for n in noise]
            axis.plot(noise, [np.median(v) for v in values], "o-", color=colour, ms=3, lw=1.5, label=estimator)
            axis.fill_between(noise, [min(v) for v in values], [max(v) for v in values], color=colour, alpha=0.15, lw=0)
        axis.set(xscale="log", yscale="log", title=model, xlabel="noise / % of rms response")
        axis.axhline(1.0, color="grey", lw=0.8, ls="--", zorder=0)
    axes[0, 0].set_ylabel("RMS error / Cramér-Rao bound")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--models", nargs="+", choices=list(RIGS), default=list(RIGS))
    parser.add_argument("--levels", nargs="+", type=float, default=list(LEVELS), help="noise over rms response")
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--lines", type=int, default=200, help="signed frequencies in each sweep")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--within", type=float, help="variance over bound allowed to differ from 1 by this, everywhere")
    parser.add_argument("--name", default="closed_form_vs_optimised", help="name of the result files")
    parser.add_argument("--out", type=Path, default=RESULTS)
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if arguments is None else arguments)
    options = parse(words)
    command = shlex.join(["python", "benchmarks/closed_form_vs_optimised.py", *words])
    rows: list[Row] = []
    for place, name in enumerate(options.models):
        for number, level in enumerate(options.levels):
            seed = options.seed * 10_000 + place * 100 + number
            rows += study(RIGS[name], level, options.draws, options.lines, seed)
            last = [row.variance for row in rows[2::3] if (row.model, row.noise_percent) == (name, 100 * level)]
            print(
                f"{name:<12} {100 * level:5.2g} %: variance over bound {min(last):.3f} to {max(last):.3f}",
                flush=True,
            )
    options.out.mkdir(parents=True, exist_ok=True)
    note = "bias, rmse: over the Cramer-Rao bound; variance: over its square"
    write_csv(rows, options.out / f"{options.name}.csv", command, environment(*PACKAGES), note)
    write_markdown(rows, options.out / f"{options.name}.md", command)
    if len(options.levels) > 1:
        draw_figure(rows, options.out / f"{options.name}.png")
    missed = misses(rows, options.within)
    for row in missed:
        print(
            f"{row.model} {row.parameter} at {row.noise_percent:g} %: variance over bound {row.variance:.3f}, "
            f"{row.other_minima} other minima"
        )
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
