"""Accelerometers, sensors of velocity and load cells in recordings: responses are those of displacement probes."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from recorded import ATTRIBUTES, RATE, perturbator_angle, shaft_angle, volts, write_hdf5
from scipy.signal import lsim

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.lab.data.experiments import MEASURED, PerturbationTest
from rotorfit.lab.recordings.rig.template import template

SECONDS = 4.0
G = 9.80665
TOLD = {name: value for name, value in ATTRIBUTES.items() if name != "sensitivity_V_per_mm"}


def moved(order: int) -> np.ndarray:
    """The motion of ``recorded``, differentiated so often, SI units."""
    t = np.arange(round(SECONDS * RATE)) / RATE
    shaft = 30e-6 * np.exp(1j * (shaft_angle(t) + 0.5))
    driven = 50e-6 * np.exp(1j * (perturbator_angle(t) - 0.3))
    w, a = 2 * np.pi * (5 + 10 * t), 20 * np.pi
    factors = [(1.0, 1.0), (40j * np.pi, 1j * w), (-((40 * np.pi) ** 2), 1j * a - w**2)][order]
    return np.asarray(factors[0] * shaft + factors[1] * driven)


def recorded(path: Path, order: int, per_unit: float, unit: str = "") -> Path:
    z, rng = moved(order), np.random.default_rng(6)
    marks = {name: values for name, values in volts(SECONDS).items() if "keyphasor" in name}
    noise = 1e-4 * np.abs(z).std() * rng.normal(size=(2, z.size))
    with h5py.File(path, "w") as file:
        file.attrs.update(TOLD)
        for name, values in {"disk_X": z.real + noise[0], "disk_Y": z.imag + noise[1], **marks}.items():
            file[name] = values * (per_unit if "disk" in name else 1.0)
            if unit and "disk" in name:
                file[name].attrs["unit"] = unit
    return path


def setup(folder: Path, line: str) -> Path:
    probes = [
        f'[[probe]]\nplane = "disk"\nchannel = "disk_{axis}"\nangle_deg = {angle}\n{line}\n'
        for axis, angle in (("X", 0), ("Y", 90))
    ]
    (folder / "rig.toml").write_text("\n".join(probes), encoding="utf-8")
    return folder / "rig.toml"


SENSORS = [
    (1, "sensitivity_mV_per_mm_s = 4.0", 4.0, ""),
    (1, "sensitivity_V_per_m_s = 4.0", 4.0, ""),
    (1, "sensitivity_mV_per_in_s = 100.0", 0.1 / 0.0254, ""),
    (2, "sensitivity_mV_per_g = 100.0", 0.1 / G, ""),
    (2, "sensitivity_V_per_m_s2 = 0.05", 0.05, ""),
    (2, "sensitivity_mV_per_g = -100.0", -0.1 / G, ""),
    (1, "", 1e3, "mm/s"),
    (2, "", 1 / G, "g"),
    (2, 'unit = "m/s2"', 1.0, ""),
]


@pytest.mark.parametrize(("order", "line", "per_unit", "unit"), SENSORS)
def test_responses_do_not_depend_on_the_sensor(
    tmp_path: Path, order: int, line: str, per_unit: float, unit: str
) -> None:
    probe = rf.read_recording(recorded(tmp_path / "um.h5", 0, 7870.0), setup(tmp_path, "sensitivity_V_per_mm = 7.87"))
    exact = rf.responses(probe)
    record = rf.read_recording(recorded(tmp_path / "a.h5", order, per_unit, unit), setup(tmp_path, line))
    assert not [finding for finding in record.findings if finding.severity != "note"]
    test = rf.responses(record)
    assert isinstance(test, PerturbationTest)
    assert set(test.attributes[MEASURED].tolist()) == {("displacement", "velocity", "acceleration")[order]}
    inner = (test.frequency > 50.0) & (test.frequency < 250.0)
    weight = 2e-5 * test.frequency**2
    true = 50e-6 * np.exp(-0.3j) / (weight * np.exp(1j * np.radians(40.0)))
    true = np.where(test.direction == "x", 1, -1j) * true
    away = np.abs(test.response / test.force - true)[inner]
    assert np.median(away / np.abs(true)[inner]) < 2e-3
    assert np.median(away / (test.sigma / np.abs(test.force))[inner]) < 4
    assert exact.planes == test.planes
    z = record.motion("disk")[3000:-3000]
    whole = moved(0)[3000:-3000]
    assert np.abs(z - whole).std() < 0.05 * np.abs(whole).std()


def test_turns_windows_too(tmp_path: Path) -> None:
    record = rf.read_recording(recorded(tmp_path / "a.h5", 2, 0.1 / G), setup(tmp_path, "sensitivity_mV_per_g = 100.0"))
    test = rf.responses(record, turns=8)
    inner = (test.frequency > 100.0) & (test.frequency < 250.0)
    size = np.abs(test.response[inner])
    np.testing.assert_allclose(size, 50e-6, rtol=0.1)


# ---- hammer ------------------------------------------------------------------------------------------------------

M, C, K = 12.0, 60.0, 4e5


def struck(path: Path, order: int, sensitivity: float, per_newton: float) -> Path:
    """A mass on a spring that a hammer strikes twice, at rest."""
    rate = 4096.0
    t = np.arange(int(8 * rate)) / rate
    force = sum(np.where(np.abs(t - at) < 2e-3, 800 * np.cos((t - at) * np.pi / 4e-3), 0.0) for at in (0.5, 4.0))
    fine = np.arange(4 * t.size) / (4 * rate)
    pulse = sum(np.where(np.abs(fine - at) < 2e-3, 800 * np.cos((fine - at) * np.pi / 4e-3), 0.0) for at in (0.5, 4.0))
    _, x, states = lsim(([[0, 1], [-K / M, -C / M]], [[0], [1 / M]], [[1, 0]], [[0]]), pulse, fine)
    motion = [x, states[:, 1], (pulse - C * states[:, 1] - K * x) / M][order][::4]
    rng = np.random.default_rng(8)
    with h5py.File(path, "w") as file:
        file.attrs.update(sample_rate_hz=rate, speed_rpm=0.0)
        file["hammer"] = per_newton * (force + 0.3 * rng.normal(size=t.size))
        file["acc_X"] = sensitivity * motion * 1.0 + 1e-4 * sensitivity * np.abs(motion).max() * rng.normal(size=t.size)
    return path


@pytest.mark.filterwarnings("ignore::rotorfit.DataWarning")
@pytest.mark.parametrize("order", [1, 2])
def test_a_hammer_and_an_accelerometer(tmp_path: Path, order: int) -> None:
    line = ("", "sensitivity_mV_per_mm_s = 20.0", "sensitivity_mV_per_g = 100.0")[order]
    path = struck(tmp_path / "a.h5", order, (0.0, 20.0, 0.1 / G)[order], 2.25e-3)
    (tmp_path / "rig.toml").write_text(
        '[force]\nplane = "p"\nchannel_x = "hammer"\nsensitivity_mV_per_N = 2.25\n'
        f'[[probe]]\nplane = "p"\nchannel = "acc_X"\nangle_deg = 0.0\n{line}\n',
        encoding="utf-8",
    )
    test = rf.responses(rf.read_recording(path, tmp_path / "rig.toml"))
    assert isinstance(test, PerturbationTest)
    w = test.frequency
    true = 1 / (K - M * w**2 + 1j * w * C)
    near = (w > 60) & (w < 600)
    assert near.sum() > 5
    away = np.abs(test.response / test.force - true)[near]
    assert np.median(away / np.abs(true)[near]) < 0.01
    assert np.median(away * np.abs(test.force)[near] / test.sigma[near]) < 4
    for command in ("look", "vectors"):
        out = tmp_path / (command if command == "look" else "v.csv")
        words = [command, str(path), "--setup", str(tmp_path / "rig.toml"), "--out", str(out)]
        assert main(words) == 0
    again = rf.read(tmp_path / "v.csv")
    np.testing.assert_allclose(again.response, test.response, rtol=1e-9)


# ---- refusals ----------------------------------------------------------------------------------------------------


def test_what_such_sensors_do_not_tell_is_refused(tmp_path: Path) -> None:
    path = setup(tmp_path, "sensitivity_mV_per_g = 100.0")
    record = rf.read_recording(recorded(tmp_path / "a.h5", 2, 0.1 / G), path)
    for call, what in ((rf.ring_downs, "free vibration"), (rf.static_positions, "a static position")):
        with pytest.raises(
            ValueError, match=f"disk_X, disk_Y read velocity or acceleration; {what} needs displacement"
        ):
            call(record)
    text = path.read_text(encoding="utf-8").replace("100.0\n", "100.0\nsensitivity_mV_per_um = 8.0\n", 1)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match="disk_X has sensitivities to 2 quantities; keep one"):
        rf.read_recording(tmp_path / "a.h5", path)
    path.write_text(text.replace("100.0\nsensitivity_mV_per_um = 8.0\n", "100.0\n").replace("mV_per_g", "V_per_mm", 1))
    with pytest.raises(ValueError, match="disk has sensors of different quantities"):
        rf.responses(rf.read_recording(tmp_path / "a.h5", path))


def test_the_template_offers_them(tmp_path: Path) -> None:
    write_hdf5(tmp_path / "a.h5", volts(SECONDS), {"sample_rate_hz": RATE})
    text = template(tmp_path / "a.h5")
    assert "_mV_per_g" in text
    assert "sensitivity_mV_per_N" in text
