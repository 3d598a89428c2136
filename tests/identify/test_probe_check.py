"""Probes with a wrong gain, another angle, exchanged or inverted: named, with what they bias; no word on clean rigs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from clean_rigs import clean_test
from plain import plain_fit
from sentences import hear
from slips import exchanged, forced_by, lag_as_lead, mixed, read_through, thinned, turned
from slow_cases import slow_but

import rotorfit as rf
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.data.probes import correct_channels


@pytest.fixture(scope="module")
def rig() -> PerturbationTest:
    return rf.datasets.rig_open()


def only(test: PerturbationTest, code: str) -> list[Finding]:
    return [finding for finding in rf.check(test) if finding.code == code]


@pytest.mark.parametrize(("direction", "factor"), [("y", 1.3), ("x", 0.8), ("y", 1.06)])
def test_a_wrong_gain_is_named_with_its_factor(rig: PerturbationTest, direction: str, factor: float) -> None:
    matrix = [[factor, 0], [0, 1]] if direction == "x" else [[1, 0], [0, factor]]
    found = only(mixed(rig, matrix, ["journal"]), "probe-gain")
    assert len(found) == 1
    ratio = factor if direction == "y" else 1 / factor
    assert f"The y probe at journal reads {ratio:.3g} times what the x probe does" in found[0].message
    assert f"journal.y = {ratio:.3g}" in found[0].message
    assert all(rig.plane[list(found[0].rows)] == "journal")


def test_what_a_gain_is_said_to_bias_is_what_it_biases(rig: PerturbationTest) -> None:
    """30 % too much in one probe of a pair is 15 % in the orbit: 13 % too little in every coefficient, not in lam."""
    wrong = mixed(thinned(rig, 3), [[1, 0], [0, 1.3]])
    fits = [plain_fit(rf.models.WhirlWhip(), test, known={"K3": 0.0}) for test in (thinned(rig, 3), wrong)]
    share = {name: fits[1].params[name].value / fits[0].params[name].value for name in ("K2", "D", "Md", "lam")}
    for name in ("K2", "D", "Md"):
        assert share[name] == pytest.approx(1 / 1.15, rel=5e-3), name
    assert share["lam"] == pytest.approx(1.0, rel=5e-3)
    found = only(wrong, "probe-gain")
    assert all("comes out some 13 % too small if the y probe" in f.message for f in found)


def test_an_angle_between_the_probes_is_told_from_a_gain(rig: PerturbationTest) -> None:
    a = np.radians(100.0)
    found = only(mixed(rig, [[1, 0], [np.cos(a), np.sin(a)]], ["disk"]), "probe-gain")
    assert len(found) == 1
    hear(found[0].message)


@pytest.mark.parametrize(("direction", "delay"), [("y", 8e-4), ("x", 1.2e-3)])
def test_a_channel_that_comes_late_is_named_with_its_delay(rig: PerturbationTest, direction: str, delay: float) -> None:
    late = (rig.plane == "journal") & (rig.direction == direction)
    turn = np.exp(-1j * np.abs(rig.frequency) * delay)
    wrong = replace(rig, response=np.where(late, rig.response * turn, rig.response))
    (found,) = only(wrong, "probe-delay")
    assert f"The {direction} probe at journal is " in found.message
    said = float(found.message.split(f"delays, journal.{direction} = ")[1].split()[0])
    assert said == pytest.approx(delay, rel=0.02)
    right = correct_channels(wrong, {}, {("journal", direction): said})
    assert not only(right, "probe-delay")
    assert not {f.code for f in rf.check(wrong)} & {"probe-gain", "anisotropy"}


HZ = 2 * np.pi

FILTERS = {
    "high-pass of first order": ("x", 5.0, lambda w, c: 1j * w / (1j * w + c)),
    "high-pass of second order": ("y", 8.0, lambda w, c: -(w**2) / (c**2 - w**2 + 1j * np.sqrt(2) * c * w)),
    "low-pass of first order": ("x", 60.0, lambda w, c: 1 / (1 + 1j * w / c)),
}


@pytest.mark.parametrize("kind", FILTERS)
def test_a_probe_behind_a_filter_is_named_with_its_corner(rig: PerturbationTest, kind: str) -> None:
    """What isotropic supports make of a pair is exact here, so that only noise of 1 % moves the corner."""
    direction, corner, seen = FILTERS[kind]
    (found,) = only(read_through(rig, lambda w: seen(w, HZ * corner), _probe(rig, direction)), "probe-filter")
    assert f"The readings of the {direction} probe at disk are behind a {kind} with its corner at " in found.message
    assert float(found.message.split("corner at ")[1].split()[0]) == pytest.approx(corner, rel=0.03)
    assert all(rig.plane[list(found.rows)] == "disk")


def test_a_probe_that_gives_velocities_is_named(rig: PerturbationTest) -> None:
    for scale in (30.0, 300.0, 3000.0):
        wrong = read_through(rig, lambda w, scale=scale: 1j * w / scale, _probe(rig, "x"))
        (found,) = only(wrong, "probe-filter")
        hear(found.message)
        assert not only(wrong, "peak-to-peak")


def _probe(test: PerturbationTest, direction: str) -> np.ndarray:
    return (test.plane == "disk") & (test.direction == direction)


@pytest.mark.parametrize("factor", [25.4, 0.1, 2**-0.5])
def test_planes_that_answer_each_other_unequally_are_named_with_the_factor(
    rig: PerturbationTest, factor: float
) -> None:
    """Whatever the shaft, H_ab = H_ba: neither fluid at one plane nor gyroscopic moments of disks make them differ."""
    wrong = [
        read_through(rig, lambda w: factor, rig.plane == "disk"),
        forced_by(rig, factor, rig.force_plane == "disk"),
    ]
    larger = ("disk", "journal") if factor > 1 else ("journal", "disk")
    for test, (first, second) in zip(wrong, (larger, larger), strict=True):
        (found,) = only(test, "reciprocity")
        said = float(found.message.split(f"{first} answers forces at {second} ")[1].split()[0])
        assert said == pytest.approx(max(factor, 1 / factor), rel=0.02)


MIRRORED = {
    "probes of both planes exchanged": (exchanged, "probes-exchanged", "at disk and journal are exchanged"),
    "probes exchanged": (lambda t: exchanged(t, ["journal"]), "probes-exchanged", "at journal are exchanged"),
    "y inverted": (
        lambda t: mixed(t, [[1, 0], [0, -1]], ["journal"]),
        "probes-inverted",
        "at journal are inverted in y",
    ),
    "x inverted": (lambda t: mixed(t, [[-1, 0], [0, 1]], ["disk"]), "probes-inverted", "at disk are inverted in x"),
    "lag as lead": (lag_as_lead, "lag-as-lead", "phases of lag are given as lead"),
}


@pytest.mark.parametrize("case", slow_but(MIRRORED, "y inverted", "lag as lead"))
def test_mirrored_orbits_are_an_error_that_a_fit_explains(rig: PerturbationTest, case: str) -> None:
    change, code, words = MIRRORED[case]
    wrong = change(thinned(rig, 4))
    assert [finding.severity for finding in only(wrong, "wrong-direction")] == ["error"]
    first = plain_fit(rf.models.WhirlWhip(), wrong, known={"K3": 6000.0}).findings[0]
    assert first.code == code
    assert words in first.message


@pytest.mark.parametrize(
    ("planes", "angle"),
    slow_but(
        [(planes, angle) for planes in (["disk"], ["journal"], None) for angle in (45.0, -45.0, 90.0)],
        (["disk"], 45.0),
        (None, 90.0),
    ),
)
def test_a_pair_at_another_angle_is_an_error(rig: PerturbationTest, angle: float, planes: list[str] | None) -> None:
    wrong = turned(thinned(rig, 4), angle, planes)
    findings = plain_fit(rf.models.WhirlWhip(), wrong, known={"K3": 6000.0}).findings
    (found,) = [finding for finding in findings if finding.code == "probes-turned"]
    assert found.severity == "error"
    assert f"sit {angle:g} degrees from where they are given" in found.message


@pytest.mark.parametrize("planes", [["disk"], ["journal"], None])
def test_negative_forces_are_an_error_of_the_data_alone(rig: PerturbationTest, planes: list[str] | None) -> None:
    (found,) = only(turned(rig, 180.0, planes), "negative-damping")
    assert found.severity == "error"
    hear(found.message)


@pytest.mark.parametrize("name", ["one-mode", "whirl-whip", "two-disk", "overhung", "anisotropic"])
def test_clean_rigs_are_left_alone(name: str) -> None:
    """Isotropic ones without a word on their probes, anisotropic ones with a note that says what it may be."""
    for seed in range(25):
        codes = {finding.code for finding in rf.check(clean_test(name, 1000 + seed))}
        assert not codes & {
            "probe-gain",
            "probe-delay",
            "probe-filter",
            "probe-angle",
            "wrong-direction",
            "reciprocity",
        }, (name, seed)
        assert name == "anisotropic" or "anisotropy" not in codes, (name, seed)


def test_anisotropy_below_two_percent_of_energy_is_seen() -> None:
    """kx and ky 10 % apart: what a fixed share of the energy would pass is many times the noise."""
    model = rf.models.Anisotropic()
    values = {
        "Kxx": 1e4, "Kyy": 1.1e4, "Kxy": 0.0, "Kyx": 0.0, "Dxx": 200.0, "Dyy": 200.0, "Dxy": 0.0, "Dyx": 0.0,
        "Mxx": 1.0, "Mxy": 0.0, "Myx": 0.0, "Myy": 1.0,
    }  # fmt: skip
    from synthetic import circular_test

    w = np.linspace(20.0, 250.0, 60)
    test = circular_test(
        model, model.vector(values), speeds=(100.0,), frequency=np.r_[-w[::-1], w], noise=0.003, seed=1
    )
    assert [finding.severity for finding in only(test, "anisotropy")] == ["note"]


def test_a_static_band_cannot_tell_a_gain_from_an_anisotropic_stiffness() -> None:
    model = rf.models.OneMode()
    from synthetic import TYPICAL, circular_test

    w = np.linspace(2.0, 20.0, 60)  # far below any resonance
    test = circular_test(
        model, model.vector(TYPICAL["one-mode"]), speeds=(100.0,), frequency=np.r_[-w[::-1], w], noise=0.003, seed=1
    )
    found = only(mixed(test, [[1, 0], [0, 1.2]]), "anisotropy")
    assert len(found) == 1
    hear(found[0].message)


def test_phases_of_responses_alone_given_as_lead_are_not_explained_by_probes() -> None:
    """The force's phase is lead, the responses' are lag."""
    rig = thinned(rf.datasets.rig_open(), 4)
    fit = plain_fit(rf.models.WhirlWhip(), replace(rig, response=rig.response.conj()), known={"K3": 6000.0})
    assert "phase lag read as lead" in next(f.message for f in fit.findings if f.code == "wrong-direction")
    assert not {finding.code for finding in fit.findings} & {"probes-exchanged", "probes-inverted"}
