"""Models of a user's own that change with eccentricity or frequency: all that is done with a model of this package."""

from __future__ import annotations

import numpy as np
import pytest
from own_nonlinear import (
    DAMPER,
    SEAL,
    THREE,
    Damper,
    LaggingSeal,
    ThreeModes,
    damper_stiffness,
    damper_tests,
    seal_tests,
    three_tests,
)
from sentences import refuses

import rotorfit as rf

CASES = {
    "damper": (Damper(), damper_tests, DAMPER, "short fit"),
    "three": (ThreeModes(), three_tests, THREE, "short fit"),
    "seal": (LaggingSeal(), seal_tests, SEAL, "random starts"),
}


@pytest.fixture(scope="module", params=CASES)
def case(request):
    """A model, its fit, the truth, and where its search should begin."""
    model, tests, truth, start = CASES[request.param]
    return model, rf.fit(model, tests()), truth, start


def test_the_truth_is_found_from_the_models_own_start(case) -> None:
    _, fit, truth, start = case
    assert fit.success
    assert fit.start == start
    assert 0.8 < fit.redchi < 1.2
    for name, value in truth.items():
        assert abs(fit.params[name].value - value) < 3 * fit.params[name].stderr, name
        low, high = fit.interval(name, level=0.999)
        assert low < value < high
    assert "parameter" in fit.summary()
    # a start that is given for one value leaves the others to the data
    again = rf.fit(case[0], fit.experiments, start={next(iter(truth)): next(iter(truth.values()))})
    assert again.chisqr == pytest.approx(fit.chisqr, rel=1e-6)


def test_draws_and_repeated_fits_agree_with_the_errors(case) -> None:
    model, fit, truth, _ = case
    plain = rf.fit(model, fit.experiments, causes=None)
    posterior, drawn = plain.sample(seed=1, ess=400), plain.bootstrap(n=60, seed=2)
    for name in truth:
        assert posterior.parameter(name).stderr == pytest.approx(plain.params[name].stderr, rel=0.15)
        assert drawn.stderr[name] == pytest.approx(plain.params[name].stderr, rel=0.35)  # of 60 draws: 9 % each


def test_a_film_without_mass_is_integrated_in_time() -> None:
    """Its row, which lacks inertia, is followed; no force acts there."""
    M, K, D, tau, lam = SEAL.values()
    lines = {"speed_rpm": 3000.0, "frequency_rpm": [-3000.0, 1500.0, 4000.0], "force": 10.0, "noise": 0.0}
    test = rf.simulate(LaggingSeal(), SEAL, **lines, planes="seal")
    rows = np.flatnonzero((test.plane == "seal") & (test.direction == "x"))
    w, speed = test.frequency[rows], test.speed[rows]
    motion = 10.0 / (K - M * w**2 + 1j * D * (w - lam * speed) / (1 + 1j * tau * w))
    np.testing.assert_allclose(test.response[rows], np.where(w < 0, motion.conj(), motion), rtol=1e-5)
    with refuses(ValueError):
        rf.simulate(LaggingSeal(), SEAL, **lines)


def test_predictions_are_those_of_the_equation_written_a_second_time() -> None:
    fit = rf.fit(Damper(), damper_tests(), causes=None)
    found = fit.predict(350.0, 0.0, force=150.0)
    eps = abs(found.response[0]) / Damper.clearance
    assert found.response[0] == pytest.approx(150.0 / damper_stiffness(350.0, eps), rel=2e-3)  # the fit's error


def test_a_file_gives_the_fit_again_with_the_model(case, tmp_path) -> None:
    model, fit, _, _ = case
    fit.save(tmp_path / "fit.json")
    again = rf.load_fit(tmp_path / "fit.json", model=model)
    assert np.array_equal(again.x, fit.x)


def test_refinement_is_refused_in_words_that_are_true(case) -> None:
    with refuses(ValueError):
        rf.refine(case[1])
