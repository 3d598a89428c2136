"""From the closed-form start the optimum is found, for whole families of rigs."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import KNOWN, MODELS, SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of, random_stable_rigs

import rotorfit as rf

COUNT = 200


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
    """200 random stable rigs, 1 % noise: never a worse minimum than a fit that starts from the truth."""
    model = MODELS[name]()
    for number, truth in enumerate(random_stable_rigs(name, COUNT, seed=3)):
        theta = model.vector(truth)
        frequency = covering_frequencies(model, theta, SPEEDS[name], 200)
        test = circular_test(
            model, theta, speeds=SPEEDS[name], frequency=frequency, noise=0.01, seed=number, sigma_known=True
        )
        known = known_of(name, truth)
        fit = rf.fit(model, test, known=known)
        from_truth = rf.fit(model, test, known=known, start={k: v for k, v in truth.items() if k not in known})
        assert fit.success, (number, fit.message)
        # Minima agree to the optimiser's tolerance on the cost; another minimum would differ by far more.
        assert fit.chisqr <= from_truth.chisqr * (1 + 1e-7), number
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
        costs.append(rf.fit(model, test, known=known, start=start).chisqr)
    assert fit.chisqr <= min(costs) * (1 + 1e-7)
    assert min(costs) == pytest.approx(fit.chisqr, rel=1e-6)
