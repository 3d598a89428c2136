"""A strongly curved posterior: independent proposals alone fail, the mixture of moves is right.

A journal swept up to 3 % of its rotative speed shows its fluid's cross stiffness ``D lam Omega`` well and D itself
badly: along the valley ``D lam = const`` the data hardly choose. The normal approximation at the optimum is the tangent
of that hyperbola. K0, D and lam are free, D with a lognormal prior, lam with a normal one, the noise is known. Means
and standard deviations are held against a quadrature over K0, ``D lam`` and log D that shares no code with model or
sampler.

    python benchmarks/curved_posterior.py
"""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

sys.path.insert(0, str(Path(__file__).parent))
from posterior_speed import bulk_ess
from reporting import RESULTS, environment, table, write_csv
from rigs import FORCE, RIGS, Rig, true_vector, with_noise

from rotorfit.base.array_types import Float
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.inference.ensemble_sampler import IndependenceMove, sample
from rotorfit.estimators.inference.log_posterior import LogPosterior
from rotorfit.estimators.minimisation.least_squares import minimise
from rotorfit.estimators.misfit.priors import Prior
from rotorfit.estimators.misfit.problem import Problem

NAMES = ("K0", "D", "lam")
SPEED, TOP = 100.0, 3.0
LINES, LEVEL = 20, 0.01
WALKERS, ESS, MAX_STEPS = 128, 10_000.0, 40_000
PACKAGES = ("numpy", "scipy", "emcee", "numba")


