"""Filters, factors and angles of readings that a fit names, on rotors of finite elements that no model is."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from clean_rigs import clean_test
from fe_rigs import K3, RPM, TYPICAL, Rig, random_rig
from honest_errors import WORLDS, simulate
from plain import plain_fit, summary_words
from sentences import hear
from slips import forced_by, read_through, thinned
from slow_cases import slow_but
from synthetic import circular_test, covering_frequencies

import rotorfit as rf
from rotorfit.identify.diagnosis import findings
from rotorfit.identify.diagnosis.data_errors import undone
from rotorfit.identify.diagnosis.findings import explained
from rotorfit.identify.diagnosis.trial_fits import corrected_by_value
from rotorfit.identify.fitting.fit import fitted
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.lab.data.experiments import PerturbationTest, perturbations

Slip = Callable[[PerturbationTest], PerturbationTest]

HZ = 2 * np.pi
ODD = "disk 1000 +1"


def high_pass(corner: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda w: 1j * w / (1j * w + HZ * corner)


def low_pass(corner: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda w: 1 / (1 + 1j * w / (HZ * corner))


def at_disk(test: PerturbationTest) -> np.ndarray:
    return test.plane == "disk"


def x_at_disk(test: PerturbationTest) -> np.ndarray:
    return at_disk(test) & (test.direction == "x")


# What is done to the data, what has to be said of it, and the numbers in that; all with their true values.
NAMED: dict[str, tuple[Slip, str, list[float]]] = {
    "all behind a high-pass": (
        lambda t: read_through(t, high_pass(20.0)),
        r"all readings are behind a high-pass of first order with its corner at ([\d.]+) Hz",
        [20.0],
    ),
    "all behind a slow high-pass": (
        lambda t: read_through(t, high_pass(6.0)),
        r"all readings are behind a high-pass of first order with its corner at ([\d.]+) Hz",
        [6.0],
    ),
    "all behind a low-pass": (
        lambda t: read_through(t, low_pass(50.0)),
        r"all readings are behind a low-pass of first order with its corner at ([\d.]+) Hz",
        [50.0],
    ),
    "velocities": (lambda t: read_through(t, lambda w: 1j * w / 300), r"all readings are velocities", []),
    "integrated once too often": (
        lambda t: read_through(t, lambda w: 100 / (1j * w)),
        r"all readings are integrated once too often",
        [],
    ),
    "late": (lambda t: read_through(t, lambda w: np.exp(-1.5e-3j * w)), r"all readings are ([\d.]+) s late", [1.5e-3]),
    "a plane behind a high-pass": (
        lambda t: read_through(t, high_pass(20.0), at_disk(t)),
        r"the readings at disk are behind a high-pass of first order with its corner at ([\d.]+) Hz",
        [20.0],
    ),
    "velocities at a plane": (
        lambda t: read_through(t, lambda w: 1j * w / 300, at_disk(t)),
        r"the readings at disk are velocities",
        [],
    ),
    "a probe behind a low-pass": (
        lambda t: read_through(t, low_pass(40.0), x_at_disk(t)),
        r"the readings of the x probe at disk are behind a low-pass of first order with its corner at ([\d.]+) Hz",
        [40.0],
    ),
    "a weight told twice too heavy": (
        lambda t: forced_by(t, 2.0, t.run == ODD),
        r"the readings of run disk 1000 \+1 are ([\d.]+) times as large as the rest makes one expect, or the forces of "
        r"run disk 1000 \+1 are given ([\d.]+) times as large as they are",
        [0.5, 2.0],
    ),
    "a weight told ten times too heavy": (
        lambda t: forced_by(t, 10.0, t.run == ODD),
        r"the forces of run disk 1000 \+1 are given ([\d.]+) times as large as they are",
        [10.0],
    ),
    "a weight in another hole": (
        lambda t: forced_by(t, np.exp(-0.5j * np.pi / 4), t.run == ODD),
        r"the readings of run disk 1000 \+1 lead by ([\d.]+) degrees .* act \+([\d.]+) degrees from where",
        [22.5, 22.5],
    ),
    "a weight on the other side": (
        lambda t: forced_by(t, -1.0, t.run == ODD),
        r"run disk 1000 \+1 are upside down .* or the forces of run disk 1000 \+1 have the wrong sign",
        [],
    ),
    "a plane peak-to-peak in one run": (
        lambda t: read_through(t, lambda w: 2.0, at_disk(t) & (t.run == ODD)),
        r"the readings of run disk 1000 \+1 at disk are ([\d.]+) times .* as by peak-to-peak amplitudes",
        [2.0],
    ),
    "a plane in mil as um at one speed": (
        lambda t: read_through(t, lambda w: 1 / 25.4, at_disk(t) & (t.speed < 150.0)),
        r"the readings at 1000 rpm at disk are ([\d.]+) times .* as by mil read as um",
        [1 / 25.4],
    ),
    "a session peak-to-peak": (
        lambda t: read_through(t, lambda w: 2.0, t.speed > 150.0),
        r"the readings at 2000 rpm are ([\d.]+) times .* as by peak-to-peak amplitudes read as 0-peak, or the forces",
        [2.0],
    ),
}


@pytest.fixture(scope="module")
def rig() -> PerturbationTest:
    return Rig(**TYPICAL).campaign(RPM * np.array([1000.0, 2000.0]), seed=3, lines=18, top=480.0)


def said(fit: rf.FitResult) -> list[str]:
    return [finding.message for finding in explained(fit)]


@pytest.mark.parametrize(
    "slip",
    slow_but(
        NAMED,
        "velocities",
        "late",
        "a plane behind a high-pass",
        "a probe behind a low-pass",
        "a weight in another hole",
        "a plane in mil as um at one speed",
        "a session peak-to-peak",
    ),
)
def test_what_was_done_to_readings_is_named_with_its_number(slip: str, rig: PerturbationTest) -> None:
    """The lumped model misses this shaft by a few times its noise, so that numbers are some per cent off."""
    make, words, numbers = NAMED[slip]
    wrong = make(rig)
    fit = plain_fit(rf.models.WhirlWhip(), wrong, known={"K3": K3})
    found = next((one for one in explained(fit) if re.search(words, one.message)), None)
    assert found is not None, said(fit)
    told = re.search(words, found.message)
    assert told is not None
    assert [float(number) for number in told.groups()] == pytest.approx(numbers, rel=0.07)
    name = found.correction
    if name is None:  # of all velocities and the like the unit is not known: the sentence has a name to complete
        (name,) = re.findall(r"--undo '(.*?)'", found.message)
        name = name.replace(": 1 at", f": {1 / 300 if found.code == 'velocities' else 100} at")
    (mended,) = undone([wrong], [name])  # what is said to undo it leaves the misfit of the model alone
    assert plain_fit(rf.models.WhirlWhip(), mended, known={"K3": K3}).redchi == pytest.approx(11.3, rel=0.08)


def test_accelerations_are_half_a_turn_ahead(rig: PerturbationTest) -> None:
    """A fit of their shape with negative damping misses them so little that trial fits name no cause."""
    (found,) = rf.check(read_through(rig, lambda w: -(w**2) / 1e5))
    assert (found.severity, found.code) == ("error", "negative-damping")
    hear(found.message)


def test_what_explains_the_data_alike_is_all_said(rig: PerturbationTest) -> None:
    """Whether one session is twice too large or the other one half as large, nothing tells."""
    told = " ".join(said(plain_fit(rf.models.WhirlWhip(), NAMED["a session peak-to-peak"][0](rig), known={"K3": K3})))
    factors = dict(re.findall(r"the readings at (\d+) rpm are ([\d.]+) times", told))
    assert float(factors["1000"]) == pytest.approx(0.5, rel=0.02)
    assert float(factors["2000"]) == pytest.approx(2.0, rel=0.02)


def test_a_rotor_as_it_is_and_filters_too_slow_to_tell_name_nothing(rig: PerturbationTest) -> None:
    for test in (rig, read_through(rig, high_pass(0.1)), read_through(rig, low_pass(20e3))):
        assert not said(plain_fit(rf.models.WhirlWhip(), test, known={"K3": K3}))


def _three_masses(seed: int) -> PerturbationTest:
    model, rng = rf.models.Chain(planes=("a", "b", "c")), np.random.default_rng(seed)
    sizes = {"M": (-0.3, 0.5), "K": (4.5, 6.0), "D": (0.5, 2.5)}
    values = {name: 10 ** rng.uniform(*sizes[name[0]]) for name in model.parameter_names}
    theta = model.vector(values)
    w = covering_frequencies(model, theta, (100.0,), 60)
    return circular_test(model, theta, speeds=(100.0,), frequency=w, noise=0.005, seed=seed)


def _at(test: PerturbationTest, *planes: str) -> PerturbationTest:
    return test.select(np.isin(test.plane, planes) & np.isin(test.force_plane, planes))


Case = tuple[rf.models.RotorModel, PerturbationTest]
ONE, CHAIN, DISKS = rf.models.OneMode, rf.models.Chain, rf.models.TwoDisk

MISSES: dict[str, Callable[[PerturbationTest], Case]] = {
    "three masses, two known": lambda _: (CHAIN(planes=("a", "c")), _at(_three_masses(0), "a", "c")),
    "three masses, two disks": lambda _: (DISKS(planes=("a", "c")), _at(_three_masses(1), "a", "c")),
    "three masses, one known": lambda _: (ONE(planes=("a",)), _at(_three_masses(2), "a")),
    "a shaft as one mode at its disk": lambda rig: (ONE(planes=("disk",)), _at(rig, "disk")),
    "a shaft as one mode at its journal": lambda rig: (ONE(), _at(rig, "journal")),
    "a shaft and its fluid as two disks": lambda rig: (DISKS(planes=("disk", "journal")), rig),
    "a shaft and its fluid as a chain": lambda rig: (CHAIN(planes=("disk", "journal")), rig),
    "whirl and whip as one mode": lambda _: (ONE(), _at(clean_test("whirl-whip", 0), "journal")),
    "unlike supports 0": lambda _: (ONE(), _at(clean_test("anisotropic", 0), "journal")),
    "unlike supports 1": lambda _: (ONE(), _at(clean_test("anisotropic", 1), "journal")),
    "unlike supports 2": lambda _: (ONE(), _at(clean_test("anisotropic", 2), "journal")),
}
"""Models that miss their rotors by far, without a slip in the data."""


@pytest.mark.parametrize(
    "case",
    slow_but(MISSES, "three masses, one known", "a shaft as one mode at its journal", "unlike supports 0"),
)
def test_a_model_that_misses_its_rotor_is_no_slip_of_the_readings(case: str, rig: PerturbationTest) -> None:
    model, test = MISSES[case](rig)
    fit = plain_fit(model, test)
    assert fit.redchi > 10
    assert not said(fit)


def test_one_mode_with_wrong_values_told_is_no_level_in_decibels() -> None:
    """Amplitudes of a few hundred um, taken for levels, leave one peak, which explains itself."""
    rng = np.random.default_rng(11)
    _, shaft, speeds, _ = [random_rig(rng) for _ in range(4)][-1]
    test = _at(shaft.campaign(speeds, 3, lines=40, top=900.0), "journal")
    fit = plain_fit(ONE(), test, known={"Mf": 0.0, "lam": 0.3, "K": 0.0})
    assert fit.redchi > 1000
    assert not said(fit)


def test_forces_that_scatter_from_run_to_run_blame_none() -> None:
    """Four runs of an exact model with forces off by -37, +11, +33 and -6 %: the first is only the worst of all."""
    world = replace(WORLDS["force 1 % from run to run"], gain=0.15)
    test = simulate(world, np.random.default_rng(1))
    fit = plain_fit(ONE(), test, known={name: world.truth[name] for name in ("K", "Ds")})
    assert fit.redchi > 1000
    assert not said(fit)


@pytest.mark.parametrize("known", [{"lam": 0.2}, {"Mf": 0.0}])
def test_wrong_known_values_are_no_slip_of_the_readings(known: dict[str, float], rig: PerturbationTest) -> None:
    fit = plain_fit(rf.models.WhirlWhip(), thinned(rig, 2), known={"K3": K3, **known})
    assert fit.redchi > 10
    assert not said(fit)


@pytest.mark.slow
def test_a_known_damping_twice_too_large_is_said_beside_the_scale_that_it_asks_for(rig: PerturbationTest) -> None:
    fit = plain_fit(rf.models.WhirlWhip(), rig, known={"K3": K3, "D": 2 * TYPICAL["D"]})
    assert any("unless what was given as known (K3, D) is wrong" in told for told in summary_words(fit))


@pytest.mark.parametrize("start", [{"lam": 1.9}, {"K0": 5e8, "D": 4e6, "M": 12e3, "Mf": 1.5e3}])
def test_a_search_that_went_astray_blames_itself_and_not_the_data(start: dict[str, float]) -> None:
    """Trial fits start anew: without any error undone the model explains the data from where they ended."""
    truth = {"M": 12.0, "K": 2e6, "Ds": 600.0, "K0": 5e5, "D": 4000.0, "lam": 0.46, "Mf": 1.5}
    model, speeds = rf.models.OneMode(), (157.0, 314.0)
    theta = model.vector(truth)
    frequency = covering_frequencies(model, theta, speeds, 60)
    test = circular_test(model, theta, speeds=speeds, frequency=frequency, noise=0.005, seed=3)
    astray = fitted(model, (test,), FitSettings(known={"K": 2e6, "Ds": 600.0}, start=start))  # as no user's fit ends
    assert astray.redchi > 1000
    found = explained(astray)
    assert [(one.severity, one.code) for one in found] in ([], [("warning", "local-minimum")])
    if found:
        values = {name: float(value) for name, value in re.findall(r"(\w+)=(-?[\d.e+-]+\d)", found[0].remedy or "")}
        assert values == pytest.approx({name: truth[name] for name in values}, rel=0.2)
        assert set(values) == {"M", "K0", "D", "lam", "Mf"}
        assert "The search ended in a local minimum" in summary_words(astray)


def test_an_internal_problem_of_the_diagnosis_is_the_programs_own(monkeypatch: pytest.MonkeyPatch) -> None:
    model, theta = rf.models.OneMode(), np.array([1.2, 8000.0, 8.0, 9000.0, 450.0, 0.46, 0.4])
    frequency = covering_frequencies(model, theta, (100.0, 180.0), 40)
    test = circular_test(model, theta, speeds=(100.0, 180.0), frequency=frequency, noise=0.01)
    fit = plain_fit(model, test.select(test.frequency > 0), known={"K": 8000.0, "Ds": 8.0})
    shown = fit.findings
    empty: list[int] = []
    monkeypatch.setattr(findings, "explained", lambda *_: empty[len(shown)])
    again = replace(fit).findings
    assert set(shown) <= set(again)
    assert [one.code for one in again if one not in shown] == ["internal-problem"]
    (own,) = [one for one in again if one.code == "internal-problem"]
    assert own.severity == "warning"
    assert "not of these data" in own.message
    assert own.message in summary_words(replace(fit))
    assert "IndexError" in own.message


def test_a_rotor_that_is_not_found_is_diagnosed_without_an_exception() -> None:
    """A trial without a finite result is no explanation."""
    model, speeds = rf.models.Overhung(), (52.0, 157.0, 628.0)
    truth = {"M": 5.0, "It": 0.05, "Ip": 0.09, "k11": 4e6, "k12": 3e5, "k22": 4e4, "d1": 6.0, "d2": 0.06}
    w = np.linspace(120.0, 1860.0, 30)
    test = circular_test(
        model, model.vector(truth), speeds=speeds, frequency=np.concatenate([-w[::-1], w]), noise=0.05, seed=1,
        force_planes=["disk"],
    )  # fmt: skip
    test = test.select(~np.char.startswith(test.direction, "r"))
    start = {"M": 9.0, "Ip": 0.9, "k11": 1e7, "k12": 2.7e6, "k22": 9e5, "d1": 100.0, "d2": 1.6}
    lost = fitted(model, (test,), FitSettings(known={"It": 0.05}, start=start))
    assert lost.redchi > 10
    assert "internal-problem" not in {one.code for one in lost.findings}


def test_a_table_of_one_frequency_is_diagnosed_without_an_exception(rig: PerturbationTest) -> None:
    w = np.abs(rig.frequency)
    one = rig.select(w == np.unique(w)[7])
    wrong = {"K3": K3, "Md": 40.0, "Mb": 9.0, "Ds": 0.0, "sigma": 1.0, "Mf": 0.0, "lam": 0.4}
    fit = plain_fit(rf.models.WhirlWhip(), one, known=wrong)
    assert "internal-problem" not in {found.code for found in fit.findings}


@pytest.mark.parametrize(
    "name", ["delay (all: --1 s)", "delay (all: 1e999 s)", "readings-scaled (of forward whirl: 2 at +-1 degrees)"]
)
def test_a_value_that_is_no_number_is_no_correction(name: str) -> None:
    assert corrected_by_value(perturbations((rf.datasets.rig_open(),)), name) is None
