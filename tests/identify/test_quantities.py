"""Arithmetic of fitted numbers: errors against draws from the covariance, units, what is independent of what."""

from __future__ import annotations

import math
from dataclasses import replace

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


def test_numbers_are_compared_rounded_and_formatted_as_numbers(rig_fit: rf.FitResult) -> None:
    D, K1, K2 = (rig_fit.params[name] for name in ("D", "K1", "K2"))
    onset = rig_fit.threshold_speed()
    assert (D > 400, D >= 400, D < 400, D <= 400, D > 401) == (True, True, False, False, True)
    assert max(K1, K2).value == max(K1.value, K2.value)
    assert sorted([K1, K2])[0].value == min(K1.value, K2.value)
    assert onset < onset.to("Hz") * 1.01  # in one unit
    assert (abs(-D), np.abs(-D)) == (abs(D), abs(D))
    assert abs(-D).value == D.value
    assert (round(D), round(D, 2)) == (round(D.value), round(D.value, 2))
    assert f"{D:.1f} {onset:8.3e} {D:>25}|" == f"{D.value:.1f} {onset.value:8.3e} {D!s:>25}|"
    with refuses(ValueError):
        assert onset > D


def test_functions_keep_the_error_or_refuse(rig_fit: rf.FitResult) -> None:
    D, lam, drawn = rig_fit.params["D"], rig_fit.params["lam"], draws(rig_fit)
    for function, number in ((np.log, D), (np.log10, D), (np.sqrt, D), (np.exp, lam)):
        spread = function(drawn[number.name]).std()
        assert function(number).stderr == pytest.approx(spread, rel=0.01)
        assert function(np.array([number, number]))[1].stderr == function(number).stderr
    assert [one.value for one in np.array([1.0, 2.0]) * D] == [D.value, 2 * D.value]
    assert math.sqrt(replace(rig_fit.params["K3"], stderr=0.0)) == math.sqrt(6000.0)  # known to the last digit
    for function in (math.sqrt, math.log, float):
        with refuses(TypeError):
            function(D)
    with refuses(ValueError):
        np.exp(D)


@pytest.mark.parametrize(
    ("name", "unit", "factor"),
    [
        ("K0", "N/mm", 1e-3),
        ("K0", "lbf/in", 0.0254 / 4.4482216152605),
        ("K0", "kN/m", 1e-3),
        ("K0", "MN/mm", 1e-9),
        ("D", "N s/mm", 1e-3),
        ("D", "kN s/m", 1e-3),
        ("Mf", "g", 1e3),
        ("lam", "1", 1.0),
    ],
)
def test_units_of_the_program(rig_fit: rf.FitResult, name: str, unit: str, factor: float) -> None:
    p = rig_fit.params[name]
    shown = p.to(unit)
    assert (shown.value, shown.stderr) == pytest.approx((factor * p.value, factor * p.stderr), rel=1e-12)
    assert shown.interval() == pytest.approx([factor * end for end in p.interval()], rel=1e-9)


def test_units_of_numbers_on_their_own() -> None:
    """Each unit of a column that holds the quantity."""
    for unit, factor in (("mil", 25.4e-6), ("mil_pp", 12.7e-6), ("um", 1e-6), ("\u00b5m", 1e-6), ("in", 0.0254)):
        assert Quantity(1.0, 0.1, "m").to(unit).value == pytest.approx(1 / factor, rel=1e-12)
    assert Quantity(9.80665, 0.1, "m/s^2").to("g").value == pytest.approx(1.0)
    assert Quantity(1.0, 0.1, "kg m").to("g mm").value == pytest.approx(1e6)
    assert Quantity(math.pi, 0.1, "rad").to("deg").value == pytest.approx(180.0)
    for unit in ("furlong", "N/m", "N/furlong"):
        with refuses(ValueError):
            Quantity(1.0, 0.1, "m").to(unit)


def test_the_package_uncertainties_takes_them_with_their_correlations(rig_fit: rf.FitResult) -> None:
    p, onset = rig_fit.params, rig_fit.threshold_speed()
    K0, D, speed = (number.to_uncertainties() for number in (p["K0"], p["D"], onset))
    for theirs, ours in ((K0 / D, p["K0"] / p["D"]), (speed * D, onset * p["D"]), (K0 - K0, p["K0"] - p["K0"])):
        assert (theirs.nominal_value, theirs.std_dev) == pytest.approx((ours.value, ours.stderr), rel=1e-6, abs=1e-9)
    alone = Quantity(200.0, 1.0, "rad/s")
    assert f"{alone:.2u} {alone:.1uS} {alone:L}" == "200.0+/-1.0 200(1) 200.0 \\pm 1.0"
    run = rf.campaign(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0}).runs[0]
    theirs = run.params["K0"].to_uncertainties() / run.params["D"].to_uncertainties()
    assert theirs.std_dev == pytest.approx((run.params["K0"] / run.params["D"]).stderr, rel=1e-6)
    with refuses(KeyError):
        run.params["lamb"]
    other = plain_fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": 6000.0})
    apart = D - other.params["D"].to_uncertainties()
    assert apart.std_dev == pytest.approx((p["D"] - other.params["D"]).stderr, rel=1e-6)


def test_a_misspelt_parameter_is_answered_with_the_nearest(rig_fit: rf.FitResult) -> None:
    with refuses(KeyError):
        rig_fit.params["lamb"]
    assert rig_fit.params.get("lamb") is None
    assert "lamb" not in rig_fit.params
    assert str(rig_fit.params).splitlines()[1].startswith("Md ")
