"""Coverage of error bars where noise is not white, equal and unshared, and where runs differ.

    python benchmarks/honest_errors.py --draws 200

writes results/honest_errors.md and results/honest_errors.csv, beside what an earlier version gave
(results/honest_errors_before.csv). The rig is one mode; its responses come from the formula of kappa written out here,
not from rotorfit's models, and noise enters where it does on a rig: at the probes, along the force, in the speed, or
once a run. Unless a row says so, sigma is not given with the data. Exit status 1 says that a row misses its promise.

"width" is the mean half width of the 95 % intervals over that of the right noise model: generalised least squares with
the true covariance, linearised at the truth. Where runs differ, its quantile is Student's with as many degrees of
freedom as a variance between that many runs can have.

Two runs. Let a result be the mean of x1 and x2, each normal about the truth with variance se^2 + tau^2: se is the error
within a run, tau what runs differ by. The error of the mean does not depend on x1 - x2, which is all that the data tell
of tau, so that a rule is a half width h(|x1 - x2|). Where two runs agree by chance nothing in the data can know that
they differ: a rule that takes se alone unless |x1 - x2| > c se sqrt(2) does so with the probability
2 Phi(c se / sqrt(se^2 + tau^2)) - 1, and then hardly ever holds the truth. A laxer level lowers c and makes more of the
runs that do agree look uncertain, with the quantile 12.7 of one degree of freedom. What the best rule pays is a convex
problem, solved by :func:`least_width`: of all rules that never go below 1.96 se / sqrt(2), the least mean width for
runs that agree at which a share of intervals holds, for one size of tau or for every size. The last lines of the table
state it.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import optimize, stats

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from reporting import RESULTS, environment, table, write_csv  # noqa: E402

import rotorfit as rf  # noqa: E402
from rotorfit.base.array_types import ComplexArray, Float  # noqa: E402
from rotorfit.lab.data.experiments import PerturbationTest  # noqa: E402
from rotorfit.lab.data.from_arrays import perturbation_test  # noqa: E402

TRUTH = {"M": 1.2, "K": 8000.0, "Ds": 8.0, "K0": 9000.0, "D": 450.0, "lam": 0.46, "Mf": 0.4}
SHARP = {**TRUTH, "D": 45.0}
FREE = ("K0", "D", "lam", "M", "Mf")
SPEEDS = (100.0, 180.0)
WATCHED = ("D", "lam", "threshold")


@dataclass(frozen=True, kw_only=True)
class World:
    """How the readings of a test go wrong. Shares are standard deviations relative to what they disturb.

    Attributes:
        truth: parameters of the rotor.
        lines: frequencies in each run.
        speeds: rotative speeds, rad/s.
        repeats: runs at each speed in each direction.
        both: whether there is a probe in y too.
        unbalance: the force grows with the square of the frequency.
        constant: noise of a probe over the rms response of all runs; ``own`` over that of its run.
        proportional: noise of a probe over its reading.
        backward: factor on the probes' noise in backward runs.
        filters: decay of the probes' correlation from line to line, 1 for none (overlapping filters).
        averaging: the same correlation, falling as powers of this (an average that forgets), in place of filters.
        force_jitter, force_jitter_amplitude, speed_jitter: from line to line; the second leaves the phase alone.
        oil, gain, phase, label: from run to run: viscosity (D and K0), force, phase reference (rad), speed label.
        sigma_given: whether the data hold sigma.
        options: further arguments of the fit.
        promise: share of intervals that must hold the truth.
        widest: mean width that is promised at most, over that of the right noise model.
        ideal: whether coverage above 97 % would be too much.
    """

    truth: Mapping[str, float] = field(default_factory=lambda: TRUTH)
    lines: int = 30
    speeds: tuple[float, ...] = SPEEDS
    repeats: int = 1
    both: bool = True
    unbalance: bool = False
    constant: float = 0.0
    own: float = 0.0
    proportional: float = 0.0
    backward: float = 1.0
    filters: float = 1.0
    averaging: float = 0.0
    force_jitter: float = 0.0
    force_jitter_amplitude: float = 0.0
    speed_jitter: float = 0.0
    oil: float = 0.0
    gain: float = 0.0
    phase: float = 0.0
    label: float = 0.0
    sigma_given: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)
    promise: float = 0.90
    widest: float = 1.3
    ideal: bool = False

    @property
    def runs(self) -> list[tuple[float, Float]]:
        """Speed and signed frequencies of each run, rad/s."""
        w = np.linspace(10.0, 250.0, self.lines)
        return [(speed, sense * w) for _ in range(self.repeats) for speed in self.speeds for sense in (1, -1)]


DEGREE = np.pi / 180
BETWEEN = {"constant": 0.0035}
WORLDS: dict[str, World] = {
    "ideal: constant noise, told": World(constant=0.005, sigma_given=True, ideal=True),
    "ideal: constant noise, x and y": World(constant=0.005, ideal=True),
    "ideal: constant noise, one probe": World(constant=0.005, both=False, ideal=True),
    "force jitter 1 %, probes 0.2 %": World(force_jitter=0.01, constant=0.002),
    "force jitter 1 %, amplitude only": World(force_jitter_amplitude=0.01, constant=0.002),
    "speed jitter 1 %, probes 0.2 %": World(speed_jitter=0.01, constant=0.002),
    "one probe, proportional 1 %": World(both=False, proportional=0.01),
    "one probe, proportional 1 %, sharp resonance": World(both=False, proportional=0.01, truth=SHARP),
    "one probe, proportional 1 %, unbalance force": World(both=False, proportional=0.01, unbalance=True),
    "x and y, 8 lines, proportional 1 %": World(proportional=0.01, lines=8, promise=0.85),
    "forward noise three times the backward": World(constant=0.003, backward=1 / 3),
    "each run 1 % of its own rms": World(own=0.01),
    "overlapping filters, neighbours 0.7, told": World(constant=0.005, filters=0.3, sigma_given=True),
    "oil 1 % from run to run": World(oil=0.01, **BETWEEN),
    "force 1 % from run to run": World(gain=0.01, **BETWEEN),
    "phase reference 1 degree from run to run": World(phase=DEGREE, **BETWEEN),
    "speed label 0.5 % from run to run": World(label=0.005, **BETWEEN),
    "oil 1 %, twelve runs": World(oil=0.01, repeats=3, **BETWEEN),
    "force 1 %, two runs": World(gain=0.01, speeds=(140.0,), promise=0.85, **BETWEEN),
    "phase 1 degree, phase_offsets=True": World(phase=DEGREE, options={"phase_offsets": True}, **BETWEEN),
    "overlapping filters, neighbours 0.7": World(constant=0.005, filters=0.3, promise=0.85, widest=1.5),
    "proportional 1 % and filters, told": World(proportional=0.01, filters=0.3, sigma_given=True),
    "proportional 1 % and filters": World(proportional=0.01, filters=0.3, promise=0.85, widest=1.5),
    "proportional 1 % and filters, one probe": World(
        proportional=0.01, filters=0.3, both=False, promise=0.85, widest=1.5
    ),
    "proportional 1 %, constant 0.5 % and filters": World(
        proportional=0.01, constant=0.005, filters=0.3, promise=0.85, widest=1.5
    ),
    "proportional 1 % and averaging, 0.7 a line, one probe": World(
        proportional=0.01, averaging=0.7, both=False, promise=0.85, widest=2.0
    ),
    "force jitter 1 %, force 1 % from run to run": World(force_jitter=0.01, gain=0.01, constant=0.002, promise=0.85),
    "ideal: two runs": World(speeds=(140.0,), widest=np.inf, ideal=True, **BETWEEN),
    "force 0.25 %, two runs": World(gain=0.0025, speeds=(140.0,), promise=0.0, widest=np.inf, **BETWEEN),
}  # fmt: skip
"""Rows of the table. Of the last two only coverage of the first is promised: what two runs cost and cannot tell."""


def kappa(p: Mapping[str, float], w: Any, speed: Any) -> ComplexArray:
    """Dynamic stiffness of one mode, eqs (10) to (13)."""
    whirl = w - p["lam"] * speed
    direct = p["K"] + p["K0"] - p["M"] * w**2 - p["Mf"] * whirl**2
    return np.asarray(direct + 1j * p["Ds"] * w + 1j * p["D"] * whirl)


def force(world: World, w: Float) -> Float:
    """Amplitude of the rotating force, N."""
    return 1e-4 * w**2 if world.unbalance else np.full(w.shape, 5.0)


def responses(world: World, p: Mapping[str, float]) -> list[ComplexArray]:
    """Ideal complex amplitude of each run."""
    return [force(world, w) / kappa(p, w, speed) for speed, w in world.runs]


def threshold(p: Mapping[str, float]) -> float:
    """Threshold speed in closed form, rad/s."""
    r = p["Ds"] / p["D"]
    return float((1 + r) / p["lam"] * np.sqrt((p["K"] + p["K0"]) / (p["M"] + p["Mf"] * r**2)))


# ---- simulation ------------------------------------------------------------------------------


def probe_sigma(world: World, exact: list[ComplexArray]) -> list[Float]:
    """Standard deviation of real and imaginary part of a probe's reading, for each run."""
    rms = np.sqrt(np.mean(np.abs(np.concatenate(exact)) ** 2))
    levels = []
    for (_, w), y in zip(world.runs, exact, strict=True):
        own = world.own * np.sqrt(np.mean(np.abs(y) ** 2))
        shape = np.sqrt((world.constant * rms) ** 2 + own**2 + (world.proportional * np.abs(y)) ** 2)
        levels.append(shape * (world.backward if w[0] < 0 else 1.0))
    return levels


