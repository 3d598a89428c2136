"""Values that no fluid has: the factor of a unit is asked for, honest negative stiffness stays a warning."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from plain import plain_fit
from synthetic import SPEEDS, circular_test, covering_frequencies

import rotorfit as rf

TRUTH = {"M": 12.0, "K": 2e6, "Ds": 600.0, "K0": 5e5, "D": 4000.0, "lam": 0.46, "Mf": 1.5}
KNOWN = {"K": 2e6, "Ds": 600.0}


def clean(seed=0, **changed):
    """A heavy rotor in a fluid, 1 % noise."""
    model = rf.models.OneMode()
    theta = model.vector(TRUTH | changed)
    frequency = covering_frequencies(model, theta, SPEEDS["one-mode"], 40)
    return circular_test(model, theta, speeds=SPEEDS["one-mode"], frequency=frequency, noise=0.01, seed=seed)


def asked(fit):
    """Sentences of a fit on values that are not possible."""
    return [words for words in fit.warnings if "not possible of a fluid" in words or "against the shaft" in words]


@pytest.mark.parametrize(
    ("factor", "number", "cause"),
    [
        (2.0, "2", "peak-to-peak given as 0-peak"),
        (4.44822, "4.448", "lbf given as N"),
        (9.80665, "9.807", "kgf given as N"),
        (25.4, "25.4", "um given as mil"),
        (175.127, "175.1", "inches"),
        (1000.0, "1000", "um given as mm"),
    ],
)
def test_the_factor_of_a_wrong_unit_is_asked_for_first(factor, number, cause):
    test = clean(seed=round(factor))
    fit = rf.fit(rf.models.OneMode(), replace(test, response=factor * test.response), known=KNOWN)
    (words,) = asked(fit)
    assert f"by a factor of {number} (" in words
    assert cause in words.split(" or of ")[0]
    pairs = re.findall(r"(K0|D|lam) ([\d.e+]*\d)", words.partition("With the")[2])
    found = {name: float(value) for name, value in pairs}
    assert found == pytest.approx({name: TRUTH[name] for name in ("K0", "D", "lam")}, rel=0.1)
    assert not [finding for finding in fit.findings if finding.severity == "error"]


def test_clean_rotors_are_asked_nothing():
    for seed in range(5):
        assert not asked(rf.fit(rf.models.OneMode(), clean(seed), known=KNOWN))


def test_a_negative_stiffness_without_a_known_structure_is_asked_nothing():
    # All that stands is fitted as K0, as of a magnetic bearing under a rigid rotor: no factor changes a sign.
    test = clean(K=0.0, Ds=0.0, K0=-3e5, lam=0.0)
    fit = rf.fit(rf.models.OneMode(), test, known={"K": 0.0, "Ds": 0.0, "lam": 0.0})
    assert fit.params["K0"].value == pytest.approx(-3e5, rel=0.05)
    assert not asked(fit)


def test_an_honest_negative_stiffness_is_no_error():
    fit = rf.fit(rf.models.OneMode(), clean(K0=-8e5), known=KNOWN)
    assert all("magnetic bearing" in words for words in asked(fit))
    assert not [finding for finding in fit.findings if finding.severity == "error"]


def test_a_fluid_against_the_shaft_is_said():
    test = clean(3)
    fit = rf.fit(rf.models.OneMode(), replace(test, speed=-test.speed), known=KNOWN)
    assert fit.params["lam"].value == pytest.approx(-0.46, abs=0.02)
    assert ["sense of rotation reversed" in words for words in asked(fit)] == [True]


def test_known_stiffness_far_above_what_is_left_of_it_is_found():
    # The mass that the fluid shares with the rotor crosses its bound in the closed form.
    test = clean(5)
    fit = rf.fit(rf.models.OneMode(), replace(test, response=175.127 * test.response), known=KNOWN)
    assert fit.redchi < fit.largest_redchi
    assert fit.params["K0"].value == pytest.approx(2.5e6 / 175.127 - 2e6, abs=100.0)
    assert np.isfinite(fit.params["K0"].stderr)


@pytest.mark.parametrize(("times", "said"), [(1.0, False), (10.0, False), (0.1, False), (1e4, True), (1e7, True)])
def test_an_inertia_that_no_disk_of_its_mass_has_is_asked_about(times, said):
    """Displacements do not show it: k12, k22, Ip and d2 of a tilt that is not read go with It; the fit is as good."""
    truth = {"M": 5.0, "It": 0.05, "Ip": 0.09, "k11": 4e6, "k12": 2e5, "k22": 4e4, "d1": 60.0, "d2": 0.6}
    model, w, root = rf.models.Overhung(), np.linspace(120.0, 1860.0, 40), np.sqrt(times)
    test = circular_test(
        model, model.vector(truth), speeds=np.array([500, 3000]) * np.pi / 30, seed=1,
        frequency=np.concatenate([-w[::-1], w]), noise=0.005, force_planes=["disk"],
    )  # fmt: skip
    start = truth | {"k12": root * 2e5} | {name: times * truth[name] for name in ("Ip", "k22", "d2")}
    known = {"It": start.pop("It") * times}
    fit = plain_fit(model, test.select(~np.char.startswith(test.direction, "r")), known=known, start=start)
    assert fit.redchi < 1.5
    assert any("radius of gyration" in words for words in fit.warnings) == said
