"""The closed form against the paper's own route: invert, then fit straight lines and parabolas."""

from __future__ import annotations

import numpy as np
import pytest
from plain import plain_fit
from synthetic import TYPICAL, circular_test, covering_frequencies

import rotorfit as rf
from rotorfit.models import OneMode, TwoDisk, WhirlWhip

TRUTH = TYPICAL["one-mode"]


def one_mode_test(noise, seed=0):
    model = OneMode()
    theta = model.vector(TRUTH)
    w = covering_frequencies(model, theta, (100.0,), 100)
    return circular_test(model, theta, speeds=(100.0,), frequency=w, noise=noise, seed=seed)


def test_unweighted_is_the_papers_straight_line_and_parabola():
    """DDS is a parabola and QDS a straight line in w (eq. 10): polynomial fits to kappa = F/A give the same numbers."""
    test = one_mode_test(0.01)
    result = rf.closed_form(OneMode(), test, known={"K": TRUTH["K"], "Ds": TRUTH["Ds"]}, weighted=False)
    measured = rf.dynamic_stiffness(test)
    w, kappa, speed = measured.frequency, measured.kappa[:, 0, 0], 100.0
    curvature, slope, intercept = np.polyfit(w, kappa.real, 2)
    damping, cross = np.polyfit(w, kappa.imag, 1)
    D = damping - TRUTH["Ds"]
    lam = -cross / (D * speed)
    Mf = slope / (2 * lam * speed)
    expected = {
        "D": D, "lam": lam, "Mf": Mf, "M": -curvature - Mf,
        "K0": intercept - TRUTH["K"] + Mf * (lam * speed) ** 2,
    }  # fmt: skip
    for name, value in expected.items():
        assert result.params[name].value == pytest.approx(value, rel=1e-8)
    assert np.isnan(result.params["D"].stderr)  # unweighted: the paper gave no errors, nor does this


def test_weighting_pays():
    """RMS error over noise draws: weighted is better than unweighted, and close to the optimised estimate."""
    errors = {"weighted": [], "unweighted": [], "fit": []}
    known = {"K": TRUTH["K"], "Ds": TRUTH["Ds"]}
    for seed in range(40):
        test = one_mode_test(0.03, seed)
        errors["weighted"].append(rf.closed_form(OneMode(), test, known=known).params["lam"].value)
        errors["unweighted"].append(rf.closed_form(OneMode(), test, known=known, weighted=False).params["lam"].value)
        errors["fit"].append(plain_fit(OneMode(), test, known=known).params["lam"].value)
    rms = {name: np.sqrt(np.mean((np.array(values) - TRUTH["lam"]) ** 2)) for name, values in errors.items()}
    assert rms["weighted"] < 0.7 * rms["unweighted"]
    assert rms["weighted"] < 1.1 * rms["fit"]


def test_blocks_and_groups_have_a_closed_form_too():
    blocks = {"m12": 0.02, "g11": 1e-3, "g12": -7e-4, "g22": 5e-4, "q11": -1e-8, "q12": -4e-9, "q22": -1.5e-8}
    model = WhirlWhip(blocks=("coupling_mass", "gyroscopic", "out_of_band"))
    truth = TYPICAL["whirl-whip"] | blocks
    theta = model.vector(truth)
    w = np.concatenate([-np.linspace(5, 450, 60)[::-1], np.linspace(5, 450, 60)])
    test = circular_test(model, theta, speeds=(100.0, 200.0), frequency=w)
    result = rf.closed_form(model, test, known={"K3": truth["K3"]})
    for name, value in truth.items():
        assert result.params[name].value == pytest.approx(value, rel=1e-6), name
    grouped = rf.closed_form(WhirlWhip(), test, known={"K3": truth["K3"]}, per={"D": "speed_rpm"})
    assert sum(name.startswith("D[") for name in grouped.params) == 2


def test_two_velocity_ratios_from_several_speeds():
    model = OneMode(two_lam=True)
    truth = {k: v for k, v in TRUTH.items() if k != "lam"} | {"lam_D": 0.35, "lam_M": 0.6}
    theta = model.vector(truth)
    w = covering_frequencies(model, theta, (100.0,), 60)
    test = circular_test(model, theta, speeds=(60.0, 100.0, 140.0), frequency=w)
    result = rf.closed_form(model, test, known={"K": truth["K"], "Ds": truth["Ds"]})
    for name, value in truth.items():
        assert result.params[name].value == pytest.approx(value, rel=1e-6)


def test_free_probe_factor():
    model, truth = TwoDisk(), TYPICAL["two-disk"] | {"beta2": 0.9}
    theta = model.vector(truth)
    test = circular_test(model, theta, speeds=(0.0,), frequency=covering_frequencies(model, theta, (0.0,), 60))
    result = rf.closed_form(model, test, known={"beta2": None})
    assert result.params["beta2"].value == pytest.approx(0.9, rel=1e-6)
    assert result.params["M2"].value == pytest.approx(truth["M2"], rel=1e-6)
