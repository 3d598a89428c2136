"""Simulation-based calibration: are posteriors right, on average over everything that the prior thinks possible?

Parameters drawn from their priors make data, the data make a posterior, and the rank of the true value among draws of
that posterior is uniform if, and only if, every step from the density to the sampler is right (Talts et al. 2018,
arXiv:1804.06788). Threshold speeds are ranked too. Intervals of 68 and 95 % are counted beside.

Exactness asks that data come from the very prior that the sampler assumes, the noise level of each channel included.
That level is inferred ("marginal", what `fit.sample` does), and its prior is proper: a density of ``S`` by
``(S + 1)^(-(n + 1)/2)`` is the likelihood integrated over ``1/s ~ |N(0, 1)|``, s the factor on the noise given. So s is
drawn from it here: half the channels are noisier than 1.5 times what the fit is told, one in twelve more than ten
times. With ``--noise fixed`` the noise is what the fit is told.

    python benchmarks/simulation_based_calibration.py
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

sys.path.insert(0, str(Path(__file__).parent))
from reporting import RESULTS, environment, table, write_csv
from rigs import RIGS, Rig

from rotorfit.base.array_types import Float, Index
from rotorfit.estimators.inference.ensemble_sampler import sample
from rotorfit.estimators.inference.log_posterior import LogPosterior, Noise
from rotorfit.estimators.minimisation.batch import with_measured
from rotorfit.estimators.minimisation.least_squares import minimise
from rotorfit.estimators.misfit.priors import Prior
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.starts import find_start
from rotorfit.models.motion.stability import growth_rate

DRAWS = 500
LINES = 24
LEVEL = 0.03
RANKED = 255
"""Posterior draws that the truth is ranked among: 256 ranks."""
BINS = 16
SIGNIFICANCE = 0.01
"""Chance of a false alarm, over all quantities of all models."""
WALKERS, ESS, MAX_STEPS = 64, 2000.0, 20_000
INTERVAL = 5000  # draws, evenly from the chain, that intervals are read from
APART = 3.0  # autocorrelation times between draws that count as independent
SPREAD = 0.2
PACKAGES = ("numpy", "scipy", "casadi", "emcee", "numba")


@dataclass(frozen=True, eq=False)
class Study:
    """One rig, its priors, and its test with exact readings at the priors' medians."""

    rig: Rig
    problem: Problem
    noise: Noise

    def simulate(self, rng: np.random.Generator) -> tuple[Float, Problem]:
        """True vector and the problem with the readings it makes."""
        problem = self.problem
        truth = np.array([float(prior.distribution.rvs(random_state=rng)) for prior in problem.priors])
        measured, theta = [], problem.space.theta(truth)
        for block in problem.blocks:
            level = np.ones(len(block.labels))
            if self.noise == "marginal":
                level = 1 / np.abs(rng.normal(size=level.size))
            noise = rng.normal(size=block.measured.size) + 1j * rng.normal(size=block.measured.size)
            measured.append(block.predict(theta) + level[block.label] * block.sigma * noise)
        return truth, with_measured(problem, np.concatenate(measured))


def make_study(name: str, lines: int = LINES, level: float = LEVEL, noise: Noise = "marginal") -> Study:
    """A rig of the benchmarks at one speed: lognormal priors around positive values, a normal one for lam."""
    rig = replace(RIGS[name], speeds=RIGS[name].speeds[:1])
    problem = rig.problem(lines, level)
    priors = tuple(Prior(i, prior_of(n, rig.truth[n])) for i, n in enumerate(problem.space.names))
    return Study(rig, replace(problem, priors=priors), noise)


def prior_of(name: str, value: float) -> Any:
    return stats.norm(value, 0.1 * value) if name == "lam" else stats.lognorm(SPREAD, scale=value)


@dataclass(frozen=True, eq=False)
class Posterior:
    """Independent draws, shape ``(RANKED, p)``, more draws for intervals, and whether the sampler converged."""

    ranked: Float
    draws: Float
    converged: bool


