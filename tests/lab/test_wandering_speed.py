"""Speeds that wander while a sweep runs: the model has the speed of each line, a sweep and a name have the set one.

Simulated with NumPy and the equation of motion of one mode in a seal, none of it the project's.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import recorded
from plain import plain_fit

import rotorfit as rf
from rotorfit.estimators.blocks.set_speeds import set_speeds

STIFFNESS, DAMPING, MASS, LAM = 20000.0, 60.0, 1.2, 0.46
THRESHOLD = np.sqrt(STIFFNESS / MASS) / LAM
RPM = np.pi / 30
KNOWN = {"K": 0.0, "Ds": 0.0, "Mf": 0.0}
LINES = 50


def slow(rng: np.random.Generator) -> Any:
    """A wander of 0.3 % (rms) by the first three harmonics of the sweep."""
    turns = 2 * np.pi * np.outer(np.arange(1, 4), np.linspace(0, 1, LINES))
    wander = rng.normal(size=3) @ np.sin(turns) + rng.normal(size=3) @ np.cos(turns)
    return 0.003 * wander / np.sqrt(np.mean(wander**2))


def jitter(rng: np.random.Generator) -> Any:
    """Independent from line to line, 0.02 %."""
    return rng.normal(scale=2e-4, size=LINES)


def coarse(rng: np.random.Generator) -> Any:
    """The same of 0.3 %, as where a speed is logged over few turns: single lines are 0.5 % from all others."""
    return rng.normal(scale=3e-3, size=LINES)


def swept(seed: int, wander: Any, probes: int, speeds: tuple[float, ...] = (1000.0, 1500.0, 2000.0)) -> Any:
    """Rows of sweeps both ways at each speed, and the test made of them."""
    rng = np.random.default_rng(seed)
    rows: list[tuple[Any, ...]] = []
    for rpm in speeds:
        for way, name in ((1, "forward"), (-1, "backward")):
            w = way * np.linspace(200, 2400, LINES) * RPM
            speed = rpm * RPM * (1 + wander(rng))
            z = 4.0 / (STIFFNESS - MASS * w**2 + 1j * DAMPING * (w - LAM * speed))
            x = z if way > 0 else z.conj()  # the phasor of Re(z exp(jwt)) by exp(j|w|t)
            noise = 0.003 * np.abs(z).max()
            for direction, own in (("x", x), ("y", -way * 1j * x))[:probes]:
                read = own + noise * (rng.normal(size=LINES) + 1j * rng.normal(size=LINES))
                rows += [(f"{rpm:g} {name}", *line, direction, z) for *line, z in zip(speed, w, read, strict=True)]
    run, speed, w, direction, response = (np.array(column) for column in zip(*rows, strict=True))
    return rf.perturbation_test(
        run=run, speed=speed, frequency=w, force_plane="seal", force=4.0, plane="seal", direction=direction,
        response=response,
    )  # fmt: skip


def fitted(test: Any, **options: Any) -> Any:
    return plain_fit(rf.models.OneMode(planes=("seal",)), test, known=KNOWN, **options)


@pytest.mark.parametrize("wander", [slow, jitter, coarse])
def test_error_bars_hold_where_the_speed_wanders(wander: Any) -> None:
    """Of 40 intervals of 95 % fewer than 33 hold the truth once in 10,000 times; parameters share the draws."""
    held = {"lam": 0, "threshold": 0}
    redchi, warned = [], 0
    for seed in range(20):
        for probes in (1, 2):
            fit = fitted(swept(seed, wander, probes))
            for name, truth, found in (
                ("lam", LAM, fit.params["lam"]),
                ("threshold", THRESHOLD, fit.threshold_speed()),
            ):
                low, high = found.interval(0.95, share="noise")
                held[name] += low <= truth <= high
            redchi.append(fit.redchi)
            warned += bool(fit.notices)
            assert fit.speeds.size == 3
    assert min(held.values()) >= 33
    assert 0.9 < np.mean(redchi) < 1.15  # one probe's noise is estimated from smoothness, by 5 to 10 % too small
    assert warned <= 3


def test_files_keep_the_speed_of_each_line(tmp_path: Path) -> None:
    test = swept(1, slow, 2)
    plain = fitted(test)
    for suffix in (".csv", ".uff", ".nc"):
        rf.write(test, tmp_path / f"t{suffix}")
        again = rf.read(tmp_path / f"t{suffix}")
        np.testing.assert_allclose(np.sort(again.speed), np.sort(test.speed), rtol=1e-9)
        assert fitted(again).params["lam"].value == pytest.approx(plain.params["lam"].value, rel=1e-7), suffix


def test_names_and_groups_have_the_set_speed() -> None:
    test = swept(2, slow, 2)
    names = np.unique(test.attribute("speed_rpm"))
    np.testing.assert_allclose(names, [1000, 1500, 2000], rtol=1e-3)
    fit = fitted(test, per={"D": "speed_rpm"})
    assert sum(name.startswith("D[") for name in fit.params) == 3
    assert [round(value, -1) for value in fit.speeds / RPM] == [1000, 1500, 2000]


def test_a_run_of_several_set_speeds_is_several_sweeps() -> None:
    test = swept(3, jitter, 1)
    one = replace(test, run=np.full(len(test), "all"))
    assert np.unique(one.set_speed).size == 3
    assert 0.8 < fitted(one).redchi < 1.3


def test_probes_that_log_the_speed_apart_make_one_orbit() -> None:
    test = swept(4, slow, 2)
    late = np.where(test.direction == "y", 1.00005, 1.0)
    apart = rf.perturbation_test(
        **{name: getattr(test, name) for name in test._columns()} | {"speed": test.speed * late}
    )
    assert apart.lines[0].size == test.lines[0].size
    assert fitted(apart).params["lam"].value == pytest.approx(fitted(test).params["lam"].value, rel=1e-4)


def test_a_swept_speed_is_none_that_was_set() -> None:
    ramp = np.linspace(100.0, 120.0, 200)
    np.testing.assert_array_equal(set_speeds(ramp, np.full(200, 30.0), np.zeros(200, dtype=int)), ramp)


MEASURED = """
rotation = "ccw"
[shaft]
channel = "keyphasor_shaft"
[[probe]]
plane = "disk"
channel = "disk_X"
angle_deg = 0.0
sensitivity_V_per_mm = 7.87
[[probe]]
plane = "disk"
channel = "disk_Y"
angle_deg = 90.0
sensitivity_V_per_mm = 7.87
[force]
plane = "disk"
channel_x = "cell_X"
channel_y = "cell_Y"
sensitivity_V_per_N = 0.01
"""


def recorded_sweeps(
    folder: Path, wander: float, seconds: float = 8.0, measured: bool = False, turning: float = 0.0
) -> list[Path]:
    """Volts of a sweep each way at 1800 rpm while the speed wanders; the rotor integrated in time (Runge-Kutta).
    Stiffness that is uneven and turns with the shaft takes the fluid's place."""
    rng, ways = np.random.default_rng(3), np.array([1, -1])
    step, count, mean = 1 / (2 * recorded.RATE), round(seconds * recorded.RATE), 1800 * RPM
    rate = 2 * np.pi * np.array([[0.6], [1.3], [2.2]]) / seconds
    phase = rng.uniform(0, 2 * np.pi, (3, 2))
    slope, size, unbalance = 2 * np.pi * 40.0 / seconds, wander * np.sqrt(2 / 3), 1.6e-4
    half_steps = np.arange(4 * count + 1)[:, None] * step / 2
    drive = (2 * np.pi * 5 + slope * half_steps / 2) * half_steps
    speed = mean * (1 + size * sum(np.cos(rate[k] * half_steps + phase[k]) for k in range(3)))
    angle = mean * (half_steps + size * sum(np.sin(rate[k] * half_steps + phase[k]) / rate[k] for k in range(3)))
    w = 2 * np.pi * 5 + slope * half_steps
    force = unbalance * (w**2 - 1j * ways * slope) * np.exp(1j * ways * (drive + np.radians(40.0)))
    stiffness = STIFFNESS - 1j * DAMPING * (0.0 if turning else LAM) * speed
    uneven = turning * np.exp(2j * angle)

    def change(at: int, state: Any) -> Any:
        held = stiffness[at] * state[0] + uneven[at] * state[0].conj()
        return np.array([state[1], (force[at] - DAMPING * state[1] - held) / MASS])

    state, motion = np.zeros((2, 2), dtype=complex), np.zeros((count, 2), dtype=complex)
    for number in range(2 * count):
        if number % 2 == 0:
            motion[number // 2] = state[0]
        at = 2 * number
        first = change(at, state)
        second = change(at + 1, state + step / 2 * first)
        third = change(at + 1, state + step / 2 * second)
        state = state + step / 6 * (first + 2 * second + 2 * third + change(at + 2, state + step * third))
    paths = []
    for number, name in enumerate(("forward", "backward")):
        channels = {
            f"disk_{axis}": -10 + 7870 * part + 3e-3 * rng.normal(size=count)
            for axis, part in (("X", motion[:, number].real), ("Y", motion[:, number].imag))
        }
        channels["keyphasor_shaft"] = recorded.notch(angle[: 4 * count : 4, number])
        if measured:
            force_there = force[: 4 * count : 4, number]
            channels |= {"cell_X": 0.01 * force_there.real, "cell_Y": 0.01 * force_there.imag}
        else:
            channels["keyphasor_perturbator"] = recorded.notch(drive[: 4 * count : 4, 0])
        given = recorded.ATTRIBUTES | {"whirl": name, "mr_kg_m": unbalance, "speed_rpm": 1800.0}
        given = {"sample_rate_hz": recorded.RATE, "speed_rpm": 1800.0} if measured else given
        paths.append(recorded.write_hdf5(folder / f"{name}.h5", channels, given))
    (folder / "rig.toml").write_text(MEASURED, encoding="utf-8")
    return paths


@pytest.mark.filterwarnings("ignore::rotorfit.DataWarning")
@pytest.mark.parametrize("measured", [False, True])
def test_responses_of_a_recording_have_the_speed_at_their_own_moment(tmp_path: Path, measured: bool) -> None:
    """A wander of 1 % in eight seconds: with the mean speed lam is 0.23 % off and redchi 45."""
    paths = recorded_sweeps(tmp_path, 0.01, measured=measured)
    setup = tmp_path / "rig.toml" if measured else None
    # A rotor without unbalance moves once per turn by the backward sweep alone: as probes exchanged.
    test = rf.responses([rf.read_recording(path, setup) for path in paths])
    assert 0.005 < np.std(test.speed) / np.mean(test.speed) < 0.02
    fit = plain_fit(rf.models.OneMode(planes=("disk",)), test, known=KNOWN)
    steady = plain_fit(rf.models.OneMode(planes=("disk",)), replace(test, speed=test.set_speed), known=KNOWN)
    assert fit.params["lam"].value == pytest.approx(LAM, rel=1e-3)
    assert steady.redchi > 10 * fit.redchi


def test_combination_lines_have_the_speed_at_their_own_moment(tmp_path: Path) -> None:
    """A wander of 0.5 %: with the mean speed redchi is 7 and the uneven stiffness 4 errors off."""
    test = rf.shaft_lines([rf.read_recording(path) for path in recorded_sweeps(tmp_path, 0.005, turning=900.0)])
    twist = {"ec": 0.0, "es": 0.0, "Px": 0.0, "Py": 0.0, "J": 0.01, "nu_t": 5000.0, "zeta_t": 0.01}
    fit = plain_fit(rf.models.AnisotropicShaft(planes=("disk",)), test, known=twist)
    assert fit.redchi < 2
    for name, value in {"M": MASS, "D": DAMPING, "K": STIFFNESS, "dK_cos": 900.0, "dK_sin": 0.0}.items():
        assert abs(fit.params[name].value - value) < 4 * fit.params[name].stderr, name


def test_simulated_rotors_turn_at_the_speed_that_their_marks_show(tmp_path: Path) -> None:
    """Volts of the virtual rig at a speed that wanders by a percent: the fit finds the rotor within its errors."""
    values = {"M": 1.2, "K": 3e4, "Ds": 8.0, "K0": 1e4, "D": 400.0, "lam": 0.45, "Mf": 0.3}
    paths = rf.simulate_recordings(
        rf.models.OneMode(),
        values,
        tmp_path,
        speed_rpm=1500.0,
        duration=8.0,
        instruments=rf.Instruments(sample_rate=2048.0, wander=0.01),
        seed=2,
    )
    test = rf.responses([rf.read_recording(path) for path in paths])
    assert np.ptp(test.speed) > 0.01 * 1500.0 * RPM
    fit = plain_fit(rf.models.OneMode(), test, known={name: values[name] for name in ("K", "Ds", "M")})
    assert fit.redchi < 1.3
    for name in ("K0", "D", "lam", "Mf"):
        parameter = fit.params[name]
        assert abs(parameter.value - values[name]) < 4 * parameter.stderr, name


@pytest.mark.parametrize("kind", ["hammer", "measured-force"])
def test_a_shaft_at_rest_is_recorded(tmp_path: Path, kind: str) -> None:
    """At speed zero there is no wander, and nothing to divide by."""
    values = {"M": 1.2, "K": 3e4, "Ds": 8.0, "K0": 1e4, "D": 100.0, "lam": 0.45, "Mf": 0.3}
    short = {"blows": 1} if kind == "hammer" else {"duration": 2.0}
    assert rf.simulate_recordings(rf.models.OneMode(), values, tmp_path, kind, speed_rpm=0.0, **short)
