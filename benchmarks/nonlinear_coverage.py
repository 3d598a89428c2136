"""Coverage of standard errors of nonlinear rotors: sweeps, static loads, impulses, squeeze film, and all in one fit.

    python benchmarks/nonlinear_coverage.py --draws 200

writes results/nonlinear_coverage.md and results/nonlinear_coverage.csv. The data come from formulas written out in
tests/rigs/law_data.py, not from rotorfit's models. Fits begin at the truth, which leads into the right minimum; tests
fit the same kinds of data from rotorfit's own starts. Exit status 1 says that pulls are off by more than sampling
error.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
sys.path.insert(0, str(HERE.parent / "tests" / "rigs"))  # the formulas live with the tests

from law_data import CLEARANCE_UM, LIGHT, WHIRL_WHIP, impulse, squeeze, static, sweep  # noqa: E402
from reporting import RESULTS, environment, table, write_csv  # noqa: E402

import rotorfit as rf  # noqa: E402
from rotorfit.lab.data.experiments import PerturbationTest  # noqa: E402
from rotorfit.lab.data.rows import Experiment  # noqa: E402
from rotorfit.lab.kinds.displacement_test import DisplacementTest  # noqa: E402
from rotorfit.lab.kinds.free_vibration import ImpulseTest  # noqa: E402
from rotorfit.lab.kinds.static_test import StaticTest  # noqa: E402

TAIL = 1e-3
"""Chance that a pull of exact errors fails a limit, over all of them together."""


@dataclass(frozen=True)
class Row:
    """One parameter in one kind of data.

    Attributes:
        data: what was fitted.
        stderr_percent: median standard error, of the true value.
        rms_pull: root-mean-square error over stated standard error (of the noise alone).
        covered: share of the draws within 1.96 standard errors.
        cpu_ms: median processor time of a fit.
        failures: draws whose fit did not converge.
    """

    data: str
    parameter: str
    stderr_percent: float
    rms_pull: float
    covered: float
    cpu_ms: float
    failures: int


def noisy(test: Experiment, rng: np.random.Generator) -> Experiment:
    """A draw of the noise that ``sigma`` tells, on exact data."""

    def error(sigma: NDArray[np.float64]) -> NDArray[np.complex128]:
        return np.asarray(sigma * (rng.normal(size=sigma.size) + 1j * rng.normal(size=sigma.size)), dtype=complex)

    match test:
        case PerturbationTest():
            return replace(test, response=test.response + error(test.sigma))
        case StaticTest():
            return replace(test, displacement=test.displacement + error(test.sigma))
        case DisplacementTest():
            return replace(test, force_x=test.force_x + error(test.sigma), force_y=test.force_y + error(test.sigma))
        case ImpulseTest():
            s = test.eigenvalue + error(test.sigma)
            return replace(test, frequency=s.imag, damping_ratio=-s.real / np.abs(s))
    raise TypeError(f"no noise for {type(test).__name__}")


def with_noise_level(test: Any, share: float) -> Any:
    """Exact data with the sigma that noise of a share of the rms signal will have."""
    signal = test.response if isinstance(test, PerturbationTest) else test.force_x
    runs = np.array([np.sqrt(np.mean(np.abs(signal[test.run == run]) ** 2)) for run in test.run.tolist()])
    return replace(test, sigma=share * runs)


def cases() -> dict[str, tuple[rf.models.RotorModel, Mapping[str, float], list[Experiment], dict[str, float]]]:
    """Model, truth, exact data and what is known, by name."""
    law = rf.models.Muszynska()
    one = rf.models.OneMode(law=law, clearance_um=CLEARANCE_UM)
    two = rf.models.WhirlWhip(law=law, clearance_um=CLEARANCE_UM)
    swept = with_noise_level(sweep(LIGHT, levels=(0.5, 1.4, 2.8, 4.5), lines=40, noise=0.0), 0.01)
    loaded = replace(static(LIGHT, sigma=0.0), sigma=np.full(18, 0.3e-6))
    hit = replace(impulse(LIGHT, sigma=0.0), sigma=np.full(10, 0.3))
    film = with_noise_level(squeeze(LIGHT, noise=0.0), 0.01)
    planes = with_noise_level(sweep(WHIRL_WHIP, levels=(1.0, 3.0, 6.0, 9.0), lines=60, noise=0.0), 0.01)
    own = {"Ds": 8.0}
    masses = own | {"M": 1.2, "Mf": 0.4}
    return {
        "sweeps, four levels": (one, LIGHT, [swept], own),
        "static loads (M, Mf, D known)": (one, LIGHT, [loaded], masses | {"D": 150.0}),
        "impulses (M, Mf known)": (one, LIGHT, [hit], masses),
        "squeeze film (M, lam, b known)": (one, LIGHT, [film], own | {"M": 1.2, "lam": 0.46, "b": 0.5}),
        "all in one fit": (one, LIGHT, [swept, loaded, hit, film], own),
        "sweeps of two planes": (two, WHIRL_WHIP, [planes], {"K3": 6000.0, "sigma": 1.0}),
    }


def run(name: str, draws: int, seed: int) -> list[Row]:
    """All draws of a case."""
    model, truth, exact, known = cases()[name]
    start = {n: v for n, v in truth.items() if n not in known}
    rng = np.random.default_rng(seed)
    errors, stated, times, failures = [], [], [], 0
    for _ in range(draws):
        data = [noisy(test, rng) for test in exact]
        begin = time.process_time()
        fit = rf.fit(model, data, known=known, start=start, causes=None)
        times.append(time.process_time() - begin)
        failures += not fit.success
        errors.append([fit.params[n].value - truth[n] for n in start])
        stated.append([fit.params[n].noise for n in start])
    pull = np.array(errors) / np.array(stated)
    middle = np.median(stated, axis=0)
    return [
        Row(
            name, n, 100 * float(middle[i]) / abs(truth[n]), float(np.sqrt(np.mean(pull[:, i] ** 2))),
            float(np.mean(np.abs(pull[:, i]) < 1.96)), 1e3 * float(np.median(times)), failures,
        )
        for i, n in enumerate(start)
    ]  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Run all cases, write the table, tell whether the errors are honest."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=4)
    parser.add_argument("--case", action="append", choices=list(cases()), help="only these")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    rows = [row for name in options.case or cases() for row in run(name, options.draws, options.seed)]
    tail = TAIL / (4 * len(rows))
    squares = np.sqrt(stats.chi2.ppf([tail, 1 - tail], options.draws) / options.draws)
    shares = stats.binom.ppf([tail, 1 - tail], options.draws, 0.95) / options.draws
    bad = [
        row
        for row in rows
        if not (squares[0] <= row.rms_pull <= squares[1] and shares[0] <= row.covered <= shares[1]) or row.failures
    ]
    command = f"python benchmarks/nonlinear_coverage.py --draws {options.draws} --seed {options.seed}"
    made = [f"made with {command}", environment("casadi", "numpy", "scipy")]
    write_csv(rows, options.out / "nonlinear_coverage.csv", *made)
    lines = [
        "# Standard errors of nonlinear rotors over draws of the noise", "", f"Made with `{command}` on {made[1]}.", "",
        f"Limits for exact errors: rms pull {squares[0]:.2f} to {squares[1]:.2f}, covered {shares[0]:.3f} to "
        f"{shares[1]:.3f} ({TAIL:g} over the whole table). Outside: {len(bad)}.", "",
        *table(
            ["data", "parameter", "stderr, %", "rms error / stderr", "within 1.96 stderr", "fit, ms", "failures"],
            [
                [r.data, r.parameter, f"{r.stderr_percent:.3g}", f"{r.rms_pull:.2f}", f"{r.covered:.3f}",
                 f"{r.cpu_ms:.0f}", str(r.failures)]
                for r in rows
            ],
        ),
    ]  # fmt: skip
    (options.out / "nonlinear_coverage.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