class SlowRig(Rig):
    """A rig that is swept far below its modes."""

    def sweep(self, lines: int) -> Float:
        half = np.linspace(0.0, TOP, lines // 2 + 1)[1:]
        return np.concatenate([-half[::-1], half])


def make_problem(seed: int = 3) -> tuple[Problem, dict[str, float]]:
    """The problem and the rig's true parameters."""
    truth = dict(RIGS["one-mode"].truth)
    rig = SlowRig(RIGS["one-mode"].model, truth, (SPEED,), ("K", "Ds", "M", "Mf"))
    problem = with_noise(rig.problem(LINES, LEVEL), np.random.default_rng(seed))
    if problem.space.names != NAMES:
        raise RuntimeError(f"the quadrature is over {NAMES}; the problem has {problem.space.names}")
    priors = tuple(Prior(NAMES.index(name), law) for name, law in prior_laws(truth).items())
    return replace(problem, priors=priors), truth


def prior_laws(truth: dict[str, float]) -> dict[str, Any]:
    return {"D": stats.lognorm(0.7, scale=truth["D"]), "lam": stats.norm(0.475, 0.2)}


# ---- the truth by quadrature -------------------------------------------------------------------------------------


def log_density(K0: Float, product: Float, log_D: Float, problem: Problem, truth: dict[str, float]) -> Float:
    """Log density in K0, D lam and log D, written out; arrays broadcast."""
    block = problem.blocks[0]
    if not isinstance(block, Responses):
        raise TypeError(f"responses are needed, not {type(block).__name__}")
    D = np.exp(log_D)
    lam = product / D
    laws = prior_laws(truth)
    # d(K0, D, lam) = d(K0, D lam, log D): D from the logarithm, 1/D from the product.
    total = laws["D"].logpdf(D) + laws["lam"].logpdf(lam)
    for w, measured, sigma in zip(block.frequency[block.line], block.measured, block.sigma, strict=True):
        u = w - lam * SPEED
        real = truth["K"] + K0 - truth["M"] * w**2 - truth["Mf"] * u**2
        imag = truth["Ds"] * w + D * u
        total = total - 0.5 * np.abs(FORCE / (real + 1j * imag) - measured) ** 2 / sigma**2
    return np.asarray(np.where(np.abs(lam) <= 2.0, total, -np.inf))  # the model's limits


def quadrature(problem: Problem, truth: dict[str, float], points: int = 90) -> tuple[Float, Float]:
    """Means and standard deviations of K0, D, lam on a grid, narrowed three times to where there is density."""
    place = np.array([truth["K0"], truth["D"] * truth["lam"], np.log(truth["D"])])
    half = np.array([3000.0, 60.0, 2.5])
    axes = [np.linspace(c - h, c + h, points) for c, h in zip(place, half, strict=True)]
    weight = np.zeros(0)
    for _ in range(4):
        grid = np.meshgrid(*axes, indexing="ij", sparse=True)
        density = log_density(*grid, problem, truth)
        weight = np.exp(density - density.max())
        used = [weight.max(axis=tuple({0, 1, 2} - {i})) > 1e-13 for i in range(3)]
        kept, spans = axes, [axis[u] for axis, u in zip(axes, used, strict=True)]
        axes = [
            np.linspace(s[0] - (a[1] - a[0]), s[-1] + (a[1] - a[0]), points) for a, s in zip(axes, spans, strict=True)
        ]
    K0, product, log_D = np.meshgrid(*kept, indexing="ij", sparse=True)
    weight /= weight.sum()
    values = [K0, np.exp(log_D), product * np.exp(-log_D)]
    mean = np.array([(weight * value).sum() for value in values])
    sd = np.sqrt([(weight * (value - m) ** 2).sum() for value, m in zip(values, mean, strict=True)])
    return mean, sd


# ---- contenders --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """One way to sample; distances from the quadrature, the worst of the three parameters."""

    moves: str
    converged: bool
    steps: int
    seconds: float
    acceptance: float
    ess: float
    mean_off: float
    sd_off: float
    expected: float


def measure(problem: Problem, truth: dict[str, float], seed: int = 1) -> list[Row]:
    """The mixture, and independence proposals alone with as many steps."""
    space = problem.space
    found = minimise(problem, true_vector(problem, truth), lower=space.lower, upper=space.upper)
    target = LogPosterior(problem, "fixed")
    centre, covariance = target.laplace(found.x)
    mean, sd = quadrature(problem, truth)
    rows: list[Row] = []
    longest = MAX_STEPS
    for name, moves in {"mixture": None, "independence alone": [(IndependenceMove(centre, covariance), 1.0)]}.items():
        begin = time.process_time()
        chain = sample(target, centre, covariance, walkers=WALKERS, ess=ESS, max_steps=longest, seed=seed, moves=moves)
        seconds = time.process_time() - begin
        draws = chain.draws.reshape(-1, 3)
        size = bulk_ess(chain.draws.transpose(1, 0, 2))
        rows.append(
            Row(
                name,
                chain.converged,
                chain.steps,
                seconds,
                float(chain.acceptance.mean()),
                size,
                float(np.max(np.abs(draws.mean(axis=0) - mean) / sd)),
                float(np.max(np.abs(draws.std(axis=0) / sd - 1))),
                float(3 / np.sqrt(size)),
            )
        )
        longest = chain.steps
    return rows


def markdown(rows: Sequence[Row], command: str) -> str:
    cells = [
        [
            row.moves, "yes" if row.converged else "no, and says so", f"{row.steps:,}", f"{row.seconds:.2g}",
            f"{100 * row.acceptance:.0f}", f"{row.ess:,.0f}", f"{row.mean_off:.3f}", f"{100 * row.sd_off:.1f}",
            f"{row.expected:.3f}",
        ]
        for row in rows
    ]  # fmt: skip
    header = [
        "moves", "converged", "steps", "s", "accepted, %", "ESS", "mean off / sd", "sd off, %", "3 / sqrt(ESS)",
    ]  # fmt: skip
    lines = ["# A curved posterior", "", f"Made by `{command}` on {environment(*PACKAGES)}.", ""]
    lines += [*(__doc__ or "").splitlines()[2:8], "", *table(header, cells)]
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(words)
    command = shlex.join(["python", "benchmarks/curved_posterior.py", *words])
    rows = measure(*make_problem(), options.seed)
    text = markdown(rows, command)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "curved_posterior.md").write_text(text, encoding="utf-8")
    write_csv(rows, options.out / "curved_posterior.csv", command, environment(*PACKAGES))
    print(text, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
