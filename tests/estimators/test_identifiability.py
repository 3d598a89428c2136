"""Verdicts on what data determine, on Jacobians whose null space is known, and against the analysis of the rotor."""

from __future__ import annotations

import re

import numpy as np
import pytest
from linear_tests import linear_test
from plain import plain_fit
from sentences import hear, refuses
from synthetic import TYPICAL, circular_test, covering_frequencies

import rotorfit as rf
from rotorfit.estimators.inference.identifiability import covariance, diagnose, natural_scales
from rotorfit.models import BLOCKS, OneMode, Overhung, TwoDisk, WhirlWhip
from rotorfit.models.structure import block_parameters

NAMES = ("M", "K", "K0", "D")


def verdict(jacobian, values=(1.0, 8000.0, 9000.0, 450.0)):
    values = np.array(values)
    J = np.asarray(jacobian, dtype=float)
    return diagnose(OneMode(), NAMES, NAMES, values, J, np.abs(values))


def test_full_rank_covariance_is_the_inverse():
    rng = np.random.default_rng(0)
    J = rng.normal(size=(30, 4)) / np.array([0.01, 10.0, 20.0, 1.0])
    covar, found = verdict(J)
    np.testing.assert_allclose(covar, np.linalg.inv(J.T @ J), rtol=1e-9)
    assert found.rank == found.size == 4
    assert found.combinations == ()
    scaled = J * np.array([1.0, 8000.0, 9000.0, 450.0])
    assert found.condition == pytest.approx(np.linalg.cond(scaled), rel=1e-6)


@pytest.mark.parametrize(
    ("mix", "message"),
    [
        ((1.0, 1.0), r"K \+ K0 only as a sum"),
        ((1.0, -1.0), "K - K0 only as a difference"),
        ((1 / 8000.0, 1 / 9000.0), r"K \* K0 only as a product"),
        ((1 / 8000.0, -1 / 9000.0), "K / K0 only as a ratio"),
    ],
)
def test_pairs_in_words(mix, message):
    """The data see only a K + b K0 (or its logarithmic counterpart): one direction stays open."""
    rng = np.random.default_rng(1)
    seen = rng.normal(size=(30, 1)) / 0.01
    level = np.max(np.abs(mix)) * 10
    J = np.hstack(
        [rng.normal(size=(30, 1)) * 100, seen * mix[0] / level, seen * mix[1] / level, rng.normal(size=(30, 1))]
    )
    covar, found = verdict(J)
    assert found.rank == 3
    assert set(found.unresolved) == {"K", "K0"}
    (combination,) = found.combinations
    assert re.search(message, combination.message)
    # What the data do see keeps its variance.
    mixed = np.array([0, mix[0], mix[1], 0])
    assert mixed @ covar @ mixed > 0


def test_a_silent_parameter_is_not_observable():
    rng = np.random.default_rng(2)
    J = rng.normal(size=(30, 4)) * 100
    J[:, 3] = 0.0
    _, found = verdict(J)
    assert found.unresolved == ("D",)
    hear(found.combinations[0].message)
    assert not np.isfinite(found.condition)


def test_scales_do_not_change_the_verdict():
    """Units of the parameters are arbitrary: rank and directions survive scaling by twelve orders of magnitude."""
    rng = np.random.default_rng(3)
    J = rng.normal(size=(30, 4)) * 10
    J[:, 2] = J[:, 1]
    for scale in (np.ones(4), np.array([1e-6, 1.0, 1.0, 1e6])):
        _, stderr, _, open_ = covariance(J / scale, scale)
        assert open_.sum() == 1
        assert np.isinf(stderr).sum() == 1


def test_one_mode_with_nothing_known():
    """At several speeds: K and K0 only as their sum, and the external damping trades with the fluid's."""
    model = OneMode()
    theta = model.vector(TYPICAL["one-mode"])
    w = covering_frequencies(model, theta, (100.0,), 100)
    fit = plain_fit(model, circular_test(model, theta, speeds=(60.0, 100.0, 180.0), frequency=w, noise=0.001))
    assert any("K + K0 only as a sum" in c.message for c in fit.identifiability.combinations)
    assert {"K", "K0"} <= set(fit.identifiability.unresolved)
    assert fit.params["M"].resolved


def test_separate_ratios_and_free_damping_are_open_at_every_speed():
    """With lam_D and lam_M free, Ds, D and lam_D cannot be told apart, however many speeds."""
    truth = {k: v for k, v in TYPICAL["one-mode"].items() if k != "lam"} | {"lam_D": 0.45, "lam_M": 0.45}
    model = OneMode(two_lam=True)
    theta = model.vector(truth)
    w = covering_frequencies(model, theta, (100.0,), 100)
    test = circular_test(model, theta, speeds=(60.0, 100.0, 180.0), frequency=w, noise=0.001)
    fit = plain_fit(model, test, known={"K": truth["K"]})
    assert {"Ds", "D", "lam_D"} <= set(fit.identifiability.unresolved)
    assert fit.params["lam_M"].resolved
    # The threshold depends on nothing that is open: D lam_D and Ds + D carry it.
    assert np.isfinite(fit.threshold_speed().stderr)


def test_polar_inertia_needs_rotation():
    model = Overhung()
    theta = model.vector(TYPICAL["overhung"])
    w = covering_frequencies(model, theta, (0.0,), 200)
    fit = plain_fit(model, circular_test(model, theta, speeds=(0.0,), frequency=w, noise=0.002))
    assert fit.identifiability.unresolved == ("Ip",)


def test_probe_factor_and_scale_are_confounded():
    """Free beta1 and beta2 together leave a scale open; reciprocity cannot give it."""
    model, truth = TwoDisk(), TYPICAL["two-disk"]
    theta = model.vector(truth)
    w = covering_frequencies(model, theta, (0.0,), 200)
    test = circular_test(model, theta, speeds=(0.0,), frequency=w, noise=0.002)
    fit = plain_fit(model, test, known={"beta1": None, "beta2": None})
    assert fit.identifiability.rank == fit.identifiability.size - 1
    assert {"beta1", "beta2", "M1", "M2"} <= set(fit.identifiability.unresolved)


def test_every_structural_block_has_a_size_that_would_matter():
    """A tenth of the stiffness level over a power of the frequency: kg s^n is N/m over w^(n + 2)."""
    model, stiffness, frequency = WhirlWhip(blocks=BLOCKS), 3e4, 500.0
    power = {"N s/m": 1, "kg": 2, "kg s": 3, "kg s^2": 4, "kg s^4": 6}
    names = [p.name for p in block_parameters(BLOCKS, 2)]
    found = natural_scales(model, names, np.zeros(len(names)), stiffness, frequency)
    expected = [0.1 * stiffness / frequency ** power[model.parameter(name).unit] for name in names]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("planes", [("disk",), ("disk", "journal")])
def test_readings_that_determine_no_value_are_refused_before_a_search(planes: tuple[str, ...]) -> None:
    """One axis of a shaker test given to a model of both: the response along x is one of many matrices' inverses."""
    model = rf.models.TwoDisk(planes=("disk", "journal"))
    theta = model.vector(TYPICAL["two-disk"])
    whole = linear_test(model, theta, speed=0.0, frequency=np.linspace(20.0, 300.0, 60), along="x", noise=0.01)
    test = whole.select((whole.direction == "x") & np.isin(whole.plane, planes) & np.isin(whole.force_plane, planes))
    with refuses(ValueError):
        plain_fit(rf.models.Anisotropic(planes), test)
