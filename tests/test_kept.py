"""What is kept of an experiment is worked out again where its columns were written to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from synthetic import MODELS, SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.data.kept import kept
from rotorfit.estimators.starting.force_balance import ForceBalance


def rig(count, noise=0.01):
    model, truth = MODELS["one-mode"](), TYPICAL["one-mode"]
    theta = model.vector(truth)
    frequency = covering_frequencies(model, theta, SPEEDS["one-mode"], count)
    test = circular_test(
        model, theta, speeds=SPEEDS["one-mode"], frequency=frequency, noise=noise, seed=1, sigma_known=True
    )
    return model, test, known_of("one-mode", truth)


def test_columns_written_to_are_looked_at_again():
    model, test, known = rig(60)
    assert not [finding for finding in rf.check(test) if finding.severity == "error"]
    first = rf.fit(model, test, known=known)
    assert kept(test)
    test.sigma[:] *= 2
    again = rf.fit(model, test, known=known)
    assert again.redchi == pytest.approx(first.redchi / 4)
    test.response[:] = test.response.conj()
    assert [finding.code for finding in rf.check(test) if finding.severity == "error"] == ["wrong-direction"]


def test_a_start_from_some_of_many_lines_leads_to_the_optimum_of_all():
    """Errors of 20000 lines are small, so that a start from some of them is off by several: the optimum is not."""
    model, test, known = rig(20_000)
    fit = rf.fit(model, test, known=known)
    start = {name: TYPICAL["one-mode"][name] for name in fit.var_names}
    from_truth = rf.fit(model, test, known=known, start=start)
    errors = np.sqrt(np.diag(fit.covar))
    assert fit.success
    np.testing.assert_allclose((fit.x - from_truth.x) / errors, 0, atol=1e-4)  # the optimiser's tolerance


def test_the_closed_form_that_data_keep_is_that_of_new_data(monkeypatch):
    """Another bound, prior or loss changes nothing in the equations of motion: the passes are not made again, and the
    fit is to the last bit that of a copy which nothing was worked out of. Another known value makes its own passes."""
    model, test, known = rig(60)
    made = []
    weigh = ForceBalance.weigh
    monkeypatch.setattr(ForceBalance, "weigh", lambda *a: made.append(1) or weigh(*a))
    rf.fit(model, test, known=known)
    passes = len(made)
    assert passes
    for change in ({"bounds": {"lam": (0.0, 0.9)}}, {"priors": {"lam": norm(0.45, 0.05)}}):
        del made[:]
        kept_one = rf.fit(model, test, known=known, **change)
        assert not made
        np.testing.assert_array_equal(kept_one.x, rf.fit(model, replace(test), known=known, **change).x)
        assert len(made) == passes
    name = next(iter(known))
    for other in (known | {name: 1.01 * known[name]}, known):
        del made[:]
        np.testing.assert_array_equal(rf.fit(model, test, known=other).x, rf.fit(model, replace(test), known=other).x)
        assert len(made) == 2 * passes
