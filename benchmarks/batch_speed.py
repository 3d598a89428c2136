"""Many fits of one model to data that differ by noise: rotorfit's batch beside Optimistix on JAX and lmfit.

Eq. (18), ten free parameters, four responses of 400 lines, 1 % noise: bootstrap samples, each contender started at the
exact parameters and held against the optimum of each data set by Ipopt. Optimistix's Levenberg-Marquardt is compiled
once over a batch (`jax.vmap`) or a fit at a time, whichever is quicker, and timed warm. Seconds are processor time on
one core, medians over rounds in turns. Below, one evaluation of the misfit: a vector by NumPy and by a numba loop
by hand, by the CasADi virtual machine and by the batch of this package; chains of up to 20 planes, forced and read at
all planes, need no symbolic inverse.

    python benchmarks/batch_speed.py
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import lmfit_rival
from fit_speed import Case, make_case
from posterior_rivals import log_density, numba_loop
from reporting import RESULTS, environment, table, write_csv
from rigs import chain_rig, true_vector

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.estimators.minimisation.batch import batch_fit, with_measured
from rotorfit.estimators.minimisation.least_squares import minimise
from rotorfit.estimators.misfit.kernels import Batch
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models import RotorModel

PACKAGES = ("numpy", "casadi", "numba", "lmfit", "optimistix", "jax")
PLANES = (1, 2, 4, 8, 20)
OURS, LMFIT = "rotorfit, batch", "lmfit"
AIMS = {"Optimistix, warm": 5.0, LMFIT: 50.0}


@dataclass(frozen=True)
class Row:
    """One contender: time of one of many fits, largest distance from the optimum in standard errors."""

    contender: str
    fits: int
    us_per_fit: float
    distance: float


def processor_time(run: Callable[[], Any], rounds: int) -> float:
    run()
    seconds = []
    for _ in range(rounds):
        begin = time.process_time()
        run()
        seconds.append(time.process_time() - begin)
    return float(np.median(seconds))


def as_arrays(case: Case, measured: ComplexArray) -> ComplexArray:
    """Readings of a problem, shape ``(B, R)``, as the rivals hold them, shape ``(B, 2, 2, L)``."""
    block: Any = case.problem.blocks[0]
    result = np.empty((measured.shape[0], *case.arrays["measured"].shape), dtype=complex)
    force_plane = np.argmax(np.abs(block.force[block.line]), axis=1)
    force = block.force[block.line, force_plane]
    for row in range(2):
        for column in range(2):
            mine = np.flatnonzero((block.coordinate == row) & (force_plane == column))
            mine = mine[np.argsort(block.frequency[block.line[mine]])]
            result[:, row, column] = measured[:, mine] / force[mine]
    return result


def optimistix_fit(case: Case, together: bool) -> Callable[[ComplexArray], Float]:
    """Levenberg-Marquardt on JAX in units of the start, compiled for one data set or for a batch."""
    import jax
    import jax.numpy as jnp
    import optimistix as optx

    jax.config.update("jax_enable_x64", True)
    w, weight = jnp.asarray(case.arrays["w"]), jnp.asarray(case.arrays["weight"])
    speed, K3, start = case.arrays["speed"], case.arrays["K3"], jnp.asarray(case.optimum)

    def residual(y: Any, measured: Any) -> Any:
        Md, Ds, K1, K2, sigma, Mb, K0, D, lam, Mf = start * y
        u = w - lam * speed
        disk = K1 + K2 - Md * w**2 + 1j * Ds * w
        journal = K0 + K3 + K2 * sigma - Mb * w**2 - Mf * u**2 + 1j * D * u
        rows = jnp.stack([jnp.stack([journal, 0 * w + K2 * sigma]), jnp.stack([0 * w + K2, disk])])
        miss = (rows / (disk * journal - K2**2 * sigma) - measured) * weight
        return jnp.stack([miss.real, miss.imag])

    solver = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-6)  # tighter, some never stop: round-off

    def one(measured: Any) -> Any:
        return start * optx.least_squares(residual, solver, jnp.ones(10), measured, max_steps=100, throw=False).value

    if together:
        batched = jax.jit(jax.vmap(one))
        return lambda measured: np.asarray(batched(jnp.asarray(measured)))
    single = jax.jit(one)
    return lambda measured: np.array([single(jnp.asarray(m)) for m in measured])


def compare(case: Case, fits: int, rounds: int, rivals: bool = True, seed: int = 2) -> list[Row]:
    """Time per fit and distance from the optima."""
    problem, rng = case.problem, np.random.default_rng(seed)
    exact = np.concatenate(problem.predict(case.optimum))
    sigma = np.concatenate([block.sigma for block in problem.blocks])
    noise = rng.normal(size=(fits, exact.size)) + 1j * rng.normal(size=(fits, exact.size))
    measured = exact + sigma * noise
    arrays = as_arrays(case, measured)
    few = min(fits, 50)
    # All optima at once would be the batch's own word.
    optima = np.array([minimise(with_measured(problem, m), case.optimum).x for m in measured[:few]])
    start = case.named(case.optimum)

    def lmfit(data: ComplexArray) -> Float:
        found = [lmfit_rival.fit({**case.arrays, "measured": m}, start) for m in data]
        return np.array([[q.value for q in result.params.values()] for result in found])

    runs: dict[str, tuple[int, Callable[[int], Float]]] = {
        OURS: (fits, lambda n: batch_fit(problem, measured[:n], case.optimum).x)
    }
    if rivals:
        together, single = optimistix_fit(case, True), optimistix_fit(case, False)
        runs |= {
            "Optimistix, warm, vmap": (few, lambda n: together(arrays[:n])),
            "Optimistix, warm, one by one": (few, lambda n: single(arrays[:n])),
        }
    runs[LMFIT] = (few, lambda n: lmfit(arrays[:n]))
    rows = []
    for name, (count, run) in runs.items():
        distance = float(np.max(np.abs(run(count)[:few] - optima) / case.stderr))
        rows.append(Row(name, count, 1e6 * processor_time(lambda r=run, n=count: r(n), rounds) / count, distance))
        print(rows[-1], flush=True)
    return rows


def factors(rows: Sequence[Row]) -> Mapping[str, float]:
    """How many times quicker a fit is than with each rival at its best."""
    ours = next(row.us_per_fit for row in rows if row.contender == OURS)
    return {
        rival: min((row.us_per_fit for row in rows if row.contender.startswith(rival)), default=np.nan) / ours
        for rival in AIMS
    }


# ---- one evaluation ----------------------------------------------------------------------------------------------


def casadi_misfit(problem: Problem) -> Callable[[Float], float]:
    """The model's own graph in CasADi's virtual machine, mapped over the lines, residuals by NumPy."""
    import casadi as ca

    model: RotorModel = problem.space.model
    block: Any = problem.blocks[0]
    size, order = len(model.coordinates), model.order
    theta, w = ca.SX.sym("theta", len(model.parameters)), ca.SX.sym("w")
    c = model.functions.graph(ca.vertcat(theta, float(block.speed[0]), 0.0))
    real, imag = ca.SX.zeros(size, size), ca.SX.zeros(size, size)
    for power in range(order + 1):
        for i in range(size):
            for j in range(size):
                at = power * 2 * size * size + i * size + j
                cr, ci = c[at], c[at + size * size]
                turned = ((cr, ci), (-ci, cr), (-cr, -ci), (ci, -cr))[power % 4]
                real[i, j] += turned[0] * w**power
                imag[i, j] += turned[1] * w**power
    whole = ca.vertcat(ca.horzcat(real, -imag), ca.horzcat(imag, real))
    force = block.force
    u = ca.SX.sym("u", 2 * size)
    response = ca.Function("response", [theta, w, u], [ca.inv(whole) @ u]).map(force.shape[0])
    drive = np.vstack([force.real.T, force.imag.T])
    template = problem.space.template[0].copy()
    index = problem.space.index[0]

    def misfit(x: Float) -> float:
        template[index >= 0] = x[index[index >= 0]]
        found = np.asarray(response(template, block.frequency, drive))
        z = found[block.coordinate, block.line] + 1j * found[size + block.coordinate, block.line]
        return float(np.sum(np.abs((z - block.measured) / block.sigma) ** 2))

    return misfit


@dataclass(frozen=True)
class Evaluation:
    """Time of the misfit of one vector, and of the misfit with its gradient."""

    what: str
    readings: int
    us: float
    us_gradient: float


def evaluations(case: Case, rounds: int) -> list[Evaluation]:
    problem, x = case.problem, case.optimum
    virtual = casadi_misfit(problem)
    expected = 2 * problem.cost(x)
    for name, value in {"CasADi": virtual(x), "NumPy": -2 * log_density(x, case.arrays)}.items():
        if abs(value / expected - 1) > 1e-9:
            raise RuntimeError(f"the misfit by {name} is {value}, by the problem {expected}")
    readings = problem.n_data // 2
    rows = [
        Evaluation(name, readings, 1e6 * processor_time(lambda f=f: [f() for _ in range(50)], rounds) / 50, np.nan)
        for name, f in {
            "NumPy by hand": lambda: log_density(x, case.arrays),
            "CasADi virtual machine": lambda: virtual(x),
        }.items()
    ]
    rows.append(Evaluation("numba loop by hand", readings, by_hand(case, expected, rounds), np.nan))
    for what, accelerate in (("rotorfit, NumPy", False), ("rotorfit, compiled", True)):
        rows.append(evaluate(what, problem, x, accelerate, rounds))
    for planes in PLANES:
        rig = chain_rig(planes)
        chain = rig.problem(400, 0.01)
        rows.append(evaluate(f"rotorfit, chain of {planes}", chain, true_vector(chain, rig.truth), None, rounds))
    return rows


def by_hand(case: Case, expected: float, rounds: int) -> float:
    """Microseconds a vector of the loop that one writes with numba, 1000 vectors at once."""
    data, loop, out = case.arrays, numba_loop(), np.empty(1000)
    measured = data["measured"].reshape(4, -1)
    parts = np.ascontiguousarray(measured.real), np.ascontiguousarray(measured.imag)
    weight2 = np.ascontiguousarray(data["weight"].reshape(4, -1) ** 2)
    vectors = np.tile(case.optimum, (1000, 1))

    def run() -> None:
        loop(vectors, data["w"], data["speed"], data["K3"], *parts, weight2, out)

    run()
    if abs(out[0] / expected - 1) > 1e-9:
        raise RuntimeError(f"the misfit by the loop is {out[0]}, by the problem {expected}")
    return 1e6 * processor_time(run, rounds) / 1000


def evaluate(what: str, problem: Problem, x: Float, accelerate: bool | None, rounds: int) -> Evaluation:
    batch = Batch(problem, accelerate=accelerate)
    readings = problem.n_data // 2
    many = max(4, min(1000, 400_000 // readings)) if not batch.compiled else 1000
    vectors = np.tile(x, (many, 1))
    sums = processor_time(lambda: batch.channel_sums(vectors), rounds)
    slopes = processor_time(lambda: batch.cost_and_gradient(vectors), rounds)
    return Evaluation(what, readings, 1e6 * sums / many, 1e6 * slopes / many)


# ---- output ------------------------------------------------------------------------------------------------------


def markdown(rows: Sequence[Row], costs: Sequence[Evaluation], command: str) -> str:
    lines = ["# Many fits, many evaluations", "", f"Made by `{command}` on {environment(*PACKAGES)}.", ""]
    lines += [*(__doc__ or "").splitlines()[2:8], ""]
    header = ["contender", "fits", "us per fit", "distance / standard errors"]
    lines += table(header, [[r.contender, str(r.fits), f"{r.us_per_fit:,.0f}", f"{r.distance:.1e}"] for r in rows])
    quicker = [[f"{rival} (aim {AIMS[rival]:.0f})", f"{factor:.3g}"] for rival, factor in factors(rows).items()]
    lines += ["", *table(["rotorfit's batch is quicker than", "times"], quicker), ""]
    lines += table(
        ["misfit", "readings", "us", "ns per reading", "with gradient, us"],
        [
            [
                c.what, f"{c.readings:,}", f"{c.us:.3g}", f"{1e3 * c.us / c.readings:.3g}",
                "-" if np.isnan(c.us_gradient) else f"{c.us_gradient:.3g}",
            ]
            for c in costs
        ],
    )  # fmt: skip
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--lines", type=int, default=400)
    parser.add_argument("--fits", type=int, default=3000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(words)
    if hasattr(os, "sched_setaffinity"):  # threads of libraries would count several times
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    command = shlex.join(["python", "benchmarks/batch_speed.py", *words])
    case = make_case(options.lines)
    rows = compare(case, options.fits, options.rounds)
    costs = evaluations(case, options.rounds)
    text = markdown(rows, costs, command)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "batch_speed.md").write_text(text, encoding="utf-8")
    write_csv(rows, options.out / "batch_speed.csv", command, environment(*PACKAGES))
    write_csv(costs, options.out / "likelihood_speed.csv", command, environment(*PACKAGES))
    print(text, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
