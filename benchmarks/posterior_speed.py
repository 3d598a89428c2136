"""Effective samples per second of one posterior: rotorfit beside emcee on NumPy by hand and NumPyro's NUTS on JAX.

Eq. (18), ten free parameters, four responses of 400 lines, 1 % Gaussian noise of known level, flat priors: the same
density for all. Effective samples are ArviZ's bulk ESS of the worst parameter. Every contender's means and standard
deviations are held against importance sampling of the NumPy density, which shares no code with the samplers. Seconds
are processor time on one core, so that other work on the machine does not count; contenders take turns, rates are
medians over the rounds. NUTS is timed without compiling and adapting, emcee by hand without burn-in; rotorfit with
everything from the optimum on: normal approximation, start, burn-in and its own judgement of convergence. Cold runs
are fresh processes, timed with the interpreter's start, imports, compiling and burn-in.

    python benchmarks/posterior_speed.py
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from fit_speed import Case, make_case
from posterior_rivals import ORDER, Nuts, emcee_by_hand, log_density
from reporting import RESULTS, environment, table, write_csv

from rotorfit.base.array_types import Float
from rotorfit.estimators.inference.ensemble_sampler import sample
from rotorfit.estimators.inference.log_posterior import LogPosterior
from rotorfit.identify.uncertainty.posterior_file import load_arviz

Run = Callable[[int], tuple[Float, float]]

WALKERS = (32, 128, 512)
BY_HAND, NUTS = "emcee, NumPy by hand", "NumPyro NUTS, whitened"
PACKAGES = ("numpy", "scipy", "emcee", "numba", "numpyro", "jax", "arviz")
AIMS = {BY_HAND: 200.0, NUTS: 15.0}


@dataclass(frozen=True)
class Row:
    """One contender, medians over the rounds.

    Attributes:
        mean_off, sd_off: largest distance from the reference over the parameters, in standard deviations and as a
            fraction, of all rounds together.
        expected: what Monte Carlo error makes of ``mean_off``, 99 % point of the largest of ten.
    """

    contender: str
    draws: int
    seconds: float
    ess: float
    rate: float
    mean_off: float
    sd_off: float
    expected: float


@dataclass(frozen=True, eq=False)
class Moments:
    """Means and standard deviations of the parameters, and how many independent samples they are worth."""

    mean: Float
    sd: Float
    ess: float


def bulk_ess(chains: Float) -> float:
    """Bulk effective sample size of the worst parameter, chains of shape ``(chains, draws, p)``."""
    az = load_arviz()

    return float(min(az.ess(np.ascontiguousarray(chains[:, :, i])) for i in range(chains.shape[2])))


def reference(case: Case, centre: Float, covariance: Float, draws: int, seed: int = 11) -> Moments:
    """Moments by self-normalised importance sampling from a t distribution, on the NumPy density."""
    from scipy.stats import multivariate_t

    scale = np.sqrt(np.diag(covariance))
    proposal = multivariate_t(np.zeros(centre.size), covariance / np.outer(scale, scale), df=6)
    z = proposal.rvs(draws, random_state=seed)
    x = centre + z * scale
    log_weight = np.array([log_density(row, case.arrays) for row in x]) - proposal.logpdf(z)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    mean = weight @ z
    return Moments(centre + mean * scale, scale * np.sqrt(weight @ (z - mean) ** 2), float(1 / (weight**2).sum()))


def rotorfit_run(case: Case, walkers: int, ess: float, seed: int) -> tuple[Float, float]:
    """From the optimum to draws, with the mixture of moves that `fit.sample` uses."""
    begin = time.process_time()
    target = LogPosterior(case.problem, "fixed")
    centre, covariance = target.laplace(case.optimum)
    chain = sample(target, centre, covariance, walkers=walkers, ess=ess, max_steps=100_000, seed=seed)
    seconds = time.process_time() - begin
    if not chain.converged:
        raise RuntimeError(f"{walkers} walkers: {chain.message}")
    return chain.draws.transpose(1, 0, 2), seconds


def in_order(case: Case) -> Case:
    """The case, after a check that the rivals' order of parameters is the problem's."""
    if case.problem.space.names != ORDER:
        raise RuntimeError(f"the rivals take {ORDER}; the problem has {case.problem.space.names}")
    return case


def compare(runs: dict[str, Run], truth: Moments, rounds: int) -> list[Row]:
    """Run the contenders in turns and hold them against the reference."""
    chains: dict[str, list[Float]] = {name: [] for name in runs}
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    for number in range(rounds):
        for name, run in runs.items():
            chain, spent = run(number)
            chains[name].append(chain)
            seconds[name].append(spent)
            print(f"{name}: {chain[:, :, 0].size} draws in {spent:.2f} s", flush=True)
    rows = []
    for name in runs:
        sizes = np.array([bulk_ess(chain) for chain in chains[name]])
        flat = np.concatenate([chain.reshape(-1, truth.mean.size) for chain in chains[name]])
        # Largest of ten standard normal errors, 99 % point, by Monte Carlo errors of both sides.
        error = 3.3 * np.sqrt(1 / sizes.sum() + 1 / truth.ess)
        rows.append(
            Row(
                name,
                chains[name][0][:, :, 0].size,
                float(np.median(seconds[name])),
                float(np.median(sizes)),
                float(np.median(sizes / seconds[name])),
                float(np.max(np.abs(flat.mean(axis=0) - truth.mean) / truth.sd)),
                float(np.max(np.abs(flat.std(axis=0) / truth.sd - 1))),
                float(error),
            )
        )
    return rows


def contenders(case: Case, centre: Float, covariance: Float, size: float) -> dict[str, Run]:
    """The samplers, their lengths multiplied by ``size``."""
    nuts = Nuts(case.arrays, centre, covariance, draws=int(4000 * size), warm_up=500, seed=5)
    steps = int(8000 * size)

    def ours(walkers: int) -> Run:
        return lambda seed: rotorfit_run(case, walkers, 20_000 * size, seed)

    return {
        BY_HAND: lambda seed: emcee_by_hand(case.arrays, centre, steps=steps, burn_in=2000, seed=seed),
        NUTS: lambda _: nuts.again(),
        **{f"rotorfit, {walkers} walkers": ours(walkers) for walkers in WALKERS},
    }


# ---- cold processes ----------------------------------------------------------------------------------------------

COLD_ESS = 2000.0


@dataclass(frozen=True)
class ColdRow:
    """A fresh process up to its posterior."""

    contender: str
    seconds: float
    ess: float
    rate: float


def cold_process(which: str, folder: Path) -> None:
    """What the fresh process does; prints effective samples, last line."""
    arrays = dict(np.load(folder / "case.npz"))
    centre, covariance = arrays.pop("centre"), arrays.pop("covariance")
    data: dict[str, Any] = arrays
    if which == "emcee":
        chain, _ = emcee_by_hand(data, centre, steps=int(120 * COLD_ESS / 32), burn_in=1000, seed=1)
    elif which == "nuts":
        chain = Nuts(data, centre, covariance, draws=int(COLD_ESS), warm_up=500, seed=1).chain
    else:
        chain, _ = rotorfit_run(make_case(data["w"].size), 128, COLD_ESS, 1)
    print(json.dumps({"ess": bulk_ess(chain), "seconds": time.process_time()}))


def cold(case: Case, centre: Float, covariance: Float) -> list[ColdRow]:
    rows = []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        np.savez(folder / "case.npz", **case.arrays, centre=centre, covariance=covariance)
        cache = {"ROTORFIT_CACHE_DIR": str(folder / "kernels")}
        for name, which in {
            BY_HAND: "emcee",
            NUTS: "nuts",
            "rotorfit, 128 walkers, kernels to compile": "rotorfit",
            "rotorfit, 128 walkers, kernels on disk": "rotorfit",
        }.items():
            command = [sys.executable, __file__, "--cold", which, "--folder", place]
            words = subprocess.run(command, check=True, capture_output=True, text=True, env=os.environ | cache).stdout
            found = json.loads(words.splitlines()[-1])
            rows.append(ColdRow(name, found["seconds"], found["ess"], found["ess"] / found["seconds"]))
            print(rows[-1], flush=True)
    return rows


# ---- output ------------------------------------------------------------------------------------------------------


def ratios(rows: Sequence[Row]) -> list[tuple[str, str, float]]:
    """Contender, rival, and how many times more effective samples a second."""
    rates = {row.contender: row.rate for row in rows}
    return [(name, rival, rates[name] / rates[rival]) for rival in AIMS for name in rates if name not in AIMS]


def markdown(rows: Sequence[Row], cold_rows: Sequence[ColdRow], truth: Moments, command: str) -> str:
    cells = [
        [
            row.contender, f"{row.draws:,}", f"{row.seconds:.3g}", f"{row.ess:,.0f}", f"{row.rate:,.0f}",
            f"{row.mean_off:.3f} ({row.expected:.3f})", f"{100 * row.sd_off:.1f}",
        ]
        for row in rows
    ]  # fmt: skip
    header = ["contender", "draws", "s", "ESS", "ESS per s", "mean off / sd (99 % of chance)", "sd off, %"]
    lines = ["# Speed of a posterior", "", f"Made by `{command}` on {environment(*PACKAGES)}.", ""]
    lines += [*(__doc__ or "").splitlines()[2:10], "", *table(header, cells), ""]
    lines += [f"Reference: importance sampling, {truth.ess:,.0f} effective samples.", ""]
    lines += table(
        ["", *[f"times {rival} (aim {aim:.0f})" for rival, aim in AIMS.items()]],
        [
            [name, *[f"{r:,.3g}" for n, _, r in ratios(rows) if n == name]]
            for name in dict.fromkeys(n for n, _, _ in ratios(rows))
        ],
    )
    if cold_rows:
        lines += ["", "Fresh processes, asked for about 2000 effective samples:", ""]
        lines += table(
            ["contender", "s in all", "ESS", "ESS per s"],
            [[row.contender, f"{row.seconds:.3g}", f"{row.ess:,.0f}", f"{row.rate:,.0f}"] for row in cold_rows],
        )
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--lines", type=int, default=400)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--size", type=float, default=1.0, help="multiplies the length of every run")
    parser.add_argument("--skip-cold", action="store_true")
    parser.add_argument("--cold", choices=["emcee", "nuts", "rotorfit"], help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(words)
    if hasattr(os, "sched_setaffinity"):  # threads of libraries would count several times
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    if options.cold:
        cold_process(options.cold, options.folder)
        return 0
    command = shlex.join(["python", "benchmarks/posterior_speed.py", *words])
    case = in_order(make_case(options.lines))
    centre, covariance = LogPosterior(case.problem, "fixed").laplace(case.optimum)
    runs = contenders(case, centre, covariance, options.size)
    rotorfit_run(replace(case), 32, 100.0, 0)  # kernels loaded
    truth = reference(case, centre, covariance, int(100_000 * options.size))
    rows = compare(runs, truth, options.rounds)
    cold_rows = [] if options.skip_cold else cold(case, centre, covariance)
    text = markdown(rows, cold_rows, truth, command)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "posterior_speed.md").write_text(text, encoding="utf-8")
    write_csv(rows, options.out / "posterior_speed.csv", command, environment(*PACKAGES))
    print(text, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
