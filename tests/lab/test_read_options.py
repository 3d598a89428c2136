"""Options of reading undo known distortions of the measuring chain exactly: run-out, mounting, gain, delay."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sentences import refuses
from synthetic import TYPICAL, circular_test

import rotorfit as rf
from rotorfit.apps.study_files.study_file import read_study
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.probes import correct_channels, resolve_probe_angles
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.io.files import SUFFIXES
from rotorfit.models import WhirlWhip

EXAMPLES = Path(rf.__file__).parent / "lab" / "io"
SPEED = 200.0
W = np.r_[-500.0:0:50, 50:501:50]  # holds the speed on either side
CHANNELS = [("disk", "x"), ("disk", "y"), ("journal", "x"), ("journal", "y")]


@pytest.fixture(scope="module")
def rig() -> PerturbationTest:
    """What a perfect measuring chain reads, with known noise."""
    model = WhirlWhip()
    theta = model.vector(TYPICAL["whirl-whip"])
    return circular_test(model, theta, speeds=(SPEED,), frequency=W, noise=0.01, seed=3, sigma_known=True)


def per_row(test: PerturbationTest, values: dict[tuple[str, str], Any], default: Any) -> np.ndarray[Any, Any]:
    """A value of each channel for each row."""
    channels = zip(test.plane.tolist(), test.direction.tolist(), strict=True)
    return np.array([values.get(channel, default) for channel in channels])


def write(test: PerturbationTest, folder: Path, suffix: str = ".nc") -> Path:
    rf.write(test, folder / f"t{suffix}")
    return folder / f"t{suffix}"


def assert_same(again: Experiment, test: PerturbationTest, rtol: float = 1e-12) -> None:
    assert isinstance(again, PerturbationTest)
    np.testing.assert_allclose(again.response, test.response, rtol=rtol)
    np.testing.assert_allclose(again.sigma, test.sigma, rtol=rtol)
    for name in ("run", "plane", "direction", "force_plane"):
        assert getattr(again, name).tolist() == getattr(test, name).tolist()


# ---- gain and delay --------------------------------------------------------------------------------

GAINS = {("disk", "x"): 1.1 * np.exp(0.2j), ("journal", "y"): -0.5 + 0j}
DELAYS = {("disk", "y"): 2e-4, ("journal", "x"): -1e-4}


def through_chain(test: PerturbationTest) -> PerturbationTest:
    """A channel that delays a signal turns its phasor back, ``exp(-j |w| tau)``."""
    gain = per_row(test, GAINS, 1.0)
    turn = np.exp(-1j * np.abs(test.frequency) * per_row(test, DELAYS, 0.0))
    return replace(test, response=test.response * gain * turn, sigma=test.sigma * np.abs(gain))


@pytest.mark.parametrize("suffix", sorted(set(SUFFIXES) - {".tsv", ".txt", ".unv"}))
def test_gain_and_delay_of_each_channel(rig: PerturbationTest, tmp_path: Path, suffix: str) -> None:
    path = write(through_chain(rig), tmp_path, suffix)
    assert_same(rf.read(path, gains=GAINS, delays=DELAYS), rig, rtol=3e-11)  # UFF: twelve digits, three numbers


def test_a_delay_seen_in_time() -> None:
    """The probe's signal at time t is that of the shaft at t - tau."""
    tau, w, t = 3e-4, 400.0, np.linspace(0, 0.1, 7)
    phasor = 2e-5 * np.exp(0.7j)
    late = np.real(phasor * np.exp(1j * w * (t - tau)))
    test = rf.perturbation_test(
        run=["a"], speed=1.0, frequency=-w, force_plane=["p"], force=1.0, plane=["p"], direction=["x"],
        response=phasor * np.exp(-1j * w * tau),
    )  # fmt: skip
    np.testing.assert_allclose(late, np.real(test.response * np.exp(1j * w * t)), rtol=1e-12)
    np.testing.assert_allclose(correct_channels(test, {}, {("p", "x"): tau}).response, phasor, rtol=1e-12)


