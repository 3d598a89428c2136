"""A fitted rotor with other values, against fits of that rotor and against draws from the covariance."""

from __future__ import annotations

import numpy as np
import pytest
from plain import plain_fit
from sentences import refuses

import rotorfit as rf


def test_what_stays_as_it_was_is_as_it_was(rig_fit: rf.FitResult) -> None:
    same = rig_fit.what_if(lam=rig_fit.params["lam"], K3=rig_fit.params["K3"])
    for one, other in (
        (rig_fit.threshold_speed(), same.threshold_speed()),
        (rig_fit.params["lam"], same.params["lam"]),
    ):
        assert (one.value, one.stderr, one.noise) == pytest.approx((other.value, other.stderr, other.noise), rel=1e-9)
    where = {"force_plane": "disk", "mr": 1e-5, "plane": "journal", "speed_rpm": [1200]}
    before, after = rig_fit.predict(**where), same.predict(**where)
    assert after.covariance == pytest.approx(before.covariance, rel=1e-9)
    assert rig_fit.threshold_speed().stderr > 0  # the fit itself is not touched


def test_errors_are_those_of_draws_with_the_changed_values() -> None:
    """Threshold speeds of rotors drawn from the covariance, lam held and D made half as large."""
    fit = plain_fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": 6000.0})
    changed = fit.what_if(lam=0.3, D=0.5 * fit.params["D"])
    assert str(changed.params["lam"]) == "0.3, known"
    assert changed.params["D"].stderr == pytest.approx(0.5 * fit.params["D"].stderr)
    size = np.sqrt(np.diag(fit.covar))
    rng = np.random.default_rng(1)
    correlation = fit.covar / np.outer(size, size)
    drawn = fit.x + size * rng.multivariate_normal(np.zeros(size.size), correlation, 400, method="cholesky")
    drawn[:, fit.var_names.index("lam")] = 0.3
    drawn[:, fit.var_names.index("D")] *= 0.5
    speeds = [rf.models.threshold_speed(fit.model, theta[0]).speed for theta in fit.problem.space.theta(drawn)]
    onset = changed.threshold_speed()
    # the spread of 400 draws is known to 3.5 %, its mean to a twentieth of it
    assert onset.stderr == pytest.approx(np.std(speeds), rel=4 * 0.035)
    assert onset.value == pytest.approx(np.mean(speeds), abs=4 * onset.stderr / 20)


def test_a_known_value_is_changed_too() -> None:
    fit = plain_fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0})
    theta = dict(zip(fit.model.parameter_names, fit.theta(), strict=True)) | {"K3": 9000.0}
    there = rf.models.threshold_speed(fit.model, fit.model.vector(theta))
    assert there is not None
    assert fit.what_if(K3=9000.0).threshold_speed().value == pytest.approx(there.speed, rel=1e-9)


def test_figures_draw_it_beside_the_fit(rig_fit: rf.FitResult) -> None:
    changed = rig_fit.what_if(lam=0.3)
    for draw in (rig_fit.plot.stability, rig_fit.plot.bode):
        alone, both = draw(), draw(beside=changed)
        assert sum(len(axis.lines) for axis in both.axes) > sum(len(axis.lines) for axis in alone.axes)
        assert any("what if lam = 0.3" in text.get_text() for legend in both.legends for text in legend.get_texts())


def test_what_is_refused(rig_fit: rf.FitResult) -> None:
    other = plain_fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": 6000.0})
    with refuses(KeyError):
        rig_fit.what_if(lamb=0.3)
    with refuses(ValueError):
        rig_fit.what_if(D=other.params["D"])
    with refuses(ValueError):
        rig_fit.what_if()
