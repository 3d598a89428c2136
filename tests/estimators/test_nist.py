"""The 27 certified nonlinear regression problems of NIST, from both certified starting points."""

import json
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from symbolic_residuals import SymbolicResiduals

from rotorfit.estimators.minimisation.least_squares import Solution, Status, minimise

PROBLEMS: dict[str, dict[str, Any]] = json.loads(
    (Path(__file__).parents[1] / "data" / "nist" / "nist.json").read_text(encoding="utf-8")
)
Model = Callable[[Any, Any], Any]

# From these starts the outcome depends on the last bit of the linear algebra: MGH10 meets the iteration limit
# 200 times above the minimum; MGH17 mostly converges, but may end where its two exponentials merge.
HARD = {("MGH10", "start1"), ("MGH17", "start1")}
# NIST certifies 10 or 11 digits.  Standard errors of Lanczos1 belong to residuals that are round-off.
DIGITS = 9.0
ROUND_OFF_RESIDUALS = {"Lanczos1"}


def two_gaussians(b: Any, x: Any) -> Any:
    peaks = [b[i] * ca.exp(-(((x - b[i + 1]) / b[i + 2]) ** 2)) for i in (2, 5)]
    return b[0] * ca.exp(-b[1] * x) + peaks[0] + peaks[1]


def three_exponentials(b: Any, x: Any) -> Any:
    return b[0] * ca.exp(-b[1] * x) + b[2] * ca.exp(-b[3] * x) + b[4] * ca.exp(-b[5] * x)


def cubic_ratio(b: Any, x: Any) -> Any:
    return (b[0] + b[1] * x + b[2] * x**2 + b[3] * x**3) / (1 + b[4] * x + b[5] * x**2 + b[6] * x**3)


def saturation(b: Any, x: Any) -> Any:
    return b[0] * (1 - ca.exp(-b[1] * x))


def damped_ratio(b: Any, x: Any) -> Any:
    return ca.exp(-b[0] * x) / (b[1] + b[2] * x)


def cycles(b: Any, x: Any) -> Any:
    def wave(cosine: Any, sine: Any, period: Any) -> Any:
        phase = 2 * math.pi * x / period
        return cosine * ca.cos(phase) + sine * ca.sin(phase)

    return b[0] + wave(b[1], b[2], 12) + wave(b[4], b[5], b[3]) + wave(b[7], b[8], b[6])


MODELS: dict[str, Model] = {
    "Bennett5": lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
    "BoxBOD": saturation,
    "Chwirut1": damped_ratio,
    "Chwirut2": damped_ratio,
    "DanWood": lambda b, x: b[0] * x ** b[1],
    "ENSO": cycles,
    "Eckerle4": lambda b, x: b[0] / b[1] * ca.exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Gauss1": two_gaussians,
    "Gauss2": two_gaussians,
    "Gauss3": two_gaussians,
    "Hahn1": cubic_ratio,
    "Kirby2": lambda b, x: (b[0] + b[1] * x + b[2] * x**2) / (1 + b[3] * x + b[4] * x**2),
    "Lanczos1": three_exponentials,
    "Lanczos2": three_exponentials,
    "Lanczos3": three_exponentials,
    "MGH09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "MGH10": lambda b, x: b[0] * ca.exp(b[1] / (x + b[2])),
    "MGH17": lambda b, x: b[0] + b[1] * ca.exp(-x * b[3]) + b[2] * ca.exp(-x * b[4]),
    "Misra1a": saturation,
    "Misra1b": lambda b, x: b[0] * (1 - (1 + b[1] * x / 2) ** -2),
    "Misra1c": lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x) ** -0.5),
    "Misra1d": lambda b, x: b[0] * b[1] * x / (1 + b[1] * x),
    "Nelson": lambda b, x: b[0] - b[1] * x[:, 0] * ca.exp(-b[2] * x[:, 1]),
    "Rat42": lambda b, x: b[0] / (1 + ca.exp(b[1] - b[2] * x)),
    "Rat43": lambda b, x: b[0] / (1 + ca.exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "Roszman1": lambda b, x: b[0] - b[1] * x - ca.atan(b[2] / (x - b[3])) / math.pi,
    "Thurber": cubic_ratio,
}


@cache
def residuals(name: str) -> SymbolicResiduals:
    data = np.array(PROBLEMS[name]["data"])
    y = np.log(data[:, 0]) if name == "Nelson" else data[:, 0]
    b = ca.SX.sym("b", len(PROBLEMS[name]["certified"]))
    return SymbolicResiduals(MODELS[name](b, ca.DM(data[:, 1:])) - ca.DM(y), b)


@cache
def solve(name: str, start: str) -> Solution:
    return minimise(residuals(name), PROBLEMS[name][start])


def digits(values: NDArray[np.float64], certified: list[float]) -> float:
    """Smallest number of correct significant digits, at most the 11 that are certified."""
    error = np.max(np.abs(values - certified) / np.abs(certified))
    return 11.0 if error < 1e-11 else float(-np.log10(error))


CASES = [
    pytest.param(name, start, id=f"{name}-{start}")
    for name in PROBLEMS
    for start in ("start1", "start2")
    if (name, start) not in HARD
]


def test_all_problems_are_there() -> None:
    assert set(PROBLEMS) == set(MODELS)
    assert len(PROBLEMS) == 27
    assert len(CASES) == 52  # all 27 from the second start, 25 from the first


@pytest.mark.parametrize(("name", "start"), CASES)
def test_certified_parameters(name: str, start: str) -> None:
    solution = solve(name, start)
    assert solution.success, solution.message
    assert digits(solution.x, PROBLEMS[name]["certified"]) >= DIGITS


@pytest.mark.parametrize(("name", "start"), [c for c in CASES if c.values[0] not in ROUND_OFF_RESIDUALS])
def test_certified_standard_errors_and_misfit(name: str, start: str) -> None:
    solution = solve(name, start)
    assert 2 * solution.cost == pytest.approx(PROBLEMS[name]["rss"], rel=1e-9)
    jacobian = residuals(name).jacobian(solution.x)
    m, n = jacobian.shape
    triangle = np.linalg.inv(np.linalg.qr(jacobian, mode="r"))
    errors = np.sqrt(2 * solution.cost / (m - n) * np.sum(triangle**2, axis=1))
    assert digits(errors, PROBLEMS[name]["deviation"]) >= DIGITS


def test_round_off_residuals_are_recognised_as_a_perfect_fit() -> None:
    for start in ("start1", "start2"):
        assert solve("Lanczos1", start).cost < 1e-22


@pytest.mark.parametrize(("name", "start"), sorted(HARD))
def test_a_hard_start_gives_the_certified_answer_or_says_that_it_did_not(name: str, start: str) -> None:
    solution = solve(name, start)
    if solution.success:
        assert digits(solution.x, PROBLEMS[name]["certified"]) >= DIGITS
    else:
        assert solution.status in (Status.ITERATION_LIMIT, Status.STALLED, Status.SINGULAR)
        assert solution.cost < residuals(name).cost(np.array(PROBLEMS[name][start], dtype=float))


def main() -> None:
    """Print the digits per problem and start."""
    for name in PROBLEMS:
        runs = [solve(name, start) for start in ("start1", "start2")]
        print(
            f"{name:10s}",
            *(f"{digits(r.x, PROBLEMS[name]['certified']):6.1f} {r.n_iterations:4d}" for r in runs),
        )


if __name__ == "__main__":
    main()
