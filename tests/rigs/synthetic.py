"""Synthetic tests for tests: typical rigs, and responses that are made from a model and noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

import rotorfit as rf
from rotorfit import models
from rotorfit.models import RotorModel
from rotorfit.models.motion.stability import eigenvalues, growth_rate

TYPICAL: dict[str, dict[str, float]] = {
    "one-mode": {"M": 1.2, "K": 8000.0, "Ds": 8.0, "K0": 9000.0, "D": 450.0, "lam": 0.46, "Mf": 0.4},
    "whirl-whip": {
        "Md": 0.95,
        "Ds": 3.0,
        "K1": 14000.0,
        "K2": 15000.0,
        "sigma": 0.95,
        "Mb": 0.3,
        "K3": 6000.0,
        "K0": 10000.0,
        "D": 450.0,
        "lam": 0.475,
        "Mf": 0.35,
    },
    "two-disk": {
        "M1": 0.73,
        "M2": 0.79,
        "K1": 18900.0,
        "K2": 63700.0,
        "K3": 22600.0,
        "D11": 14.2,
        "D12": 7.0,
        "D21": 7.0,
        "D22": 14.8,
        "beta1": 1.0,
        "beta2": 1.0,
    },
    "overhung": {
        "M": 8.0,
        "It": 0.06,
        "Ip": 0.11,
        "k11": 4.0e5,
        "k12": -5.0e4,
        "k22": 2.0e4,
        "d1": 60.0,
        "d2": 0.6,
    },
    "anisotropic": {
        "Kxx": 1.8e4,
        "Kxy": 3.0e3,
        "Kyx": -2.0e3,
        "Kyy": 2.4e4,
        "Dxx": 60.0,
        "Dxy": 5.0,
        "Dyx": -4.0,
        "Dyy": 75.0,
        "Mxx": 1.1,
        "Mxy": 0.05,
        "Myx": 0.04,
        "Myy": 1.2,
    },
}
"""A typical rig for each model, SI units."""

KNOWN: dict[str, tuple[str, ...]] = {
    "one-mode": ("K", "Ds"),
    "whirl-whip": ("K3",),
    "two-disk": ("beta1", "beta2"),
    "overhung": (),
    "anisotropic": (),
}
"""Parameters that the tests of one rig cannot give."""

SPEEDS: dict[str, tuple[float, ...]] = {
    "one-mode": (100.0, 180.0),
    "whirl-whip": (100.0, 200.0),
    "two-disk": (0.0,),
    "overhung": (150.0, 400.0),
    "anisotropic": (0.0,),
}
"""Tested rotative speeds, rad/s."""

MODELS: dict[str, type[RotorModel]] = {name: models.MODELS[name] for name in TYPICAL}


def known_of(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """The values that a fit of this rig must be told."""
    return {key: values[key] for key in KNOWN[name]}


def covering_frequencies(
    model: RotorModel, theta: NDArray[np.float64], speeds: Sequence[float], lines: int
) -> NDArray[np.float64]:
    """Signed frequencies, half of the lines on either side, over all modes of the rig."""
    s = np.concatenate([eigenvalues(model, theta, speed) for speed in speeds])
    s = s[np.isfinite(s)]
    oscillating = np.abs(s.imag) > 1e-6 * np.abs(s)
    top = 1.5 * float(np.abs(s[oscillating].imag if oscillating.any() else s).max())
    half = np.linspace(top / (lines // 2), top, lines // 2)
    return np.concatenate([-half[::-1], half])


def circular_test(
    model: RotorModel,
    theta: NDArray[np.float64],
    *,
    speeds: Sequence[float],
    frequency: NDArray[np.float64],
    noise: float = 0.0,
    seed: int = 0,
    force_planes: Sequence[str] | None = None,
    force: complex = 5.0 * np.exp(0.4j),
    sigma_known: bool = False,
) -> rf.PerturbationTest:
    """Circular-force sweeps at every force plane, read in x and y at every coordinate of the model.

    Args:
        noise: standard deviation of the real and of the imaginary part of each directional response, as a fraction of
            the rms response of its forward and backward sweep.
        sigma_known: whether the noise level is told to the reader of the data.
    """
    rng = np.random.default_rng(seed)
    columns: dict[str, list[NDArray[np.generic]]] = {}
    for plane in force_planes or model.planes:
        for speed in speeds:
            vector = model.force_vector(plane, frequency, np.full(frequency.size, force))
            exact = np.einsum("lij,lj->li", model.receptance(theta, frequency, np.full(frequency.size, speed)), vector)
            exact = exact * model.functions.factors(theta)
            levels = noise * np.sqrt(np.mean(np.abs(exact) ** 2, axis=0))
            for sign in (-1, 1):
                side = np.sign(frequency) == sign
                w, response = frequency[side], exact[side]
                for number, coordinate in enumerate(model.coordinates):
                    level = float(levels[number])
                    for direction, value, spread in _probes(coordinate.axis, response[:, number], sign, level):
                        error = rng.normal(size=w.size) + 1j * rng.normal(size=w.size)
                        row = {
                            "run": f"{plane} {speed:g} {sign:+d}",
                            "speed": speed,
                            "frequency": w,
                            "force_plane": plane,
                            "force": force,
                            "plane": coordinate.plane,
                            "direction": direction,
                            "response": value + spread * error,
                            "sigma": spread if sigma_known else np.nan,
                        }
                        for key, cell in row.items():
                            columns.setdefault(key, []).append(np.broadcast_to(np.asarray(cell), w.shape))
    return rf.perturbation_test(**{key: np.concatenate(parts) for key, parts in columns.items()}, source="synthetic")


def _probes(
    axis: str, amplitude: NDArray[np.complex128], sign: int, level: float
) -> list[tuple[str, NDArray[np.complex128], float]]:
    """Readings of the x and y probes of a circular orbit, and the noise of each that leaves ``level`` on the orbit."""
    if axis in "xy":
        return [(axis, amplitude, level)]
    prefix = "r" if axis == "r" else ""
    x = amplitude if sign > 0 else amplitude.conj()
    y = -1j * x if sign > 0 else 1j * x
    return [(prefix + "x", x, np.sqrt(2) * level), (prefix + "y", y, np.sqrt(2) * level)]


def random_stable_rigs(name: str, count: int, seed: int) -> list[dict[str, float]]:
    """Parameter sets log-uniform over a decade around the typical rig, stable at every tested speed."""
    rng = np.random.default_rng(seed)
    model = MODELS[name]()
    rigs: list[dict[str, float]] = []
    while len(rigs) < count:
        values = {
            key: value if key in ("beta1", "beta2") else value * 10 ** rng.uniform(-0.5, 0.5)
            for key, value in TYPICAL[name].items()
        }
        theta = model.vector(values)
        static = model.dynamic_stiffness(theta, 0.0, 0.0)
        if np.linalg.eigvals(static).real.min() <= 0:  # a shaft that buckles is no rotor
            continue
        if max(float(growth_rate(model, theta, speed)) for speed in SPEEDS[name]) < 0:
            rigs.append(values)
    return rigs


def overhung_without_slopes(truth: dict[str, float], seed: int) -> rf.PerturbationTest:
    """Sweeps of an overhung rotor whose slopes nobody read."""
    model, speeds = MODELS["overhung"](), SPEEDS["overhung"]
    theta = model.vector(truth)
    frequency = covering_frequencies(model, theta, speeds, 60)
    test = circular_test(model, theta, speeds=speeds, frequency=frequency, noise=0.01, seed=seed)
    return test.select(~np.char.startswith(test.direction, "r"))