def posterior(problem: Problem, noise: Noise, seed: int, ess: float = ESS) -> Posterior:
    """What a user gets: start, fit, normal approximation, sampler."""
    space = problem.space
    target = LogPosterior(problem, noise)
    begin = np.clip(find_start(problem, {}).x, target.lower, target.upper)
    inside = np.isfinite(problem.cost(begin))
    medians = np.array([float(prior.distribution.median()) for prior in problem.priors])
    found = minimise(problem, begin if inside else medians, lower=space.lower, upper=space.upper)
    centre, covariance = target.laplace(found.x)
    chain = sample(target, centre, covariance, walkers=WALKERS, ess=ess, max_steps=MAX_STEPS, seed=seed)
    step = int(np.ceil(APART * min(float(chain.tau.max()), chain.draws.shape[0] / 10)))
    apart = chain.draws[::-step].reshape(-1, space.size)  # from the end
    flat = chain.draws.reshape(-1, space.size)
    return Posterior(apart[:RANKED], flat[:: 1 + flat.shape[0] // INTERVAL], chain.converged)


@dataclass(frozen=True, eq=False)
class Ranks:
    """Ranks of the truth, shape ``(draws, quantities)``, coverage, and posterior over prior standard deviation."""

    model: str
    quantities: tuple[str, ...]
    rank: Index
    inside68: NDArray[np.bool_]
    inside95: NDArray[np.bool_]
    shrinkage: Float
    unconverged: int


def run(name: str, study: Study, draws: int, seed: int, ess: float = ESS, assumed: Noise | None = None) -> Ranks:
    """Rank the truths of simulated data sets.

    Args:
        name: of the model.
        study: rig and priors.
        draws: number of data sets.
        seed: of everything random.
        ess: effective samples of each posterior.
        assumed: noise treatment of the sampler, that of the simulation by default; another one must be found out.
    """
    model, names = study.rig.model, study.problem.space.names
    speeds = ("threshold speed",) if model.speed_dependent else ()
    ranks, shares, widths, unconverged = [], [], [], 0
    for number, seeds in enumerate(np.random.SeedSequence(seed).spawn(draws)):
        rng = np.random.default_rng(seeds)
        truth, problem = study.simulate(rng)
        found = posterior(problem, assumed or study.noise, int(rng.integers(2**31)), ess)
        unconverged += not found.converged
        below, share = [(part < truth) for part in (found.ranked, found.draws)]
        if speeds:
            below, share = (
                np.column_stack([part, slower(problem, draws_, truth)])
                for part, draws_ in ((below, found.ranked), (share, found.draws))
            )
        ranks.append(below.sum(axis=0))
        shares.append(share.mean(axis=0))
        widths.append(found.draws.std(axis=0))
        if (number + 1) % 50 == 0:
            print(f"{name}: {number + 1} of {draws}, {unconverged} not converged", flush=True)
    share = np.array(shares)
    shrinkage = np.median(widths, axis=0) / [prior.distribution.std() for prior in study.problem.priors]
    shrinkage = np.append(shrinkage, [np.nan] * len(speeds))
    inside = [(share > (1 - level) / 2) & (share < (1 + level) / 2) for level in (0.68, 0.95)]
    return Ranks(name, (*names, *speeds), np.array(ranks), inside[0], inside[1], shrinkage, unconverged)


def slower(problem: Problem, draws: Float, truth: Float) -> NDArray[np.bool_]:
    """Whether the threshold speed of each draw is below that of the truth: is the draw unstable there?"""
    from rotorfit.models.motion.stability import threshold_speed

    space = problem.space
    onset = threshold_speed(space.model, space.theta(truth)[0])
    if onset is None:
        raise RuntimeError("the true rotor has no threshold speed: these priors do not suit the study")
    theta = np.broadcast_to(space.template[0], (draws.shape[0], space.template.shape[1])).copy()
    free = space.index[0] >= 0
    theta[:, free] = draws[:, space.index[0, free]]
    return np.asarray(growth_rate(space.model, theta, onset.speed) > 0)


# ---- verdict -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """One quantity: uniformity of its ranks and coverage of its intervals."""

    model: str
    quantity: str
    draws: int
    chi_square: float
    p_uniform: float
    coverage68: float
    p68: float
    coverage95: float
    p95: float
    posterior_over_prior_sd: float
    unconverged: int
    histogram: str


def judge(ranks: Ranks, bins: int = BINS) -> list[Row]:
    """Chi-square test of uniform ranks, binomial tests of coverage."""
    rows = []
    for i, quantity in enumerate(ranks.quantities):
        counts = np.bincount(ranks.rank[:, i] * bins // (RANKED + 1), minlength=bins)
        draws = int(counts.sum())
        test = stats.chisquare(counts)
        inside = int(ranks.inside68[:, i].sum()), int(ranks.inside95[:, i].sum())
        tests = [stats.binomtest(n, draws, level).pvalue for n, level in zip(inside, (0.68, 0.95), strict=True)]
        rows.append(
            Row(
                ranks.model,
                quantity,
                draws,
                float(test.statistic),
                float(test.pvalue),
                inside[0] / draws,
                float(tests[0]),
                inside[1] / draws,
                float(tests[1]),
                float(ranks.shrinkage[i]),
                ranks.unconverged,
                " ".join(map(str, counts)),
            )
        )
    return rows


def misses(rows: Sequence[Row]) -> list[str]:
    """What a calibrated posterior would not show, at the significance shared by all tests of a kind."""
    bound = SIGNIFICANCE / len(rows)
    found = []
    for row in rows:
        for what, p in {"ranks": row.p_uniform, "68 %": row.p68, "95 %": row.p95}.items():
            if p < bound:
                found.append(f"{row.model} {row.quantity}: {what}, p = {p:.2g} < {bound:.2g}")
    return found


# ---- output ------------------------------------------------------------------------------------------------------


def markdown(rows: Sequence[Row], command: str) -> str:
    found = misses(rows)
    bound = SIGNIFICANCE / len(rows)
    unconverged = {row.model: f"{row.unconverged} of {row.draws} ({row.model})" for row in rows}
    cells = [
        [
            row.model, row.quantity, f"{row.p_uniform:.3g}", f"{100 * row.coverage68:.1f}", f"{row.p68:.2g}",
            f"{100 * row.coverage95:.1f}", f"{row.p95:.2g}",
            "-" if np.isnan(row.posterior_over_prior_sd) else f"{row.posterior_over_prior_sd:.2g}",
        ]
        for row in rows
    ]  # fmt: skip
    header = ["model", "quantity", "p, uniform ranks", "in 68 %", "p", "in 95 %", "p", "posterior / prior sd"]
    lines = ["# Simulation-based calibration", "", f"Made by `{command}` on {environment(*PACKAGES)}.", ""]
    lines += (__doc__ or "").splitlines()[2:12]
    lines += [
        "",
        f"{rows[0].draws} data sets a model, {RANKED} independent posterior draws each, {BINS} bins. With {len(rows)} "
        f"quantities a p below {bound:.2g} would be a miss (1 % over all, Bonferroni). "
        f"Not converged by the sampler's own judgement, and counted all the same: {', '.join(unconverged.values())}.",
        "",
        "**" + ("No misses." if not found else f"{len(found)} misses: {'; '.join(found)}.") + "**",
        "",
        *table(header, cells),
        "",
        "![Rank histograms](simulation_based_calibration.png)",
    ]
    return "\n".join(lines) + "\n"


def draw_figure(rows: Sequence[Row], path: Path) -> None:
    """Histograms of the ranks; the band holds 99 % of the bars of uniform ranks."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    columns = 6
    figure, axes = plt.subplots(
        -(-len(rows) // columns), columns, figsize=(11, 1.5 * -(-len(rows) // columns)), layout="constrained"
    )
    for axis in axes.flat:
        axis.set_axis_off()
    for axis, row in zip(axes.flat, rows, strict=False):
        axis.set_axis_on()
        counts = np.array(row.histogram.split(), dtype=int)
        low, high = stats.binom.interval(0.99, row.draws, 1 / counts.size)
        axis.axhspan(low, high, color="0.85", lw=0)
        axis.bar(np.arange(counts.size) + 0.5, counts, width=0.9, color="tab:blue")
        axis.set_title(f"{row.model} {row.quantity}", fontsize=8)
        axis.set(xticks=[], ylim=(0, 2.2 * row.draws / counts.size))
        axis.tick_params(labelsize=7)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--models", nargs="+", default=["one-mode", "whirl-whip", "two-disk"])
    parser.add_argument("--draws", type=int, default=DRAWS)
    parser.add_argument("--lines", type=int, default=LINES)
    parser.add_argument("--noise", choices=["marginal", "fixed"], default="marginal")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(words)
    command = shlex.join(["python", "benchmarks/simulation_based_calibration.py", *words])
    found: Mapping[str, Ranks] = {
        name: run(name, make_study(name, options.lines, noise=options.noise), options.draws, options.seed)
        for name in options.models
    }
    rows = [row for ranks in found.values() for row in judge(ranks)]
    text = markdown(rows, command)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "simulation_based_calibration.md").write_text(text, encoding="utf-8")
    write_csv(rows, options.out / "simulation_based_calibration.csv", command, environment(*PACKAGES))
    draw_figure(rows, options.out / "simulation_based_calibration.png")
    print(text, end="")
    return 1 if misses(rows) else 0


if __name__ == "__main__":
    sys.exit(main())