def neighbours(world: World) -> Float:
    """Correlation of a probe's noise between the lines of a run."""
    distance = np.abs(np.subtract.outer(np.arange(world.lines), np.arange(world.lines)))
    return world.averaging**distance if world.averaging else np.maximum(0.0, 1 - world.filters * distance)


def simulate(world: World, rng: np.random.Generator) -> PerturbationTest:
    """One test."""
    p = world.truth
    sigma = probe_sigma(world, responses(world, p))
    root = np.linalg.cholesky(neighbours(world))
    rows: list[dict[str, Any]] = []
    for number, ((speed, w), level) in enumerate(zip(world.runs, sigma, strict=True)):

        def normal(size: Any = w.shape) -> Float:
            return np.asarray(rng.normal(size=size))

        oil = 1 + world.oil * normal(())
        own = {**p, "D": p["D"] * oil, "K0": p["K0"] * oil}
        true_speed = speed * (1 + world.label * normal(())) * (1 + world.speed_jitter * normal())
        jitter = 1 + world.force_jitter * (normal() + 1j * normal()) + world.force_jitter_amplitude * normal()
        gain = 1 + world.gain * normal(())
        y = force(world, w) * gain * jitter / kappa(own, w, true_speed)
        turn = np.exp(1j * world.phase * normal(()))
        phasors = {"x": y, "y": -1j * y} if w[0] > 0 else {"x": y.conj(), "y": 1j * y.conj()}
        for direction, phasor in phasors.items():
            if direction == "y" and not world.both:
                continue
            noise = level * (root @ normal() + 1j * (root @ normal()))
            rows.append(
                {"run": f"run {number}", "speed": speed, "frequency": w, "force_plane": "journal",
                 "force": force(world, w) + 0j, "plane": "journal", "direction": direction,
                 "response": turn * phasor + noise, "sigma": level if world.sigma_given else np.nan}
            )  # fmt: skip
    parts = [{k: np.broadcast_to(np.asarray(v), (world.lines,)) for k, v in row.items()} for row in rows]
    columns: dict[str, Any] = {k: np.concatenate([part[k] for part in parts]) for k in parts[0]}
    return perturbation_test(**columns, source="a simulated test")


