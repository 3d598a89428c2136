"""The first screen of a fit: the numbers that a reader asks for, with the digits and errors of all other outputs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain import plain_fit
from scipy.linalg import eigh
from synthetic import SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.identify.fitting.headline import decrement_of, headline, modes_at, named_modes
from rotorfit.identify.fitting.summary import WIDTH


@pytest.fixture(scope="module")
def fit() -> rf.FitResult:
    return rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": 6000.0})


def seal_fit() -> rf.FitResult:
    model = rf.models.Anisotropic()
    values = {"Kxx": 2e6, "Kyy": 2e6, "Kxy": 9e6, "Kyx": -9e6, "Dxx": 6e4, "Dyy": 6e4, "Mxx": 50.0, "Myy": 50.0}
    theta = model.vector({p.name: values.get(p.name, 0.0) for p in model.parameters})
    w = covering_frequencies(rf.models.OneMode(), rf.models.OneMode().vector(TYPICAL["one-mode"]), (300.0,), 30)
    return plain_fit(model, circular_test(model, theta, speeds=(300.0,), frequency=w, noise=0.01))


def test_print_is_the_head_of_the_summary_with_the_same_five_numbers(fit: rf.FitResult) -> None:
    text = str(fit)
    lines = text.splitlines()
    assert fit.summary().startswith(text)
    assert len(lines) <= 11
    assert max(map(len, fit.summary().splitlines())) <= WIDTH
    assert text.isascii()
    for name in ("D", "lam", "Mf"):
        p = fit.params[name]
        assert next(line for line in lines if line.startswith(f"{name} ")).split()[-1] != ""
        assert f"{p.shown().value} {p.shown().error}" in " ".join(text.split())
    onset = fit.threshold_speed().to("rpm")
    assert f"Unstable above {onset}" in " ".join(text.split())


def test_the_least_damping_is_that_of_the_eigenvalues() -> None:
    fit = plain_fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": 6000.0})
    speed = float(fit.speeds.max())
    found = next(n for n in headline(fit).numbers if n.name.startswith("least damping"))
    s = rf.models.eigenvalues(fit.model, fit.theta(), speed)
    decrement = min(2 * np.pi * -s.real / np.abs(s.imag))
    assert found.quantity.value == pytest.approx(decrement)
    names = [name for name, _, _ in named_modes(modes_at(fit, speed), sensed=True)]
    assert sorted(names) == ["1B", "1F", "2B", "2F"]
    _, ratio, _ = fit.natural_frequencies(speed)[0]
    assert decrement_of(ratio).value == pytest.approx(2 * np.pi * ratio.value / np.sqrt(1 - ratio.value**2))


def test_a_rotor_that_no_speed_changes_begins_with_its_resonances() -> None:
    """Against the eigenvalues of its masses and springs, and the truth of the law that a fluid follows."""
    fit = plain_fit(rf.models.TwoDisk(), rf.datasets.two_disk())
    numbers = headline(fit).numbers
    assert [n.name for n in numbers] == ["mode 1", "mode 2", "least damping, mode 1", "M1", "M2"]
    p = {name: parameter.value for name, parameter in fit.params.items()}
    springs = [[p["K1"] + p["K2"], -p["K2"]], [-p["K2"], p["K2"] + p["K3"]]]
    expected = np.sqrt(eigh(springs, np.diag([p["M1"], p["M2"]]), eigvals_only=True)) * 30 / np.pi
    damped = expected * np.sqrt(1 - np.array([0.03, 0.032]) ** 2)
    assert [n.quantity.value for n in numbers[:2]] == pytest.approx(damped, rel=1e-3)
    assert headline(fit).verdict.startswith(f"Resonance at {numbers[0].shown.value} and {numbers[1].shown.value} rpm.")


def test_modes_and_laws_lead_with_their_own_numbers() -> None:
    modal = plain_fit(rf.models.Modal(), rf.datasets.rk4(), phase_offsets="common")
    names = [n.name for n in headline(modal).numbers]
    assert names == ["mode 1", "least damping, mode 1", "M"]  # gains and participations say nothing of the rotor
    two = plain_fit(rf.models.Modal(("inboard", "outboard"), modes=2), rf.datasets.two_disk())
    names = [n.name for n in headline(two).numbers]
    assert names == ["mode 1", "mode 2", "damping, mode 1", "damping, mode 2", "M1"]
    damping = [n.quantity.value for n in headline(two).numbers[2:4]]
    assert damping == pytest.approx([2 * np.pi * zeta / np.sqrt(1 - zeta**2) for zeta in (0.03, 0.032)], rel=0.1)
    assert headline(modal).numbers[0].quantity.value == pytest.approx(modal.params["wn"].value * 30 / np.pi)
    law = rf.models.Muszynska()
    rotor = rf.models.OneMode(law=law, clearance_um=127.0)
    values = TYPICAL["one-mode"] | law.start(TYPICAL["one-mode"]["K0"], TYPICAL["one-mode"]["D"])
    w = np.linspace(20, 250, 12)
    test = rf.simulate(rotor, values, speed=150.0, frequency=w, force=[1.0, 5.0], noise=0.002, seed=1)
    fit = plain_fit(rotor, test, known={"K": values["K"], "Ds": values["Ds"]})
    assert headline(fit).numbers[-1].name == law.parameters[0].name


def test_shares_of_a_number_add_up_to_its_variance(fit: rf.FitResult) -> None:
    numbers = headline(fit).numbers
    assert [n.name for n in numbers][2:] == ["D", "lam", "Mf"]
    for number in numbers:
        assert sum(number.shares) == pytest.approx(1.0)


def test_a_seal_answers_with_coefficients() -> None:
    head = headline(seal_fit())
    assert [n.name for n in head.numbers] == ["K", "C", "M", "WFR", "Ceff"]
    row = head.fit.coefficients(300.0)
    by_name = {n.name: n.quantity for n in head.numbers}
    assert by_name["K"].unit == "MN/m"
    assert by_name["K"].value == pytest.approx((row["Kxx"].value + row["Kyy"].value) / 2e6)
    assert by_name["Ceff"].to("N s/m").value == pytest.approx(row.effective_damping(300.0).value)
    assert by_name["WFR"].value == pytest.approx(9e6 / 6e4 / 300.0, rel=0.1)
    assert "of shaft speed" in head.verdict


def test_a_fit_that_is_not_good_says_so() -> None:
    rig = rf.datasets.rig_lumped()
    wrong = plain_fit(
        rf.models.OneMode(planes=("journal",)),
        rig.select((rig.plane == "journal") & (rig.force_plane == "journal")),
        known={"M": 1.0},
    )
    head = headline(wrong, ())
    assert not head.good
    assert any(not check.good for check in head.checks)


def test_a_number_that_is_not_determined_says_so_in_its_place() -> None:
    fit = plain_fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped())
    assert "K0" in fit.identifiability.unresolved
    assert fit.params["K0"].shown().value == str(fit.params["K0"].shown()) == "not determined"
    assert not any(check.good for check in headline(fit).checks if "open" in check.words)


def test_the_last_of_several_conditions_is_shown() -> None:
    model = rf.models.OneMode()
    theta = model.vector(TYPICAL["one-mode"])
    w = covering_frequencies(model, theta, SPEEDS["one-mode"], 30)
    test = circular_test(model, theta, speeds=(100.0, 150.0), frequency=w, noise=0.01)
    fit = plain_fit(model, test, known=known_of("one-mode", TYPICAL["one-mode"]), per={"D": "speed_rpm"})
    names = [n.name for n in headline(fit).numbers]
    assert "D[speed_rpm=1432.39]" in names or any(name.startswith("D[speed_rpm=143") for name in names)
    assert replace(headline(fit), findings=()).verdict
