"""Hammer tests as laboratories save them: one blow a file, several files, several blows in one."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from sentences import refuses
from swept import two_modes

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.lab.recordings.reduction.measured_responses import look_at_force

RATE, TURNS = 2048.0, 25.0  # Hz
LENGTH = 4e-3  # of a blow, s


def blow_at(begins: list[float], sizes: list[float]):
    """Squared sines along x, N."""

    def force(t: np.ndarray) -> np.ndarray:
        total = np.zeros(np.shape(t), complex)
        for begin, size in zip(begins, sizes, strict=True):
            phase = np.clip((t - begin) / LENGTH, 0.0, 1.0)
            total += size * np.sin(np.pi * phase) ** 2
        return total

    return force


def strike(
    path: Path, begins: list[float], *, seconds: float = 1.5, seed: int = 0, sizes: list[float] | None = None,
    range_of_force: float = np.inf, rate: float = RATE,
) -> Path:  # fmt: skip
    """Volts of two planes, a hammer and a Keyphasor: run-out of 5 um, noise of 0.2 um and of 0.01 N."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate)) / rate
    force = blow_at(begins, sizes or [float(rng.uniform(10, 25)) for _ in begins])
    z = two_modes().motion(force, rate, t.size) + 5e-6 * np.exp(1j * (2 * np.pi * TURNS * t + 0.4))
    with h5py.File(path, "w") as file:
        file.attrs.update(sample_rate_hz=rate, speed_rpm=60 * TURNS, sensitivity_V_per_mm=8.0)
        file.attrs.update(probe_angle_deg_X=0.0, probe_angle_deg_Y=90.0)
        for plane, motion in zip(("disk", "journal"), z, strict=True):
            for axis, along in (("X", motion.real), ("Y", motion.imag)):
                file[f"{plane}_{axis}"] = -10 + 8e3 * (along + 2e-7 * rng.normal(size=t.size))
        measured = np.minimum(force(t).real, range_of_force) + 0.01 * rng.normal(size=t.size) * np.isinf(range_of_force)
        file["hammer"] = 0.1 * measured
        file["keyphasor_shaft"] = np.where((TURNS * t + 0.3) % 1 < 0.1, -15.0, -5.0)
    return path


