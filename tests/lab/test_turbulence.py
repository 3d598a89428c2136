"""Process noise of the virtual rig against theory: Lyapunov's equation, spectra of force and motion, the whirl."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov
from sentences import refuses
from synthetic import TYPICAL

import rotorfit as rf

MODEL, VALUES = rf.models.WhirlWhip(), TYPICAL["whirl-whip"]
SPEED = 120.0
FLOW = rf.Turbulence(level={"disk": 0.02, "journal": 0.05}, correlation=0.3)
SHARED = np.array([[0.02**2, 0.3 * 0.02 * 0.05], [0.3 * 0.02 * 0.05, 0.05**2]])
"""Two-sided spectrum of FLOW at all frequencies, N^2/Hz."""
QUIET = rf.Instruments(noise=0.0, runout=(), bits=32, sample_rate=1000.0, wander=0.0)


def recorded(folder: Path, model: Any = MODEL, values: Any = VALUES, **options: Any) -> np.ndarray:
    """Motion of all planes, ``(T, n)``, of one run by exact instruments."""
    given = {"duration": 60.0, "turbulence": FLOW, "instruments": QUIET, "residual": 0.0, "speed": SPEED} | options
    (file,) = rf.simulate_recordings(model, values, folder, "operating", **given)
    record = rf.read_recording(file)
    return np.column_stack([record.motion(plane) for plane in model.planes])


def test_motion_is_that_of_a_linear_rotor_under_white_noise(tmp_path: Path) -> None:
    """Covariance at every lag is ``C exp(A tau) P C'``, P by Lyapunov's equation: damped frequencies, decrements and
    size at once. The two-sided spectrum is ``H S H'``."""
    z = recorded(tmp_path, duration=100.0)
    n, rate = 2, QUIET.sample_rate
    stiffness, damping, mass = MODEL.coefficients(MODEL.vector(VALUES), SPEED)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)]])
    b = np.vstack([np.zeros((n, n)), np.linalg.inv(mass)])
    covariance = solve_continuous_lyapunov(a, -b @ SHARED @ b.conj().T)
    size = np.sqrt(np.diag(covariance).real[:n])
    for lag in range(0, 100, 10):
        expected = (expm(a * lag / rate) @ covariance)[:n, :n]
        found = z[lag:].T @ z[: len(z) - lag].conj() / (len(z) - lag)
        # chance: the root of two over decay rate times time
        assert np.abs((found - expected) / np.outer(size, size)).max() < 0.12, lag
    f = np.fft.fftfreq(len(z), 1 / rate)
    hann, band = np.hanning(len(z)), (f >= -100) & (f < 100)
    lines = np.fft.fft(z * hann[:, None], axis=0)[band] / np.sqrt(rate * np.sum(hann**2))
    h = MODEL.receptance(MODEL.vector(VALUES), 2 * np.pi * f[band], SPEED)
    spectrum = h @ SHARED @ np.conj(np.swapaxes(h, -1, -2))
    ratio = np.einsum("fi,fi->f", lines.conj(), np.linalg.solve(spectrum, lines[..., None])[..., 0]).real / n
    bands = ratio.reshape(20, -1).mean(axis=1)  # of 10 Hz: 1000 lines of two planes, half of them independent
    assert np.abs(bands - 1).max() < 0.15
    assert ratio.mean() == pytest.approx(1, abs=0.02)


def test_the_same_seed_gives_the_same_recording(tmp_path: Path) -> None:
    short: dict[str, Any] = {"duration": 1.0}
    one, same = recorded(tmp_path, seed=3, **short), recorded(tmp_path, rng=3, **short)
    assert (one == same).all()
    assert not (one == recorded(tmp_path, seed=4, **short)).all()


