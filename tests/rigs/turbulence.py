"""Motion of a linear rotor that turbulence shakes, exact at every sample, and the tests made of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from recorded import notch, write_hdf5
from scipy.linalg import expm, solve_sylvester
from scipy.signal import lfilter

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.units import RAD_S_PER_RPM as RPM
from rotorfit.estimators.signals.cells import averaged
from rotorfit.lab.data.synchronous import join
from rotorfit.lab.kinds.operating_test import OperatingTest, operating_test
from rotorfit.models import OneMode, RotorModel

ONE_MODE = {"M": 1.0, "K": 7000.0, "Ds": 5.0, "K0": 3000.0, "D": 400.0, "lam": 0.40, "Mf": 0.2}


def shaken(
    model: RotorModel, values: Mapping[str, float], speed: float, *, rate: float, size: int, force: float, seed: int
) -> ComplexArray:
    """Motion ``x + jy`` of all planes, shape ``(n, N)``, under white force of independent planes, N^2/Hz: a Markov
    chain with the propagator and the covariance of the continuous equations."""
    K, C, M = model.coefficients(model.vector(values), speed)[:3]
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    B = np.concatenate([np.zeros((n, n)), np.linalg.inv(M)])
    intensity = force * B @ B.conj().T
    steady = solve_sylvester(A, A.conj().T, -intensity)
    step = expm(A / rate)
    added = steady - step @ steady @ step.conj().T
    rng = np.random.default_rng(seed)

    def drawn(covariance: ComplexArray, count: int) -> ComplexArray:
        power, basis = np.linalg.eigh(covariance)
        normal = rng.normal(size=(2, 2 * n, count)) / np.sqrt(2)
        return (basis * np.sqrt(np.maximum(power, 0))) @ (normal[0] + 1j * normal[1])

    poles, shapes = np.linalg.eig(step)
    noise = np.linalg.solve(shapes, drawn(added, size))
    noise[:, 0] = np.linalg.solve(shapes, drawn(steady, 1))[:, 0]
    modes = np.array([lfilter([1.0], [1.0, -pole], own) for pole, own in zip(poles, noise, strict=True)])
    return shapes[:n] @ modes


def recorded(
    model: RotorModel,
    values: Mapping[str, float],
    speeds: Float,
    *,
    minutes: float,
    seed: int,
    rate: float = 200.0,
    force: float = 1e-2,
    floor: float = 30.0,
    top: float = 45.0,
    width: float = 0.2,
    taller: float = 1.0,
    planes: tuple[str, ...] | None = None,
) -> OperatingTest:
    """The test of recordings at some speeds, rad/s, with a white floor so many dB under the highest peak; ``taller``:
    gain of the y probes over that of the x probes."""
    tests = []
    for number, speed in enumerate(speeds):
        size = int(60 * minutes * rate)
        z = shaken(model, values, speed, rate=rate, size=size, force=force, seed=seed + 1000 * number)
        rng = np.random.default_rng([7, seed, number])  # not the draws of the force
        clean = averaged(z, rate, band=(1.0, top), width=1.0)
        level = np.einsum("cii->ci", clean.power).real.max(axis=0).reshape(2, -1).max(axis=0) / 10 ** (floor / 10)
        noise = rng.normal(size=(2, *z.shape)) * np.sqrt(level * rate / 2)[:, None]
        cells = averaged(z.real + noise[0] + 1j * taller * (z.imag + noise[1]), rate, band=(1.0, top), width=width)
        tests.append(operating_test(f"run {number + 1}", speed, model.planes, cells, {}, ""))
    test = join(tests)
    return test if planes is None else test.select(np.isin(test.plane, planes) & np.isin(test.other_plane, planes))


def written(
    path: Path,
    *,
    minutes: float,
    hum: float = 0.0,
    probes: str = "XY",
    acceleration: float = 0.0,
    force: float = 1e-2,
    mark: bool = True,
    steady: float = 0.0,
) -> Path:
    """A recording of the one-mode rotor at 200 rad/s: x and y, a notch, orders of the shaft and hum of the mains;
    ``steady``: radius of a whirl that keeps its orbit."""
    rate = 400.0
    size = int(60 * minutes * rate)
    t = np.arange(size) / rate
    angle = 200.0 * t + acceleration * t**2 / 2
    z = shaken(OneMode(), ONE_MODE, 200.0, rate=rate, size=size, force=force, seed=5)[0]
    z = z + 40e-6 * np.exp(1j * angle) + 10e-6 * np.exp(-2j * angle) + 5e-6 * np.cos(2 * np.pi * hum * t) * (hum > 0)
    z = z + steady * np.exp(2j * np.pi * 13.1 * t)
    rng = np.random.default_rng(6)
    parts = {"X": z.real, "Y": z.imag}
    volts = {f"journal_{axis}": -10.0 + 7870.0 * parts[axis] + 2e-3 * rng.normal(size=size) for axis in probes}
    attributes = {
        "sample_rate_hz": rate, "speed_rpm": 200.0 / RPM, "sensitivity_V_per_mm": 7.87, "probe_angle_deg_X": 0.0,
        "probe_angle_deg_Y": 90.0, "keyphasor": "falling edge of a notch, -2 V to -8 V",
    }  # fmt: skip
    return write_hdf5(path, volts | ({"keyphasor_shaft": notch(angle, 0.2)} if mark else {}), attributes)