@pytest.fixture
def setup(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text('[force]\nplane = "disk"\nchannel_x = "hammer"\nsensitivity_V_per_N = 0.1\n')
    return path


def exact(test: rf.PerturbationTest) -> np.ndarray:
    """x and y of each plane over a force along x, from both directions of whirl."""
    forward = two_modes().receptance(test.frequency)
    backward = two_modes().receptance(-test.frequency).conj()
    plane, row = (test.plane == "journal").astype(int), np.arange(len(test))
    along_x, along_y = (forward + backward) / 2, (forward - backward) / 2j
    return np.where(test.direction == "x", along_x[plane, row], along_y[plane, row])


def found_by(test: rf.PerturbationTest) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the responses over their standard deviations, and over the size of the responses there."""
    error = test.response / test.force - exact(test)
    return np.abs(error) / np.abs(test.sigma / test.force) / np.sqrt(2), np.abs(error) / np.abs(exact(test))


def honest(tests: list[rf.PerturbationTest]) -> None:
    """In each band the errors are those stated, and where the rotor responds they are near 1 %."""
    hertz = np.concatenate([test.frequency for test in tests]) / (2 * np.pi)
    over_sigma, over_size = (np.concatenate(parts) for parts in zip(*map(found_by, tests), strict=True))
    strong = np.concatenate([(test.direction == "x") for test in tests])
    for low, high in ((5, 20), (20, 50), (50, 120)):
        band = (hertz >= low) & (hertz < high)
        assert 0.6 < np.sqrt(np.mean(over_sigma[band] ** 2)) < 1.3, (low, high)
        assert np.median(over_size[band & strong]) < (0.01 if high <= 50 else 0.05), (low, high)


def test_one_blow_a_file(tmp_path: Path, setup: Path) -> None:
    """A transient as smooth as the response to one blow took its place: errors of 100 %."""
    records = [rf.read_recording(strike(tmp_path / f"{k}.h5", [0.3], seed=k), setup) for k in range(4)]
    together = rf.responses(records)
    found = together.findings
    assert {finding.code for finding in found} <= {"coherence", "lines-at-orders"}
    assert len(together.runs) == 4
    strong = (together.direction == "x") & (together.frequency < 2 * np.pi * 50)
    assert together.attributes["coherence"][strong].min() > 0.99
    honest([together])


@pytest.mark.slow
def test_several_blows_in_a_file(tmp_path: Path, setup: Path) -> None:
    files = [strike(tmp_path / f"{k}.h5", [0.3, 1.5, 2.7], seconds=4.0, seed=k) for k in range(2)]
    honest([rf.responses(rf.read_recording(file, setup)) for file in files])


def test_a_short_file_knows_the_noise_of_its_force(tmp_path: Path, setup: Path) -> None:
    """Below 1 s the noise was taken for none, and its band for that of the force."""
    record = rf.read_recording(strike(tmp_path / "a.h5", [0.25], seconds=0.8), setup)
    assert look_at_force(record, struck=True).noise_x == pytest.approx(0.01**2 / RATE, rel=0.5)


def codes(path: Path, setup: Path) -> set[str]:
    found = rf.responses(rf.read_recording(path, setup)).findings
    return {finding.code for finding in found}


@pytest.mark.filterwarnings("ignore::rotorfit.DataWarning")
def test_double_hits_and_overloads_are_found(tmp_path: Path, setup: Path) -> None:
    double = strike(tmp_path / "double.h5", [0.3, 0.315], sizes=[20.0, 6.0])
    assert "double-hit" in codes(double, setup)
    honest([rf.responses(rf.read_recording(double, setup))])
    for size in (1.05, 2.0):  # of the range
        cut = strike(tmp_path / "cut.h5", [0.3], sizes=[15.0 * size], range_of_force=15.0, rate=4 * RATE)
        assert "force-clipped" in codes(cut, setup)


def test_a_file_that_cuts_the_blow_off_is_wide_or_refused(tmp_path: Path, setup: Path) -> None:
    ends = strike(tmp_path / "ends.h5", [0.3], seconds=0.44)
    assert "moving-at-ends" in codes(ends, setup)
    over_sigma, _ = found_by(rf.responses(rf.read_recording(ends, setup)))
    assert np.sqrt(np.mean(over_sigma**2)) < 1.3
    with refuses(ValueError):
        codes(strike(tmp_path / "early.h5", [0.005]), setup)


def test_from_the_command_line(tmp_path: Path, setup: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = [strike(tmp_path / f"{k}.h5", [0.3], seed=k) for k in range(2)]
    out = tmp_path / "vectors.csv"
    assert main(["vectors", *map(str, good), "--setup", str(setup), "--out", str(out)]) == 0
    assert "coherence" in capsys.readouterr().out
    assert "coherence" in out.read_text().splitlines()[0] + out.read_text().splitlines()[1]
    cut = strike(tmp_path / "cut.h5", [0.3], sizes=[20.0], range_of_force=15.0, rate=4 * RATE)
    assert main(["vectors", str(cut), "--setup", str(setup), "--out", str(tmp_path / "cut.csv")]) == 1


def test_a_rotor_at_rest_has_quiet_probes_across_the_blow(tmp_path: Path) -> None:
    """They carry noise alone, a few thousandths of the motion along the blow, and are not dead."""
    rng, t = np.random.default_rng(4), np.arange(int(1.5 * RATE)) / RATE
    force = blow_at([0.3], [20.0])
    motion = two_modes(speed=0.0).motion(force, RATE, t.size).real
    path = tmp_path / "rest.h5"
    with h5py.File(path, "w") as file:
        file.attrs.update(sample_rate_hz=RATE, speed_rpm=0.0, sensitivity_V_per_mm=8.0)
        file.attrs.update(probe_angle_deg_X=0.0, probe_angle_deg_Y=90.0)
        for plane, along in zip(("disk", "journal"), motion, strict=True):
            for axis, values in (("X", along), ("Y", 0.0)):
                file[f"{plane}_{axis}"] = -10 + 8e3 * (values + 2e-7 * rng.normal(size=t.size))
        file["hammer"] = 0.1 * (force(t).real + 0.01 * rng.normal(size=t.size))
    (tmp_path / "rig.toml").write_text('[force]\nplane = "disk"\nchannel_x = "hammer"\nsensitivity_V_per_N = 0.1\n')
    test = rf.responses(rf.read_recording(path, tmp_path / "rig.toml"))
    found = test.findings
    assert not [finding for finding in found if finding.severity == "error"]
    across = test.direction == "y"
    assert across.any()
    assert np.mean(np.abs(test.response[across] / test.sigma[across]) ** 2) / 2 == pytest.approx(1.0, abs=0.3)
