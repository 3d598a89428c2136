"""Recordings of a shaft that is not round, read as if it were: that is said, with what reads them."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from plain import plain_fit
from scipy.integrate import solve_ivp
from slow_cases import slow_but

import rotorfit as rf

RATE, SPEED, SECONDS = 1600.0, 2 * np.pi * 22.0, 12.0
M, D, K = 1.2, 25.0, 4e4


def drive(t: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Angle and speed of a perturbator that sweeps from 4 to 50 Hz."""
    slope = 2 * np.pi * 46.0 / SECONDS
    return 2 * np.pi * 4.0 * np.asarray(t) + slope * np.asarray(t) ** 2 / 2, 2 * np.pi * 4.0 + slope * np.asarray(t)


def sweep(path: Path, unequal: float, whirl: int, noise: float = 2e-7) -> Path:
    """Volts of ``M z" + D z' + K z + dK exp(2j theta) conj(z) = f``, integrated in time, with 8 um of run-out."""

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        z, v = complex(state[0], state[1]), complex(state[2], state[3])
        angle, speed = drive(t)
        force = 2e-4 * speed**2 * np.exp(1j * whirl * angle)
        a = (force - D * v - K * z - unequal * K * np.exp(2j * SPEED * t) * np.conj(z)) / M
        return np.array([v.real, v.imag, a.real, a.imag])

    t = np.arange(int(SECONDS * RATE)) / RATE
    found = solve_ivp(rates, (0, t[-1]), np.zeros(4), t_eval=t, method="DOP853", rtol=1e-7, atol=1e-11).y
    z = found[0] + 1j * found[1] + 8e-6 * np.exp(1j * SPEED * t) + 2e-6 * np.exp(2j * SPEED * t)
    rng = np.random.default_rng(3)
    with h5py.File(path, "w") as file:
        file.attrs.update(
            sample_rate_hz=RATE, sensitivity_V_per_mm=8.0, probe_angle_deg_X=0.0, probe_angle_deg_Y=90.0,
            force_plane="disk", mr_kg_m=2e-4, heavy_spot_deg_ahead_of_mark=0.0,
            whirl="forward" if whirl > 0 else "backward", keyphasor="falling",
        )  # fmt: skip
        for axis, along in (("X", z.real), ("Y", z.imag)):
            file[f"disk_{axis}"] = -10 + 8e3 * (along + noise * rng.normal(size=t.size))
        for name, angle in (("shaft", SPEED * t), ("perturbator", drive(t)[0])):
            part = np.mod(angle / (2 * np.pi) + 0.02, 1.0)
            file[f"keyphasor_{name}"] = np.interp(part, [0, 0.02, 0.06, 0.12, 0.16, 1], [-5, -10, -15, -15, -5, -5])
    return path


def codes(path: Path) -> tuple[rf.PerturbationTest, set[str]]:
    test = rf.responses(rf.read_recording(path))
    found = test.findings
    return test, {finding.code for finding in found}


@pytest.mark.parametrize("whirl", [1, -1])
def test_a_shaft_of_unequal_stiffness_is_seen(tmp_path: Path, whirl: int) -> None:
    test, found = codes(sweep(tmp_path / "a.h5", 0.03, whirl))
    assert ("shaft-lines" in found) == (whirl > 0)  # the image of a backward sweep is above the band
    fit = plain_fit(rf.models.AnisotropicShaft(), test)
    assert any("rf.shaft_lines" in warning for warning in fit.warnings)


@pytest.mark.parametrize(
    ("whirl", "noise"), slow_but([(whirl, noise) for whirl in (1, -1) for noise in (2e-7, 2e-8)], (1, 2e-7), (-1, 2e-8))
)
def test_a_round_shaft_is_not(tmp_path: Path, whirl: int, noise: float) -> None:
    assert "shaft-lines" not in codes(sweep(tmp_path / "a.h5", 0.0, whirl, noise))[1]
