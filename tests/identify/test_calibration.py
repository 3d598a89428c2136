"""Calibrations: sizes of causes by plane, known sensitivities, and miscalibrated data in numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from sentences import refuses
from synthetic import TYPICAL, circular_test

import rotorfit as rf
from rotorfit.identify.fitting.causes.calibration import Calibration, calibration_of, sizes_of
from rotorfit.models import OneMode, WhirlWhip

RIG = TYPICAL["whirl-whip"]
W = np.r_[-np.linspace(20, 400, 20)[::-1], np.linspace(20, 400, 20)]


def exact_test(noise=0.005, seed=0):
    model = WhirlWhip()
    return circular_test(
        model, model.vector(RIG), speeds=(100.0, 200.0), frequency=W, noise=noise, seed=seed, sigma_known=True
    )


def test_sizes_are_those_of_the_mean_of_the_probes_of_a_plane():
    planes = {"disk": ("x", "y"), "journal": ("x",)}
    found = sizes_of(Calibration(probe_gain={"disk": 0.02, "journal.x": 0.01}, keyphasor_deg=1.0, mr=0.005), planes)
    assert found["gain[disk]"] == pytest.approx(0.02 / np.sqrt(2))  # the mean of two that are off independently
    assert found["gain[journal]"] == pytest.approx(0.01)
    assert found["gain"] == pytest.approx(0.005)
    assert found["phase"] == pytest.approx(np.radians(1.0))
    # The chains are calibrated on the shaft: what remains in common is the force's.
    assert sizes_of(Calibration(probe_gain=0.01), planes)["gain"] < 0.03
    with refuses(ValueError):
        sizes_of(Calibration(probe_gain={"disc": 0.01}), planes)


def test_gains_move_what_they_multiply_and_nothing_else():
    """Gains a, b of the probes multiply the columns of kappa by 1/a, 1/b: another rotor of the same form.

    Md, Ds, K1 and K2 go with a, D, Mf and Mb with b, sigma with a/b, K0 + K3 with b, and all with the common gain; lam
    stays. The data cannot tell, so the budget has what arithmetic says.
    """
    a = b = 0.02
    only = {"gain[disk]": a, "gain[journal]": b}
    rest = {cause.name: 0.0 for cause in rf.fit(WhirlWhip(), exact_test(), known={"K3": 6000.0}).causes}
    fit = rf.fit(WhirlWhip(), exact_test(), known={"K3": 6000.0}, causes={**rest, **only})
    budget, value = fit.budget(), {name: p.value for name, p in fit.params.items()}
    expected = {
        "Md": (a * value["Md"], 0.0),
        "K1": (a * value["K1"], 0.0),
        "D": (0.0, b * value["D"]),
        "Mf": (0.0, b * value["Mf"]),
        "K0": (0.0, b * (value["K0"] + value["K3"])),
        "sigma": (a * value["sigma"], b * value["sigma"]),
        "lam": (0.0, 0.0),
    }
    for name, (by_disk, by_journal) in expected.items():
        row = budget[name]
        # What the data say after all is of the order of the noise.
        assert abs(row.on_trust["gain[disk]"]) == pytest.approx(by_disk, rel=1e-3, abs=row.noise)
        assert abs(row.on_trust["gain[journal]"]) == pytest.approx(by_journal, rel=1e-3, abs=row.noise)
        assert np.hypot(row.noise, row.systematic) == pytest.approx(row.stderr, rel=1e-12)


def test_pulls_of_miscalibrated_data():
    """24 tests whose disk probes are off by a draw of 2 % of the mean and whose forces by 1 %: errors that hold."""
    rng, pulls = np.random.default_rng(4), []
    calibration = Calibration(probe_gain=0.02, mr=0.01)
    for seed in range(24):
        test = exact_test(seed=seed)
        gains = {plane: 1 + 0.02 / np.sqrt(2) * rng.normal() for plane in ("disk", "journal")}
        common = 1 + 0.01 * rng.normal()
        response = test.response * common * np.array([gains[plane] for plane in test.plane.tolist()])
        fit = rf.fit(WhirlWhip(), replace(test, response=response), known={"K3": 6000.0}, calibration=calibration)
        pulls.append([(fit.params[n].value - RIG[n]) / fit.params[n].stderr for n in ("Md", "K1", "D", "K0")])
    total = np.sum(np.square(pulls), axis=0)
    # Chi-squared of 24 degrees; the other causes, none of which acts, make the errors wider and the pulls smaller.
    assert (total < stats.chi2.ppf(0.999, 24)).all(), total
    assert total.max() > stats.chi2.ppf(0.001, 24) / 4


def test_a_calibration_is_read_and_refused_in_words():
    assert calibration_of({}) is None
    assert calibration_of({"mr": 0.01}) == Calibration(mr=0.01)
    with refuses(ValueError):
        calibration_of({"gain": 0.01})
    with refuses(ValueError):
        Calibration()
    with refuses(ValueError):
        Calibration(probe_gain=2.0)
    with refuses(ValueError):
        Calibration(mr=-0.01)


def test_a_known_value_has_the_error_that_it_is_given():
    test = exact_test()
    loose = rf.fit(WhirlWhip(), test, known={"K3": (6000.0, 300.0)})
    tight = rf.fit(WhirlWhip(), test, known={"K3": (6000.0, 30.0)})
    for fit, error in ((loose, 300.0), (tight, 30.0)):
        # K3 and K0 act at one place: what one has less the other has more. That the fluid's may change with speed
        # and the spring's not tells a twentieth of the larger size.
        assert abs(fit.params["K0"].error.on_trust["K3"]) == pytest.approx(error, rel=0.06)
        assert fit.causes["K3"].size == error


def test_a_cause_without_a_size_is_as_if_it_were_not_there():
    test = circular_test(
        OneMode(), OneMode().vector(TYPICAL["one-mode"]), speeds=(100.0, 200.0), frequency=W, noise=0.005, seed=1
    )
    known = {"K": TYPICAL["one-mode"]["K"], "Ds": TYPICAL["one-mode"]["Ds"]}
    every = rf.fit(OneMode(), test, known=known)
    without = rf.fit(OneMode(), test, known=known, causes={row.name: 0.0 for row in every.causes})
    plain = rf.fit(OneMode(), test, known=known, causes=None)
    for name in ("D", "lam", "K0"):
        assert without.params[name].value == pytest.approx(plain.params[name].value, rel=1e-9)
        assert without.params[name].stderr == pytest.approx(plain.params[name].stderr, rel=1e-6)
    with refuses(KeyError):
        rf.fit(OneMode(), test, known=known, causes={"gian": 0.1})
    with refuses(ValueError):
        rf.fit(OneMode(), test, known=known, causes={"gain": -0.1})
