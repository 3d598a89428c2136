"""Gauss-Newton, and Ipopt on CasADi's own graph of the cost, reach the same optimum."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from hammer_tests import EIGHT, hammer_test
from known_shaft import FITTED, known_rig
from law_data import CLEARANCE_UM, ONE_MODE, WHIRL_WHIP, static, sweep
from line_tests import ALL, TORSION, VALUES, line_test
from plain import plain_fit
from scipy import stats
from sentences import refuses
from slow_cases import slow_but
from synthetic import SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.estimators.misfit.cost_graph import cost_graph
from rotorfit.estimators.misfit.problem import LOSSES, Loss
from rotorfit.models import (
    MODELS,
    Chain,
    Collapse,
    EvenPolynomial,
    Law,
    LinearInSpeed,
    MonotoneSpline,
    Muszynska,
    OneMode,
    WhirlWhip,
)

CHAIN = {
    "M1": 0.7,
    "M2": 1.1,
    "M3": 0.8,
    "K1": 2e4,
    "K2": 5e4,
    "K3": 6e4,
    "K4": 3e4,
    "Ds1": 9.0,
    "Ds2": 6.0,
    "Ds3": 8.0,
}


def readings(name: str, **options: Any) -> rf.PerturbationTest:
    model = MODELS[name]()
    theta = model.vector(TYPICAL[name])
    frequency = covering_frequencies(model, theta, SPEEDS[name], 24)
    return circular_test(model, theta, speeds=SPEEDS[name], frequency=frequency, noise=0.02, seed=5, **options)


def both(model: rf.models.RotorModel, experiments: Any, **options: Any) -> rf.FitResult:
    """The fit by Gauss-Newton, which is that by Ipopt within a millionth of an error."""
    one = plain_fit(model, experiments, method="gauss-newton", **options)
    other = plain_fit(model, experiments, method="ipopt", **options)
    assert one.success
    assert other.success
    for name, parameter in one.params.items():
        assert abs(parameter.value - other.params[name].value) <= 1e-6 * parameter.stderr, name
    return other


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("name", list(TYPICAL))
def test_every_model_and_loss(name: str, loss: Loss) -> None:
    fit = both(MODELS[name](), readings(name), known=known_of(name, TYPICAL[name]), loss=loss)
    graph = cost_graph(fit.problem)
    assert graph is not None
    beside = fit.x * np.linspace(0.97, 1.04, fit.x.size)  # NumPy's inverses against CasADi's symbolic ones
    assert float(graph(beside)) == pytest.approx(fit.problem.cost(beside), rel=1e-9)


BESIDE = {
    "known structure": {"lam": (0.2, 0.47), "D": (0.0, 440.0)},
    "modal": {"wn1": (200.0, 263.0)},
    "anisotropic shaft": {"nu_t": (300.0, 339.5)},
}
"""Models that are no lumped ones, with bounds that the truth lies beyond."""


def beside(name: str) -> tuple[rf.models.RotorModel, Any]:
    """A model that is not lumped, and a test of it."""
    if name == "modal":
        test = hammer_test(60, 0.9, seed=3)
        chosen = test.select(np.isin(test.plane, EIGHT[:2]) & (test.frequency < 800.0))
        return rf.models.Modal(EIGHT[:2], modes=2, gains="plane", force_planes=("s0",)), chosen
    if name == "anisotropic shaft":
        sweep = -np.linspace(30.0, 310.0, 30)
        rotor = rf.models.AnisotropicShaft()
        rng = np.random.default_rng(3)
        return rotor, line_test(rotor, VALUES | TORSION, ALL, rng, steady=("1x", "2x"), sweep=sweep)
    rig, half = known_rig(), np.linspace(8.0, 320.0, 20)
    frequency = np.r_[-half[::-1], half]
    theta = rig.vector(FITTED)
    return rig, circular_test(rig, theta, speeds=(100.0, 200.0), frequency=frequency, noise=0.02, seed=5)


@pytest.mark.parametrize(
    ("name", "loss"),
    slow_but(
        product(BESIDE, LOSSES),
        ("known structure", "cauchy"),
        ("anisotropic shaft", "linear"),
        ("anisotropic shaft", "soft_l1"),
    ),
)
def test_models_that_are_not_lumped_with_bounds_and_every_loss(name: str, loss: Loss) -> None:
    model, test = beside(name)
    fit = both(model, test, loss=loss)
    assert (cost_graph(fit.problem) is None) is (name != "modal")  # the others by Ipopt on numerical values
    bounded = both(model, test, loss=loss, bounds=BESIDE[name])
    assert any(bounded.params[parameter].value in ends for parameter, ends in BESIDE[name].items())


def test_many_masses() -> None:
    model = Chain(3)
    theta = model.vector(CHAIN)
    frequency = covering_frequencies(model, theta, [0.0], 24)
    test = circular_test(model, theta, speeds=[0.0], frequency=frequency, noise=0.02, seed=5)
    both(model, test)


def test_bounds_priors_phase_offsets_and_a_start_far_away() -> None:
    known, model = known_of("whirl-whip", TYPICAL["whirl-whip"]), MODELS["whirl-whip"]()
    test = readings("whirl-whip")
    fit = both(model, test, known=known, bounds={"lam": (0.2, 0.47), "D": (0.0, 440.0)})
    assert fit.params["lam"].value == 0.47 or fit.params["D"].value == 440.0
    both(model, test, known=known, priors={"Mf": stats.norm(0.5, 0.05)})
    both(model, test, known=known, phase_offsets="common")
    both(model, test, known=known, start={"lam": 0.2, "D": 100.0, "K0": 3e4, "K1": 3e4})
    assert cost_graph(plain_fit(model, test, known=known, priors={"Mf": stats.gamma(4.0, 0.1)}).problem) is None


LAWS = (Muszynska(), EvenPolynomial(), MonotoneSpline(knots=(0.5,)))


@pytest.mark.parametrize("law", slow_but(LAWS, *LAWS[:2]))
def test_laws_of_eccentricity_have_no_graph_and_the_same_optimum(law: Law) -> None:
    known = {"Ds": 8.0} if law.name == "muszynska" else {"Ds": 8.0, "K": 8000.0}
    data = [sweep(ONE_MODE, levels=(3.0, 30.0), lines=20), static(ONE_MODE)]
    model = OneMode(law=law, clearance_um=CLEARANCE_UM)
    fit = both(model, data, known=known, start={"D": 430.0, "lam": 0.44})
    assert cost_graph(fit.problem) is None


WITH_BOUNDS = product((Muszynska(), EvenPolynomial(), Collapse()), LOSSES)


@pytest.mark.parametrize(("law", "loss"), slow_but(WITH_BOUNDS, (Muszynska(), "huber"), (Collapse(), "linear")))
def test_laws_with_bounds_and_every_loss(law: Law, loss: Loss) -> None:
    data = [sweep(ONE_MODE, levels=(3.0, 20.0), lines=20), static(ONE_MODE, loads=(2.0, 6.0, 10.0, 14.0, 18.0))]
    response = data[0].response.copy()
    response[[3, 17, 30]] *= 1.2  # readings that a robust loss discounts
    data[0] = replace(data[0], response=response)
    bounds = {"lam": (0.2, 0.99 * ONE_MODE["lam"]), "D": (0.0, 0.995 * ONE_MODE["D"])}
    model = OneMode(law=law, clearance_um=CLEARANCE_UM)
    fit = both(model, data, known={"Ds": 8.0, "K": 8000.0}, loss=loss, bounds=bounds)
    assert any(fit.params[name].value == pytest.approx(high, rel=1e-12) for name, (_, high) in bounds.items())


def test_gauss_newton_goes_on_where_the_exact_hessian_leads_nowhere() -> None:
    """A law that misses the data, between kinks of a robust loss, with parameters at their bounds."""
    model = WhirlWhip(law=MonotoneSpline(knots=(0.5,)), clearance_um=CLEARANCE_UM)
    data = [sweep(WHIRL_WHIP, levels=(3.0, 30.0), lines=20), static(WHIRL_WHIP)]
    response = data[0].response.copy()
    response[np.random.default_rng(0).choice(response.size, 6, replace=False)] *= 1.15
    data[0] = replace(data[0], response=response)
    both(model, data, known={"Ds": 25.0, "K3": 6000.0, "sigma": 1.0}, loss="huber")


def test_a_law_of_the_speed() -> None:
    both(OneMode(law=LinearInSpeed("lam")), readings("one-mode"), known=known_of("one-mode", TYPICAL["one-mode"]))


def test_an_unknown_method_is_refused() -> None:
    with refuses(ValueError):
        plain_fit(OneMode(), readings("one-mode"), method="bfgs")  # type: ignore[arg-type]
