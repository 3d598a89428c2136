"""Arithmetic of fitted numbers: errors against draws from the covariance, units, what is independent of what."""

from __future__ import annotations

import math

import numpy as np
import pytest
from plain import plain_fit
from sentences import refuses

import rotorfit as rf
from rotorfit.identify.fitting.quantities import Quantity


def draws(fit: rf.FitResult) -> dict[str, np.ndarray]:
    """Fitted values with the errors of the fit, a hundred thousand times."""
    size = np.sqrt(np.diag(fit.covar))
    rng = np.random.default_rng(1)
    covar = fit.covar / np.outer(size, size)
    deviations = rng.multivariate_normal(np.zeros(size.size), covar, 100_000, method="cholesky")
    return dict(zip(fit.var_names, (fit.x + size * deviations).T, strict=True))


def test_errors_are_those_of_draws_from_the_covariance(rig_fit: rf.FitResult) -> None:
    p, drawn = rig_fit.params, draws(rig_fit)
    rules = {
        "1/s": (p["K0"] / p["D"], drawn["K0"] / drawn["D"]),
        "rad": (np.sqrt((p["K1"] + p["K0"]) / p["Md"]), np.sqrt((drawn["K1"] + drawn["K0"]) / drawn["Md"])),
        "N s/m": (2 * p["D"] * p["lam"] - p["Ds"], 2 * drawn["D"] * drawn["lam"] - drawn["Ds"]),
        "1": (3.0 - 1 / p["lam"] + p["sigma"], 3.0 - 1 / drawn["lam"] + drawn["sigma"]),
    }
    for quantity, values in rules.values():
        assert quantity.value == pytest.approx(values.mean(), abs=6 * quantity.stderr / math.sqrt(values.size) * 2)
        # the spread of so many draws is known to 0.2 %; derivatives of second order are less
        assert quantity.stderr == pytest.approx(values.std(), rel=0.01)


def test_units_follow(rig_fit: rf.FitResult) -> None:
    p = rig_fit.params
    assert (p["K0"] / p["D"]).unit == "1/s"
    assert (p["K0"] / p["Mf"]).unit == "1/s^2"
    assert (p["D"] * p["lam"] * rig_fit.threshold_speed()).unit == "N/m"
    assert (p["D"] ** 2 / p["Mf"]).unit == "N/m"
    assert (2 * rig_fit.threshold_speed()).unit == "rad/s"
    assert np.sqrt(p["K0"] / p["Mf"]).to("rpm").value == pytest.approx(
        math.sqrt(p["K0"].value / p["Mf"].value) * 30 / math.pi
    )
    with refuses(ValueError):
        p["K0"] + p["D"]


def test_what_cancels_has_no_error(rig_fit: rf.FitResult) -> None:
    p, onset = rig_fit.params, rig_fit.threshold_speed()
    nothing = p["K0"] - p["K0"]
    assert (nothing.value, nothing.stderr, nothing.systematic) == (0.0, 0.0, 0.0)
    assert (onset / onset).stderr == 0.0
    assert 2 * onset / 2 == onset


def test_a_known_value_moves_what_was_fitted_with_it(rig_fit: rf.FitResult) -> None:
    """What K3 is wrong by, K0 takes up for the most part, so that their sum rests on it far less."""
    alone, both = rig_fit.params["K0"], rig_fit.params["K0"] + rig_fit.params["K3"]
    assert alone.error is not None
    assert both.error is not None
    assert abs(both.error.on_trust["K3"]) < 0.25 * abs(alone.error.on_trust["K3"])


def test_it_is_what_derive_says(rig_fit: rf.FitResult) -> None:
    p = rig_fit.params
    derived = rig_fit.derive(lambda p: (p.K0 + p.K3) / p.D * p.lam**2, unit="1/s")
    written = (p["K0"] + p["K3"]) / p["D"] * p["lam"] ** 2
    assert written.value == pytest.approx(derived.value, rel=1e-12)
    assert written.stderr == pytest.approx(derived.stderr, rel=1e-9)
    assert written.systematic == pytest.approx(derived.systematic, rel=1e-9)


def test_a_sum_begins_at_zero_and_numpy_takes_symbols(rig_fit: rf.FitResult) -> None:
    p = rig_fit.params
    total = sum([p["K0"], p["K3"]])
    assert (total.value, total.unit) == (p["K0"].value + p["K3"].value, "N/m")
    with refuses(ValueError):
        p["K0"] + 1
    frequency = rig_fit.derive(lambda p: np.sqrt((p.K0 + p.K3) / p.Mb), unit="rad/s")  # no warning of CasADi's
    assert frequency.stderr == pytest.approx((((p["K0"] + p["K3"]) / p["Mb"]) ** 0.5).stderr, rel=1e-9)
    with refuses(TypeError):
        rig_fit.derive("K0")  # type: ignore[arg-type]


def test_another_fit_and_a_number_on_its_own_are_independent(rig_fit: rf.FitResult) -> None:
    other = plain_fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": 6000.0})
    difference = rig_fit.params["D"] - other.params["D"]
    assert difference.stderr == pytest.approx(math.hypot(rig_fit.params["D"].stderr, other.params["D"].stderr))
    speed = Quantity(200.0, 1.0, "rad/s")
    ratio = speed / rig_fit.threshold_speed()
    assert ratio.stderr / ratio.value == pytest.approx(
        math.hypot(1 / 200, rig_fit.threshold_speed().stderr / rig_fit.threshold_speed().value)
    )


def test_what_the_data_leave_open_stays_open(rig_fit: rf.FitResult) -> None:
    rig = rf.datasets.rig_open()
    assert isinstance(rig, rf.PerturbationTest)
    fit = plain_fit(rf.models.WhirlWhip(), rig.select(rig.force_plane == "journal"), known={"K3": 6000.0})
    assert str(fit.params["Md"] / fit.params["D"]) == "not determined by these data"
    # what is determined as a combination is, however it is written
    assert math.isfinite((fit.params["Mf"] / fit.params["D"]).stderr)


def test_entries_beside_the_parameters_keep_their_place(rig_fit: rf.FitResult) -> None:
    """A common zero of the forces is fitted beside the parameters, and the covariance has a row of it."""
    fit = plain_fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0}, phase_offsets="common")
    assert len(fit.var_names) > len(fit.problem.space.names)
    ratio = fit.params["K0"] / fit.params["D"]
    assert ratio.stderr == pytest.approx(fit.derive(lambda p: p.K0 / p.D).stderr, rel=1e-9)
    drawn = draws(fit)
    assert ratio.stderr == pytest.approx((drawn["K0"] / drawn["D"]).std(), rel=0.01)