# ---- the right noise model -------------------------------------------------------------------


def _real(columns: ComplexArray) -> Float:
    return np.concatenate([columns.real, columns.imag])


def _slope(world: World, change: Any) -> ComplexArray:
    """Derivative of all responses by a small relative change, by central differences."""
    step = 1e-5
    up, down = (np.concatenate(change(world, sign * step)) for sign in (1, -1))
    return np.asarray((up - down) / (2 * step))


def _with(name: str) -> Any:
    def changed(world: World, step: float) -> list[ComplexArray]:
        return responses(world, {**world.truth, name: world.truth[name] * (1 + step)})

    return changed


def _faster(world: World, step: float) -> list[ComplexArray]:
    return responses(replace(world, speeds=tuple(v * (1 + step) for v in world.speeds)), world.truth)


def _thicker(world: World, step: float) -> list[ComplexArray]:
    p = world.truth
    return responses(world, {**p, "D": p["D"] * (1 + step), "K0": p["K0"] * (1 + step)})


def ideal_width(world: World) -> dict[str, float]:
    """Half width of the 95 % interval of generalised least squares with the true covariance."""
    exact = responses(world, world.truth)
    y, count = np.concatenate(exact), len(exact)
    run = np.repeat(np.arange(count), world.lines)
    share = 0.5 if world.both else 1.0
    correlation = np.kron(np.eye(count), neighbours(world))
    level = np.concatenate(probe_sigma(world, exact))
    block = share * correlation * np.outer(level, level)
    cov = np.kron(np.eye(2), block)
    for size, column in (
        (world.force_jitter, y), (world.force_jitter, 1j * y), (world.force_jitter_amplitude, y),
        (world.speed_jitter, _slope(world, _faster)),
    ):  # fmt: skip
        sensitivity = np.concatenate([np.diag(column.real), np.diag(column.imag)])
        cov += size**2 * sensitivity @ sensitivity.T
    backward = np.concatenate([w for _, w in world.runs]) < 0
    for size, column in (
        (world.gain, y), (world.phase, np.where(backward, -1j, 1j) * y), (world.label, _slope(world, _faster)),
        (world.oil, _slope(world, _thicker)),
    ):  # fmt: skip
        sensitivity = _real(column[:, None] * (run[:, None] == np.arange(count)))
        cov += size**2 * sensitivity @ sensitivity.T
    J = _real(np.column_stack([_slope(world, _with(name)) / world.truth[name] for name in FREE]))
    correlated = world.filters < 1 or world.averaging
    if world.speed_jitter or world.force_jitter_amplitude or correlated:  # fits have one weight a reading
        weight = 1 / (np.diag(cov)[: y.size] + np.diag(cov)[y.size :])
        gain = np.linalg.solve(J.T @ (np.tile(weight, 2)[:, None] * J), (np.tile(weight, 2)[:, None] * J).T)
        errors = gain @ cov @ gain.T
    else:
        errors = np.linalg.inv(J.T @ np.linalg.solve(cov, J))
    p = world.truth
    gradient = [
        (threshold({**p, name: p[name] * (1 + 1e-6)}) - threshold({**p, name: p[name] * (1 - 1e-6)})) / (2e-6 * p[name])
        for name in FREE
    ]
    shared = world.gain or world.phase or world.label or world.oil
    quantile = stats.t.ppf(0.975, count - 1) if shared else stats.norm.ppf(0.975)
    directions = {"D": np.eye(5)[1], "lam": np.eye(5)[2], "threshold": np.array(gradient)}
    return {name: float(quantile * np.sqrt(g @ errors @ g)) for name, g in directions.items()}