def test_combined_readings_are_corrected_as_their_probes(rig: PerturbationTest) -> None:
    """Both probes with one gain and delay: the combined amplitude, conjugated at negative w, has the same."""
    gain, tau = 1.3 * np.exp(0.4j), 2e-4
    x, y = rig.select(rig.direction == "x"), rig.select(rig.direction == "y")
    chain = gain * np.exp(-1j * np.abs(x.frequency) * tau)

    def combine(a: Any, b: Any) -> Any:
        return np.where(x.frequency > 0, (a + 1j * b) / 2, np.conj(a - 1j * b) / 2)

    z = replace(x, direction=np.full(len(x), "z"), response=combine(x.response * chain, y.response * chain))
    channels = [("disk", "z"), ("journal", "z")]
    corrected = correct_channels(z, dict.fromkeys(channels, gain), dict.fromkeys(channels, tau))
    np.testing.assert_allclose(corrected.response, combine(x.response, y.response), rtol=1e-12)


# ---- mounting of probes ------------------------------------------------------------------------------


def mounted(test: PerturbationTest, plane: str, first: float, second: float) -> PerturbationTest:
    """Readings of probes at two angles, degrees from X towards Y: the projection of the motion on each."""
    response = test.response.copy()
    for row in np.flatnonzero((test.plane == plane) & (test.direction == "x")):
        partner = (test.plane == plane) & (test.direction == "y") & (test.run == test.run[row])
        (other,) = np.flatnonzero(partner & (test.frequency == test.frequency[row]))
        x, y = test.response[row], test.response[other]
        for at, angle in ((row, np.radians(first)), (other, np.radians(second))):
            response[at] = x * np.cos(angle) + y * np.sin(angle)
    return replace(test, response=response)


@pytest.mark.parametrize(("first", "second"), [(45, 135), (-45, 45), (135, 45), (0, 90), (180, 270), (30, 100)])
def test_probes_at_other_angles(rig: PerturbationTest, tmp_path: Path, first: float, second: float) -> None:
    path = write(mounted(rig, "journal", first, second), tmp_path)
    again = rf.read(path, probe_angles={"journal": (first, second)})
    assert isinstance(again, PerturbationTest)
    # the error is that of the projection, a few 1e-16 of the larger probe over the sine of the angle between
    np.testing.assert_allclose(again.response, rig.response, atol=1e-14 * np.abs(rig.response).max(), rtol=0)
    if (second - first) % 180 == 90:  # a turn of two independent probes of equal noise leaves their noise as it is
        np.testing.assert_allclose(again.sigma, rig.sigma, rtol=1e-12)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(first=st.floats(-180, 180), between=st.floats(10, 170), turn=st.sampled_from([-1, 1]))
def test_any_two_probes_that_see_different_directions(first: float, between: float, turn: int) -> None:
    x, y = 3e-5 * np.exp(0.3j), 2e-5 * np.exp(-2j)
    a, b = np.radians([first, first + turn * between])
    test = rf.perturbation_test(
        run="r", speed=1.0, frequency=5.0, force_plane="p", force=1.0, plane="p", direction=["x", "y"],
        response=[x * np.cos(a) + y * np.sin(a), x * np.cos(b) + y * np.sin(b)], sigma=[1e-7, 2e-7],
    )  # fmt: skip
    again = resolve_probe_angles(test, {"p": (first, first + turn * between)})
    np.testing.assert_allclose(again.response, [x, y], rtol=1e-13 / np.sin(np.radians(between)))
    # X = (A sin b - B sin a) / sin(b - a), Y = (B cos a - A cos b) / sin(b - a), errors independent
    expected = np.hypot([1e-7 * np.sin(b), 1e-7 * np.cos(b)], [2e-7 * np.sin(a), 2e-7 * np.cos(a)])
    np.testing.assert_allclose(again.sigma, expected / np.sin(np.radians(between)), rtol=1e-10)


def test_turned_probes_are_worth_the_same_fit(rig: PerturbationTest, tmp_path: Path) -> None:
    """A rig with probes at +-45 degrees, read as mounted, gives the parameters of the rig."""
    turned = mounted(mounted(rig, "disk", 45, 135), "journal", -45, 45)
    again = rf.read(write(turned, tmp_path), probe_angles={"disk": (45, 135), "journal": (-45, 45)})
    one, other = (rf.closed_form(WhirlWhip(), test, known={"K3": 6000.0}) for test in (rig, again))
    for name, parameter in one.params.items():
        assert other.params[name].value == pytest.approx(parameter.value, rel=1e-8)