def test_spectra_of_coloured_forces() -> None:
    """The force of a time function against the formula in its docstring, by periodograms in octaves."""
    flow = rf.Turbulence(level={"a": 2.0, "b": 1.0}, exponent={"a": 1.0}, low_pass_hz=80.0, forward=2.5)
    rate, count = 1000.0, 200_000
    t = np.arange(count) / rate
    force = flow.force(("a", "b"), count, rate, np.random.default_rng(1))(t)
    f, power = np.fft.fftfreq(count, 1 / rate), np.abs(np.fft.fft(force, axis=0)) ** 2 / (rate * count)
    power *= np.sinc(f / rate)[:, None] ** 4  # straight between samples
    size, steep = np.array([4.0, 1.0]), np.array([1.0, 0.0])
    for low in (2.0, 8.0, 30.0, 100.0):
        for sign, turned in ((1, np.sqrt(2.5)), (-1, 1 / np.sqrt(2.5))):
            inside = (sign * f > low) & (sign * f < 2 * low)
            w = np.abs(f[inside])[:, None]
            expected = size * (w / 10.0) ** -steep * turned / (1 + (w / 80.0) ** 2)
            assert np.mean(power[inside] / expected, axis=0) == pytest.approx([1, 1], abs=0.2)


def test_forces_stronger_along_x_and_correlated() -> None:
    flow = rf.Turbulence(level=1.0, x_over_y=3.0, correlation=-0.5)
    t = np.arange(100_000) / 1000.0
    force = flow.force(("a", "b"), t.size, 1000.0, np.random.default_rng(2))(t)
    assert np.std(force.real) / np.std(force.imag) == pytest.approx(3.0, rel=0.02)
    assert np.corrcoef(force.real.T)[0, 1] == pytest.approx(-0.5, abs=0.02)


def test_a_nonlinear_rotor_moves_as_a_linear_one_while_it_moves_little(tmp_path: Path) -> None:
    law = rf.models.WhirlWhip(law=rf.models.Muszynska(), clearance_um=2e5)
    shape = {"n_K": 2.0, "n_D": 1.4, "b": 1.0}
    weak: dict[str, Any] = {"turbulence": 1e-3, "duration": 2.0}
    exact = recorded(tmp_path, **weak)
    z = recorded(tmp_path, law, VALUES | shape, **weak)
    assert np.abs(z - exact).max() < 1e-3 * np.abs(exact).max()


def test_beyond_the_threshold_the_law_limits_the_whirl(tmp_path: Path) -> None:
    """Against the branch of ``kappa(w, Om, eps) = 0``; a linear rotor is refused there."""
    rotor = rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=200.0)
    values = {"M": 1.2, "K": 2e3, "Ds": 8.0, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}
    shape = {"n_K": 2.0, "n_D": 1.4, "b": 0.5}
    onset = rf.models.threshold_speed(rotor, rotor.vector(values | shape))
    assert onset is not None
    speed = 1.1 * onset.speed
    z = recorded(tmp_path, rotor, values | shape, speed=speed, duration=2.0, turbulence=1e-3)[:, 0]
    branch = rf.models.whirl_branch(rotor, rotor.vector(values | shape), max_speed=1.2 * onset.speed)
    radius = 200e-6 * np.interp(speed, branch.speed, branch.eccentricity)
    assert np.abs(z).mean() == pytest.approx(radius, rel=0.01)
    with refuses(ValueError):
        recorded(tmp_path, rf.models.OneMode(), values, speed=speed)


@pytest.mark.parametrize(
    "given",
    [{"level": {"seal": 1.0}}, {"level": -1.0}, {"level": 1.0, "forward": 0.0}, {"level": 1.0, "correlation": 2.0}],
)
def test_turbulence_that_cannot_be_is_refused(given: dict[str, Any]) -> None:
    with refuses(ValueError):
        rf.Turbulence(**given).force(("disk", "journal"), 10, 1e3, np.random.default_rng(0))
    with pytest.raises(ValueError, match="3 planes cannot all be correlated"):
        rf.Turbulence(level=1.0, correlation=-0.9).force(("a", "b", "c"), 10, 1e3, np.random.default_rng(0))


def test_the_bundled_recording_is_made_as_its_truth_says(tmp_path: Path) -> None:
    truth = rf.datasets.truth("operation")
    (made,) = eval(truth["made_with"], {"rf": rf, "params": truth["params"], "folder": tmp_path})
    new, old = rf.read_recording(made), rf.read_recording(rf.datasets.operation())
    assert new.name != old.name
    for plane in ("disk", "journal"):
        # a step of the recorder: other processors round otherwise
        assert np.abs(new.motion(plane) - old.motion(plane)).max() < 2 * 20.0 / 2**11 / 7870.0
