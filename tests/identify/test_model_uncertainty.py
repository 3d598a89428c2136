"""The uncertainty of the choice among candidate models in everything that is derived from a refined fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rotorfit as rf
from rotorfit.estimators.inference.covariance import excess
from rotorfit.identify.fitting.judge import inverse_curvature


def averaged(rig_refinement, value):
    """Mean square distance from the chosen one, and the larger variance, over candidates by weights of their AIC."""
    best = next(s for s in rig_refinement.steps if s.model.blocks == rig_refinement.best.model.blocks)
    candidates = [step for step in rig_refinement.steps if not step.identifiability.unresolved]
    scatter = max(1.0, min(step.redchi for step in candidates))
    weight = np.exp([(best.aic - step.aic) / (4 * scatter) for step in candidates])
    weight /= weight.sum()
    values, errors = np.array([value(step) for step in candidates]).T
    centre, own = value(best)
    return float(np.sqrt(weight @ (values - centre) ** 2 + max(own**2, weight @ errors**2)))


def test_errors_are_those_of_all_candidates_and_no_smaller_than_of_the_chosen_one(rig_refinement):
    best = rig_refinement.best
    chosen = next(step for step in rig_refinement.steps if step.model.blocks == best.model.blocks)
    for name in ("D", "lam", "K0", "Mf", "Md"):
        p = best.params[name]
        expected = averaged(rig_refinement, lambda s, n=name: (s.params[n].value, s.params[n].stderr))
        # The part by which variances grow is taken direction by direction: the whole may be a little wider.
        assert expected * 0.999 <= p.stderr <= 1.5 * max(expected, chosen.params[name].stderr)
        assert p.stderr == pytest.approx(np.sqrt(best.covar[best.var_names.index(name)][best.var_names.index(name)]))


def test_the_threshold_speed_holds_the_differences_of_candidates(rig_refinement):
    """The delta method with the wider covariance, against the threshold speeds of the candidates themselves."""
    speeds = averaged(rig_refinement, lambda s: (s.threshold_speed().value, s.threshold_speed().stderr))
    found = rig_refinement.best.threshold_speed()
    # A candidate with terms that the chosen model lacks moves the threshold by these too, here by a tenth at most.
    assert found.stderr > 0.8 * speeds


def test_newton_steps_do_not_take_model_uncertainty_for_curvature(rig_refinement):
    best = rig_refinement.best
    curvature = inverse_curvature(best)
    assert np.all(np.diag(curvature) <= np.diag(best.covar) * (1 + 1e-9))
    solved = best.settings.solved
    assert solved is not None
    added = solved.errors.covariance
    added[: len(best.model_uncertainty), : len(best.model_uncertainty)] += best.model_uncertainty
    assert np.sqrt(np.diag(curvature)) == pytest.approx(np.sqrt(np.diag(best.covar - added)), rel=0.05)


def test_a_saved_fit_keeps_it(rig_refinement, tmp_path: Path):
    rig_refinement.best.save(tmp_path / "fit.json")
    again = rf.load_fit(tmp_path / "fit.json")
    assert np.array_equal(again.model_uncertainty, rig_refinement.best.model_uncertainty)
    assert again.threshold_speed().stderr == pytest.approx(rig_refinement.best.threshold_speed().stderr, rel=1e-9)


def test_what_joins_a_covariance_makes_no_direction_surer():
    rng = np.random.default_rng(3)
    own, wide = (a @ a.T for a in rng.normal(size=(2, 4, 4)))
    more = excess(wide, own)
    for direction in rng.normal(size=(200, 4)):
        variances = [direction @ matrix @ direction for matrix in (own + more, own, wide)]
        assert variances[0] >= max(variances[1:]) * (1 - 1e-9)
    assert excess(0.5 * own, own) == pytest.approx(np.zeros((4, 4)), abs=1e-12)