# ---- the study -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """What a row of the table says.

    Attributes:
        cover_D, cover_lam, cover_threshold: share of 95 % intervals that hold the truth.
        width_D, width_lam, width_threshold: their mean half width over that of the right noise model.
        spread_D, spread_lam, spread_threshold: standard errors of these means, draws being so many.
        redchi: median.
        warned: share of fits with a warning.
        allowed: share of fits whose intervals allow for runs that may differ, without a warning.
        two_runs: share of fits that say that two runs cannot tell what differs from run to run.
        failures: fits that did not converge.
        cpu_ms: median processor time of a fit.
    """

    world: str
    cover_D: float
    cover_lam: float
    cover_threshold: float
    width_D: float
    width_lam: float
    width_threshold: float
    spread_D: float
    spread_lam: float
    spread_threshold: float
    redchi: float
    warned: float
    allowed: float
    two_runs: float
    failures: int
    cpu_ms: float


def interval(entry: Any) -> tuple[float, float]:
    """95 % interval of a parameter or derived quantity, without the systematic share, which hides what noise does."""
    if hasattr(entry, "interval"):
        low, high = entry.interval(0.95, share="noise")
        return float(low), float(high)
    half = 1.959964 * entry.stderr
    return entry.value - half, entry.value + half


def run(name: str, draws: int, seed: int) -> Row:
    """All draws of a world."""
    world = WORLDS[name]
    truth = {"D": world.truth["D"], "lam": world.truth["lam"], "threshold": threshold(world.truth)}
    right = ideal_width(world)
    rng = np.random.default_rng([seed, list(WORLDS).index(name)])
    held: list[list[bool]] = []
    half: list[list[float]] = []
    redchi, warned, allowed, two_runs, failures, times = [], [], [], [], 0, []
    for _ in range(draws):
        test = simulate(world, rng)
        begin = time.process_time()
        known = {"K": world.truth["K"], "Ds": world.truth["Ds"]}
        fit = rf.fit(rf.models.OneMode(), test, known=known, causes=None, **world.options)
        times.append(time.process_time() - begin)
        failures += not fit.success
        pairs = [interval(q) for q in (fit.params["D"], fit.params["lam"], fit.threshold_speed())]
        held.append([low <= truth[n] <= high for n, (low, high) in zip(WATCHED, pairs, strict=True)])
        half.append([(high - low) / 2 / right[n] for n, (low, high) in zip(WATCHED, pairs, strict=True)])
        redchi.append(fit.redchi)
        warned.append(any(one.severity != "note" for one in fit.notices))
        allowed.append(fit.noise is not None and bool(fit.noise.possible_effects))
        two_runs.append(fit.noise is not None and fit.noise.run_count == 2)
    cover, width, spread = np.mean(held, axis=0), np.mean(half, axis=0), np.std(half, axis=0) / np.sqrt(draws)
    return Row(
        name, *map(float, cover), *map(float, width), *map(float, spread), float(np.median(redchi)),
        float(np.mean(warned)), float(np.mean(allowed)), float(np.mean(two_runs)), failures,
        1e3 * float(np.median(times)),
    )  # fmt: skip


CHANCE = 0.01
"""Probability of calling a row short that keeps its promise."""
SURELY = float(stats.norm.isf(CHANCE))


def short_of_promise(row: Row, draws: int) -> list[str]:
    """What a row misses by more than the sampling error of so many draws."""
    world, found = WORLDS[row.world], []
    for name in WATCHED:
        cover, width = getattr(row, f"cover_{name}"), getattr(row, f"width_{name}")
        low = 0.93 if world.ideal else world.promise
        if stats.binom.cdf(round(cover * draws), draws, low) < CHANCE:
            found.append(f"{name} covered in {100 * cover:.0f} %")
        if world.ideal and stats.binom.sf(round(cover * draws) - 1, draws, 0.97) < CHANCE:
            found.append(f"{name} covered in {100 * cover:.0f} %, too many")
        if width > world.widest + SURELY * getattr(row, f"spread_{name}"):
            found.append(f"{name} {width:.2f} wide")
    return found


def least_width(sizes: Sequence[float], cover: float) -> float:
    """Least mean width, over the usual one, that intervals from two runs that agree must have, see above.

    Args:
        sizes: root of se^2 + tau^2 over se at which they must hold.
        cover: share of them that must hold the truth there.
    """
    edges = np.concatenate([np.linspace(0.0, 6.0, 41), np.geomspace(6.5, 900.0, 30)])
    apart = (edges[1:] + edges[:-1]) / 2  # |x1 - x2| over se sqrt(2), and half widths over se / sqrt(2)
    chance = {size: 2 * np.diff(stats.norm.cdf(edges / size)) for size in (1.0, *sizes)}
    usual = float(stats.norm.ppf(0.975))

    def spare(half: Float) -> Float:
        held = [chance[s] @ (2 * stats.norm.cdf(half / s) - 1) + 1 - chance[s].sum() for s in sizes]
        return np.array(held) - cover

    def slope(half: Float) -> Float:
        return np.array([chance[s] * 2 * stats.norm.pdf(half / s) / s for s in sizes])

    safe = np.maximum(usual, stats.t.ppf((1 + cover) / 2 + 0.02, 1) * apart)
    found = optimize.minimize(
        lambda half: chance[1.0] @ half / usual, safe, jac=lambda half: chance[1.0] / usual, method="SLSQP",
        bounds=[(usual, None)] * apart.size, constraints={"type": "ineq", "fun": spare, "jac": slope},
        options={"maxiter": 1000},
    )  # fmt: skip
    if not found.success:
        raise RuntimeError(f"no least width: {found.message}")
    return float(found.fun)


def apart(world: World) -> float:
    """Root of se^2 + tau^2 over se of the force in each of two runs, as far as the fit does not follow it."""
    exact = responses(world, world.truth)
    y = np.concatenate(exact)
    level = np.concatenate(probe_sigma(world, exact)) * np.sqrt(0.5 if world.both else 1.0)
    run = np.repeat([0, 1], world.lines)
    J = _real(np.column_stack([_slope(world, _with(name)) for name in FREE]) / level[:, None])
    half = _real(y * np.where(run == 0, 1, -1) / np.sqrt(2) / level)
    own = half - J @ np.linalg.lstsq(J, half, rcond=None)[0]
    return float(np.sqrt(1 + world.gain**2 * (own @ own)))


def of_two_runs(rows: Sequence[Row]) -> list[str]:
    """What two runs can tell at best."""
    share = WORLDS["force 1 %, two runs"].promise
    every = least_width([float(size) for size in np.geomspace(1.0, 100.0, 25)], share)
    found = [
        f"- two runs: no rule holds the truth in {100 * share:.0f} % whatever the size of what differs without making "
        f"error bars of two runs that agree {every:.2f} times as wide on average; where they agree by chance, nothing "
        "in the data can know"
    ]
    for row in rows:
        world = WORLDS[row.world]
        if len(world.runs) == 2:
            size = apart(world)
            least = f", for which alone {least_width([size], share):.2f} times would do" if size > 1 else ""
            found.append(
                f"- {row.world}: they scatter {size:.1f} times as much as by their own noise{least}; D covered in "
                f"{100 * row.cover_D:.0f} %; {100 * row.two_runs:.0f} % of the fits say that two runs cannot tell"
            )
    return found


def main(arguments: list[str] | None = None) -> int:
    """Run all rows, write the table beside the earlier one, tell whether the promises hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=9)
    parser.add_argument("--only", action="append", choices=list(WORLDS), help="only these rows")
    parser.add_argument("--before", action="store_true", help="keep the result as the one to compare with")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    rows = [run(name, options.draws, options.seed) for name in options.only or WORLDS]
    command = f"python benchmarks/honest_errors.py --draws {options.draws} --seed {options.seed}"
    made = [f"made with {command}", environment("casadi", "numpy", "scipy")]
    earlier = options.out / "honest_errors_before.csv"
    write_csv(rows, earlier if options.before else options.out / "honest_errors.csv", *made)
    before = {} if options.before or not earlier.exists() else _earlier(earlier)
    misses = {row.world: found for row in rows if (found := short_of_promise(row, options.draws))}
    lines = [
        "# Error bars where noise is not ideal and runs differ", "", f"Made with `{command}` on {made[1]}.", "",
        "Shares of 95 % intervals of D, lam and threshold speed that hold the truth, and their mean width over that of "
        "the right noise model; in front of an arrow what the version before this study gave.", "",
        *table(
            [
                "noise, runs", "cover D, lam, threshold, %", "width D, lam, threshold", "redchi", "warned, %",
                "runs may differ, %", "ms",
            ],
            [_cells(row, before.get(row.world)) for row in rows],
        ),
        "",
    ]  # fmt: skip
    lines += [f"- short of the promise: {name}: {', '.join(found)}" for name, found in misses.items()]
    lines += of_two_runs(rows)
    text = "\n".join(lines).rstrip() + "\n"
    if not options.before:
        (options.out / "honest_errors.md").write_text(text, encoding="utf-8")
    print(text)
    return int(bool(misses))


def _earlier(path: Path) -> dict[str, Mapping[str, str]]:
    with path.open(encoding="utf-8") as stream:
        return {row["world"]: row for row in csv.DictReader(line for line in stream if not line.startswith("#"))}


def _cells(row: Row, before: Mapping[str, str] | None) -> list[str]:
    def shown(values: list[float], form: str) -> str:
        return ", ".join(format(v, form) for v in values)

    def both(names: list[str], form: str, factor: float = 1.0) -> str:
        now = shown([factor * getattr(row, n) for n in names], form)
        return now if before is None else f"{shown([factor * float(before[n]) for n in names], form)} -> {now}"

    return [
        row.world, both([f"cover_{n}" for n in WATCHED], ".0f", 100), both([f"width_{n}" for n in WATCHED], ".2f"),
        both(["redchi"], ".3g"), both(["warned"], ".0f", 100), f"{100 * row.allowed:.0f}", both(["cpu_ms"], ".0f"),
    ]  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
