"""From the closed-form start the optimum is found, for whole families of rigs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize
from synthetic import KNOWN, MODELS, SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of, random_stable_rigs

import rotorfit as rf

COUNT = 80
"""Rigs of each model; a start that leads astray in one rig of a hundred is met by 400 with probability 98 %."""


def least_cost_near(problem, values):
    """Cost of the minimum that SciPy's trust region finds from a vector, every parameter in units of its start."""
    scale = np.where(values == 0, 1.0, np.abs(values))
    return minimize(
        lambda u: problem.gauss_newton(u * scale)[0], values / scale, method="trust-exact",
        jac=lambda u: problem.gauss_newton(u * scale)[1] * scale,
        hess=lambda u: problem.gauss_newton(u * scale)[2] * np.outer(scale, scale), options={"maxiter": 60},
    ).fun  # fmt: skip


def nearer(problem, values):
    """Parameters that MINPACK fits to logarithms of the readings, whose cost has far fewer minima."""
    scale = np.abs(values)
    measured = np.concatenate([block.measured for block in problem.blocks])
    sigma = np.concatenate([block.sigma for block in problem.blocks])

    def ratio(u):
        return 1 + problem.residuals(u * scale) * sigma / measured

    def parts(z):
        return np.concatenate([z.real, z.imag])

    def slope(u):
        return parts(problem.jacobian(u * scale)[1] * scale * (sigma / (measured * ratio(u)))[:, None])

    start = values / scale
    return scale * least_squares(lambda u: parts(np.log(ratio(u))), start, slope, method="lm", x_scale="jac").x


@pytest.mark.parametrize("name", MODELS)
def test_noise_free_data_give_the_parameters_back(name):
    model, truth = MODELS[name](), TYPICAL[name]
    theta = model.vector(truth)
    frequency = covering_frequencies(model, theta, SPEEDS[name], 200)
    test = circular_test(model, theta, speeds=SPEEDS[name], frequency=frequency)
    known = known_of(name, truth)
    for result in (rf.closed_form(model, test, known=known), rf.fit(model, test, known=known)):
        assert result.success
        for key, value in truth.items():
            assert result.params[key].value == pytest.approx(value, rel=1e-8)


@pytest.mark.parametrize("name", MODELS)
def test_optimum_found_from_the_closed_form_start(name):
    """Random stable rigs, 1 % noise: never a worse minimum than a search that starts from the truth."""
    model = MODELS[name]()
    for number, truth in enumerate(random_stable_rigs(name, COUNT, seed=3)):
        theta = model.vector(truth)
        frequency = covering_frequencies(model, theta, SPEEDS[name], 200)
        test = circular_test(
            model, theta, speeds=SPEEDS[name], frequency=frequency, noise=0.01, seed=number, sigma_known=True
        )
        known = known_of(name, truth)
        fit = rf.fit(model, test, known=known)
        assert fit.success, (number, fit.message)
        from_truth = least_cost_near(fit.problem, np.array([truth.get(name, 0.0) for name in fit.var_names]))
        # Minima agree to the optimiser's tolerance on the cost; another minimum would differ by far more.
        assert fit.problem.cost(fit.x) <= from_truth * (1 + 1e-7), number
        # chi-squared has mean nfree and standard deviation sqrt(2 nfree); 6 sd for 1000 rigs.
        assert abs(fit.chisqr - fit.nfree) < 6 * np.sqrt(2 * fit.nfree), number


@pytest.mark.parametrize("name", MODELS)
def test_multistart_finds_no_better_optimum(name):
    """A general multistart (a bundle of starts spread over a decade) agrees with the closed-form start."""
    model = MODELS[name]()
    truth = random_stable_rigs(name, 1, seed=11)[0]
    theta = model.vector(truth)
    frequency = covering_frequencies(model, theta, SPEEDS[name], 200)
    test = circular_test(model, theta, speeds=SPEEDS[name], frequency=frequency, noise=0.01, seed=5, sigma_known=True)
    known = known_of(name, truth)
    fit = rf.fit(model, test, known=known)
    rng = np.random.default_rng(1)
    costs = []
    for _ in range(12):
        start = {k: v * 10 ** rng.uniform(-0.5, 0.5) for k, v in truth.items() if k not in KNOWN[name]}
        limits = {k: (model.parameter(k).lower, model.parameter(k).upper) for k in start}
        start = {k: float(np.clip(v, *limits[k])) for k, v in start.items()}
        costs.append(least_cost_near(fit.problem, nearer(fit.problem, np.array([start[k] for k in fit.var_names]))))
    cost = fit.problem.cost(fit.x)
    assert cost <= min(costs) * (1 + 1e-7)
    assert min(costs) == pytest.approx(cost, rel=1e-6)