# ---- run-out --------------------------------------------------------------------------------------------

RUN_OUT = {("disk", "x"): 4e-6 * np.exp(1j), ("disk", "y"): 3e-6 * np.exp(-0.5j), ("journal", "y"): 5e-6j}


def test_run_out_at_once_per_turn(rig: PerturbationTest, tmp_path: Path) -> None:
    """A probe sees the run-out vector at |w| = Omega whichever way the force turns, and nowhere else."""
    at_1x = np.abs(rig.frequency) == SPEED
    assert at_1x.sum() == 2 * 2 * 4
    disturbed = replace(rig, response=rig.response + np.where(at_1x, per_row(rig, RUN_OUT, 0.0), 0.0))
    again = rf.read(write(disturbed, tmp_path), slow_roll=RUN_OUT)
    assert isinstance(again, PerturbationTest)
    np.testing.assert_allclose(again.response, rig.response, rtol=1e-10)


def start_up(run_out: complex) -> PerturbationTest:
    """Two start-ups; the rotor stands still below 300 rpm, where the probe sees nothing but run-out."""
    rpm = np.r_[100.0:300:25, 300:3000:100]
    moving = np.where(rpm < 300, 0.0, rpm * 1e-8) * np.exp(-rpm / 1e3 * 1j)
    parts = {
        "run": np.repeat(["a", "b"], rpm.size), "speed": np.tile(rpm, 2) * np.pi / 30,
        "frequency": np.tile(rpm, 2) * np.pi / 30, "force": np.repeat([1.0, -1.0], rpm.size),
        "response": np.r_[moving + run_out, -moving + 2 * run_out],
    }  # fmt: skip
    return rf.perturbation_test(**parts, force_plane=["disk"], plane=["disk"], direction=["x"])


def test_run_out_from_the_slow_readings_of_each_start_up(tmp_path: Path) -> None:
    path = write(start_up(6e-6 * np.exp(2j)), tmp_path)
    again = rf.read(path, slow_roll_below_rpm=300.0, difference=False)
    assert isinstance(again, PerturbationTest)
    np.testing.assert_allclose(again.response, start_up(0.0).response, atol=1e-20)


# ---- all of it --------------------------------------------------------------------------------------------


def test_everything_at_once_in_the_order_of_the_options(rig: PerturbationTest, tmp_path: Path) -> None:
    """Motion, seen by turned probes, with run-out, through the chain: reading goes back from the end."""
    seen = mounted(rig, "journal", 45, 135)
    at_1x = np.abs(rig.frequency) == SPEED
    seen = replace(seen, response=seen.response + np.where(at_1x, per_row(rig, RUN_OUT, 0.0), 0.0))
    path = write(through_chain(seen), tmp_path)
    options: dict[str, Any] = {
        "gains": GAINS, "delays": DELAYS, "slow_roll": RUN_OUT, "probe_angles": {"journal": (45, 135)},
    }  # fmt: skip
    again = rf.read(path, **options)
    assert isinstance(again, PerturbationTest)
    np.testing.assert_allclose(again.response, rig.response, atol=1e-13 * np.abs(rig.response).max(), rtol=0)

    def polar(value: complex, scale: float = 1.0) -> list[float]:
        return [float(abs(value) * scale), float(np.degrees(np.angle(value)))]

    gains = ", ".join(f'"{p} {d}" = {polar(v)}' for (p, d), v in GAINS.items())
    delays = ", ".join(f'"{p} {d}" = {v}' for (p, d), v in DELAYS.items())
    roll = ", ".join(f'"{p} {d}" = {polar(v, 1e6)}' for (p, d), v in RUN_OUT.items())
    text = (
        f'model = "whirl-whip"\n[[files]]\npath = "{path.name}"\ngains = {{{gains}}}\ndelays_s = {{{delays}}}\n'
        f"slow_roll_um_deg = {{{roll}}}\nprobe_angles_deg = {{journal = [45, 135]}}\n"
    )
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    (file,) = read_study(tmp_path / "study.toml").files
    told = file.read()
    assert isinstance(told, PerturbationTest)
    np.testing.assert_allclose(told.response, again.response, rtol=1e-12)


