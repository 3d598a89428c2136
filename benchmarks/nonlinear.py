"""Amplitude sweeps of a nonlinear fluid: the exact one-phasor fit against linear fits, over many draws of the noise.

The data come from integration of the equation of motion in time, not from the equation that is fitted: four force
levels, orbits up to 0.7 of the clearance, 1 % noise. Fitted are the power law by which they were made, a linear fluid
to all levels, and a linear fluid to the smallest level, as one would do without a law. Exit status 1 says that the
errors of the nonlinear fit are not what they are stated to be, or that a linear fluid was not rejected.

    python benchmarks/nonlinear.py
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
from reporting import RESULTS, environment, table, write_csv

import rotorfit as rf
from rotorfit.base.array_types import Float
from rotorfit.models.motion.journal import journal

TRUTH = {
    "M": 1.2, "K": 8000.0, "Ds": 8.0, "K0": 9000.0, "D": 450.0, "lam": 0.46, "Mf": 0.4, "n_K": 2.0, "n_D": 1.4,
    "b": 0.5,
}  # fmt: skip
LEVELS = (0.7, 1.8, 3.4, 5.2)
NOISE = 0.01
SUM = "K + K0"
SIGMAS = 3.5
"""Sampling errors by which a share of draws, or a mean error, may differ from what is expected."""


@dataclass(frozen=True)
class Row:
    """One parameter in one way of fitting, over all draws.

    Attributes:
        fit: law and data.
        stderr_percent: median stated standard error, of the true value.
        bias: mean error over the median stated standard error.
        rms_percent: root-mean-square error, of the true value.
        covered: share of the draws within 1.96 stated standard errors (of the noise alone).
        redchi: median.
        cpu_ms: median processor time of a fit.
        failures: draws whose fit did not converge.
    """

    fit: str
    parameter: str
    stderr_percent: float
    bias: float
    rms_percent: float
    covered: float
    redchi: float
    cpu_ms: float
    failures: int


def exact_sweeps(frequencies: int, tolerance: float = 1e-7) -> rf.PerturbationTest:
    """The test without noise, by integration in time; sigma is what the noise will have."""
    half = np.linspace(200, 2600, frequencies // 2)
    test = rf.simulate(
        nonlinear(), TRUTH, speed_rpm=1000.0, frequency_rpm=np.concatenate([-half, half]), force=LEVELS,
        noise=0.0, tolerance=tolerance,
    )  # fmt: skip
    assert isinstance(test, rf.PerturbationTest)
    sigma = np.empty(len(test))
    for level in LEVELS:
        rows = np.abs(test.force) == level
        sigma[rows] = NOISE * np.sqrt(np.mean(np.abs(test.response[rows]) ** 2))
    return replace(test, sigma=sigma)


def nonlinear() -> rf.models.OneMode:
    """The rotor with the law that made the data."""
    return rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=200.0)


def largest_orbit(test: rf.PerturbationTest) -> float:
    """Largest eccentricity of the test; orbits are circles, so one probe sees it."""
    return float(np.abs(test.response).max() / journal(nonlinear()).clearance)


WAYS = (POWER := "power law, all levels", LINEAR := "linear, all levels", SMALLEST := "linear, smallest level")


def study(
    exact: rf.PerturbationTest, draws: int, seed: int = 0, fitted: tuple[str, ...] = WAYS
) -> tuple[list[Row], Float]:
    """Fit every draw in some ways; also the AIC of the linear fluid minus that of the power law in each draw."""
    small = np.abs(exact.force) == LEVELS[0]
    linear_known = {"Ds": TRUTH["Ds"], "K": TRUTH["K"]}  # of K + K0 a linear fluid knows the sum only
    ways: dict[str, tuple[rf.models.RotorModel, NDArray[np.bool_], dict[str, float]]] = {
        POWER: (nonlinear(), np.ones(len(exact), dtype=bool), {"Ds": TRUTH["Ds"]}),
        LINEAR: (rf.models.OneMode(), np.ones(len(exact), dtype=bool), linear_known),
        SMALLEST: (rf.models.OneMode(), small, linear_known),
    }
    rng = np.random.default_rng(seed)
    fits: dict[str, list[tuple[rf.FitResult, float]]] = {way: [] for way in fitted}
    for _ in range(draws):
        error = rng.normal(size=len(exact)) + 1j * rng.normal(size=len(exact))
        noisy = replace(exact, response=exact.response + exact.sigma * error)
        for way in fitted:
            model, rows, known = ways[way]
            begin = time.process_time()
            result = rf.fit(model, noisy.select(rows), known=known, causes=None)
            fits[way].append((result, time.process_time() - begin))
    pairs = zip(fits.get(POWER, []), fits.get(LINEAR, []), strict=False)
    worse = [linear.aic - power.aic for (power, _), (linear, _) in pairs]
    return [row for way, results in fits.items() for row in _rows(way, results)], np.array(worse)


def _rows(way: str, results: list[tuple[rf.FitResult, float]]) -> list[Row]:
    good = [fit for fit, _ in results if fit.success]
    names = [q.name for q in good[0].params.values() if q.vary]
    rows = []
    for name in [*names, SUM] if "K" in names else names:
        true = TRUTH["K"] + TRUTH["K0"] if name == SUM else TRUTH[name]
        pairs = np.array([_estimate(fit, name) for fit in good])
        error, stderr = pairs[:, 0] - true, pairs[:, 1]
        rows.append(
            Row(
                way,
                name,
                100 * float(np.median(stderr)) / true,
                float(error.mean() / np.median(stderr)),
                100 * float(np.sqrt(np.mean(error**2))) / true,
                float(np.mean(np.abs(error) < 1.96 * stderr)),
                float(np.median([fit.redchi for fit in good])),
                1e3 * float(np.median([cpu for _, cpu in results])),
                len(results) - len(good),
            )
        )
    return rows


def _estimate(fit: rf.FitResult, name: str) -> tuple[float, float]:
    """Value and standard error from the noise alone."""
    if name != SUM:
        return fit.params[name].value, fit.params[name].noise
    gradient = np.array([float(parameter in ("K", "K0")) for parameter in fit.model.parameter_names])
    both = fit.propagate(fit.params["K"].value + fit.params["K0"].value, gradient, "N/m")
    return both.value, both.stderr / np.sqrt(max(1.0, fit.redchi))


def honest(row: Row, draws: int) -> bool:
    """Whether bias and coverage of a parameter are those of its stated error, within the sampling error."""
    share = SIGMAS * np.sqrt(0.95 * 0.05 / draws)
    return row.failures == 0 and abs(row.covered - 0.95) <= share and abs(row.bias) <= SIGMAS / np.sqrt(draws)


def report(rows: list[Row], worse: Float, command: str, draws: int, orbit: float) -> list[str]:
    """The results as Markdown."""
    cells = [
        [r.fit, r.parameter, f"{r.stderr_percent:.2g}", f"{r.rms_percent:.2g}", f"{r.bias:+.2f}", f"{r.covered:.3f}",
         f"{r.redchi:.3g}", f"{r.cpu_ms:.0f}", str(r.failures)]
        for r in rows
    ]  # fmt: skip
    head = ["fit", "parameter", "stated error, %", "rms error, %", "bias / stated error", "within 1.96 errors",
            "redchi", "ms a fit", "failures"]  # fmt: skip
    return [
        "# Amplitude sweeps: exact nonlinear fit against linear fits", "",
        f"`{command}`; {environment('numpy', 'scipy', 'casadi')}.", "",
        f"{draws} draws of {NOISE:.0%} noise on sweeps at {len(LEVELS)} force levels, orbits up to {orbit:.2f} of the "
        "clearance, made by integration in time. Known: Ds; for the linear fluid K too, since it sees the sum K + K0.",
        "", *table(head, cells), "",
        f"A linear fluid is worse in AIC by {worse.min():.4g} or more in every draw.", "",
    ]  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Run the study and write its results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--frequencies", type=int, default=40)
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    exact = exact_sweeps(options.frequencies)
    rows, worse = study(exact, options.draws)
    command = f"python benchmarks/nonlinear.py --draws {options.draws} --frequencies {options.frequencies}"
    lines = report(rows, worse, command, options.draws, largest_orbit(exact))
    (options.out / "nonlinear.md").write_text("\n".join(lines), encoding="utf-8")
    write_csv(rows, options.out / "nonlinear.csv", command, environment("numpy", "scipy", "casadi"))
    print("\n".join(lines))
    wrong = [row for row in rows if row.fit.startswith("power") and not honest(row, options.draws)]
    return int(bool(wrong) or worse.min() <= 10.0)


if __name__ == "__main__":
    sys.exit(main())
