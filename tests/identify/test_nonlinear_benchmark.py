"""A small version of the benchmark of amplitude sweeps: stated errors hold, and a linear fluid is rejected."""

from __future__ import annotations

import numpy as np
import pytest

import rotorfit as rf
from rotorfit.estimators.blocks.nonlinear import OrbitResponses
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.settings import FitSettings


@pytest.mark.slow
def test_errors_of_nonlinear_fits_to_integrated_data_are_as_stated_and_linear_fits_are_rejected() -> None:
    from nonlinear import LINEAR, POWER, SUM, TRUTH, exact_sweeps, honest, largest_orbit, study

    exact = exact_sweeps(16, tolerance=1e-6)
    assert largest_orbit(exact) == pytest.approx(0.68, abs=0.03)
    draws = 40
    power, _ = study(exact, draws, seed=2, fitted=(POWER,))
    assert {row.parameter for row in power} == {*TRUTH, SUM} - {"Ds"}
    for row in power:
        # both within 3.5 sampling errors of so many draws
        assert honest(row, draws), row
    rows, worse = study(exact, 4, seed=2, fitted=(POWER, LINEAR))  # no draw of 1 % noise hides the law
    assert worse.min() > 1000.0
    linear = next(row for row in rows if row.fit == LINEAR and row.parameter == "lam")
    assert linear.covered == 0.0
    # Its stated errors hold what differs between the levels of the force, so the bias is a few of them, not hundreds;
    # that the fluid is not linear is said by redchi.
    assert linear.redchi > 100.0
    assert np.abs(linear.bias) > 2.0


def test_the_rival_of_the_speed_benchmark_solves_the_same_equation() -> None:
    """By hand in NumPy, with its own Newton's method."""
    import nonlinear_rival
    from law_data import CLEARANCE, CLEARANCE_UM, ONE_MODE, sweep

    model = rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=CLEARANCE_UM)
    problem = build_problem(model, sweep(ONE_MODE, levels=(1.0, 5.0), lines=10), FitSettings())
    (block,) = problem.blocks
    assert isinstance(block, OrbitResponses)
    base, line = block.base, block.base.line
    data = {
        "w": base.frequency[line], "speed": base.speed[line], "force": base.force[line, 0], "clearance": CLEARANCE,
        "eps": block.eccentricity[0, line],
    }  # fmt: skip
    found = nonlinear_rival.response(ONE_MODE, data)
    np.testing.assert_allclose(found, block.predict(model.vector(ONE_MODE)[None]), rtol=1e-10)