# ---- what is refused -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options",
    [
        {"gains": {("disc", "x"): 1.0}},
        {"gains": {("disk", "x"): 0.0}},
        {"gains": {("disk", "x"): np.nan}},
        {"gains": {"disk": 2.0}},
        {"delays": {("disk", "q"): 1e-4}},
        {"delays": {("disk", "x"): np.inf}},
        {"slow_roll": {("seal", "x"): 1e-6}},
        {"slow_roll": {("disk", "x"): np.nan}},
        {"slow_roll": {("disk", "x"): 1e-6}, "slow_roll_below_rpm": 300.0},
        {"slow_roll_below_rpm": 300.0},
        {"probe_angles": {"jornal": (45, 135)}},
        {"probe_angles": {"disk": (45, 225)}},
        {"probe_angles": {"disk": (45, np.nan)}},
        {"probe_angles": {"disk": 45}},
        {"speed": 100.0},
        {"speed_tolerance": -0.1},
    ],
)
def test_options_that_cannot_be_meant(rig: PerturbationTest, tmp_path: Path, options: dict[str, Any]) -> None:
    with refuses(ValueError):
        rf.read(write(rig, tmp_path), **options)


def test_readings_without_a_partner_cannot_be_resolved(rig: PerturbationTest, tmp_path: Path) -> None:
    rows = np.arange(len(rig))
    path = write(rig.select(rows != np.flatnonzero(rig.plane == "disk")[0]), tmp_path)
    with refuses(ValueError):
        rf.read(path, probe_angles={"disk": (45, 135)})
    path = write(rig.select(rig.direction == "x"), tmp_path)
    with refuses(ValueError):
        rf.read(path, probe_angles={"disk": (45, 135)})


def test_start_ups_without_slow_readings(tmp_path: Path) -> None:
    path = write(start_up(0.0), tmp_path)
    with refuses(ValueError):
        rf.read(path, slow_roll_below_rpm=50.0)


def test_corrections_of_probes_are_not_for_imposed_orbits(tmp_path: Path) -> None:
    columns = (
        "run,speed_rpm,frequency_rpm,plane,amplitude_um,phase_deg,force_x_N,force_x_phase_deg,"
        "force_y_N,force_y_phase_deg"
    )
    (tmp_path / "t.csv").write_text(f"{columns}\na,1000,300,seal,12,0,5,10,6,-80\n", encoding="utf-8")
    with refuses(ValueError):
        rf.read(tmp_path / "t.csv", gains={("seal", "x"): 2.0})


@pytest.mark.parametrize(
    ("name", "wanted", "low", "high"),
    [
        ("frequency_hz", (20.0, 60.0), 20.0, 60.0),
        ("frequency_rpm", (-math.inf, 2400.0), 0.0, 40.0),
        ("frequency_hz", [25.0, "75"], None, None),
        ("frequency_hz", 25.0, 25.0, 25.0),
    ],
)
def test_readings_are_chosen_by_frequency(
    tmp_path: Path, name: str, wanted: Any, low: float | None, high: float | None
) -> None:
    """Forward and backward alike, ends included whatever a unit does to their last digits."""
    model = WhirlWhip()
    hz = np.arange(5.0, 100.0, 5.0)
    w = 2 * np.pi * np.r_[-hz[::-1], hz]
    test = circular_test(model, model.vector(TYPICAL["whirl-whip"]), speeds=(SPEED,), frequency=w, noise=0.01)
    chosen = rf.read(write(test, tmp_path, ".csv"), where={name: wanted})
    assert isinstance(chosen, PerturbationTest)
    left = hz[np.isin(hz, [25.0, 75.0])] if low is None else hz[(hz >= low) & (hz <= high)]
    np.testing.assert_allclose(np.unique(np.round(chosen.frequency / (2 * np.pi), 9)), np.r_[-left[::-1], left])
    again = rf.read(write(test, tmp_path, ".csv"), exclude={name: wanted})
    assert len(again) == len(test) - len(chosen)


def test_a_frequency_to_choose_by_is_a_size_that_the_test_has(rig: PerturbationTest, tmp_path: Path) -> None:
    with refuses(ValueError):
        rf.read(write(rig, tmp_path), where={"frequency_hz": (-60.0, -20.0)})
    with refuses(ValueError):
        rf.read(EXAMPLES / "example-static-load.csv", where={"frequency_hz": (20.0, 60.0)})
