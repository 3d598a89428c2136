"""Experiments are laid out once: their columns are read-only, wherever they come from."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
from plain import plain_fit
from sentences import refuses
from synthetic import MODELS, SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of


def rig(count, noise=0.01):
    model, truth = MODELS["one-mode"](), TYPICAL["one-mode"]
    theta = model.vector(truth)
    frequency = covering_frequencies(model, theta, SPEEDS["one-mode"], count)
    test = circular_test(
        model, theta, speeds=SPEEDS["one-mode"], frequency=frequency, noise=noise, seed=1, sigma_known=True
    )
    return model, test, known_of("one-mode", truth)


def test_columns_and_attributes_cannot_be_written_to():
    _, test, _ = rig(60)
    of_a_caller = np.arange(float(len(test)))
    test = replace(test, sigma=of_a_caller + 1.0, attributes={"oil_C": of_a_caller})
    for copy in (test, test.select(test.frequency > 0), pickle.loads(pickle.dumps(test))):
        for column in (copy.response, copy.sigma, copy.attributes["oil_C"]):
            with refuses(ValueError):
                column[0] = 0
    of_a_caller[0] = 7.0
    assert test.attributes["oil_C"][0] == 0.0


def test_a_start_from_some_of_many_lines_leads_to_the_optimum_of_all():
    """Errors of 20000 lines are small, so that a start from some of them is off by several: the optimum is not."""
    model, test, known = rig(20_000)
    fit = plain_fit(model, test, known=known)
    start = {name: TYPICAL["one-mode"][name] for name in fit.var_names}
    from_truth = plain_fit(model, test, known=known, start=start)
    errors = np.sqrt(np.diag(fit.covar))
    assert fit.success
    np.testing.assert_allclose((fit.x - from_truth.x) / errors, 0, atol=1e-4)  # the optimiser's tolerance
