"""What data leave open is said by the fit: single parameters, sums, ratios, scales."""

from __future__ import annotations

import numpy as np
import pytest
from linear_tests import linear_test
from plain import plain_fit
from sentences import refuses
from synthetic import TYPICAL, circular_test, covering_frequencies

import rotorfit as rf
from rotorfit.models import OneMode, Overhung, TwoDisk


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


@pytest.mark.parametrize("planes", [("disk",), ("disk", "journal")])
def test_readings_that_determine_no_value_are_refused_before_a_search(planes: tuple[str, ...]) -> None:
    """One axis of a shaker test given to a model of both: the response along x is one of many matrices' inverses."""
    model = rf.models.TwoDisk(planes=("disk", "journal"))
    theta = model.vector(TYPICAL["two-disk"])
    whole = linear_test(model, theta, speed=0.0, frequency=np.linspace(20.0, 300.0, 60), along="x", noise=0.01)
    test = whole.select((whole.direction == "x") & np.isin(whole.plane, planes) & np.isin(whole.force_plane, planes))
    with refuses(ValueError):
        plain_fit(rf.models.Anisotropic(planes), test)
