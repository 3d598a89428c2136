"""Rigs of known parameters for the benchmarks, and the noise-free tests that they give."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.from_arrays import perturbation_test
from rotorfit.models import Anisotropic, Chain, OneMode, Overhung, RotorModel, TwoDisk, WhirlWhip
from rotorfit.models.motion.stability import eigenvalues

FORCE = 5.0
"""Rotating force of every run, N."""


@dataclass(frozen=True, eq=False)
class Rig:
    """A rotor of known parameters, tested at some speeds.

    Attributes:
        model: the rotor.
        truth: its parameters, SI units.
        known: those that the fit is told, because no test of one rig can separate them.
        speeds: tested rotative speeds, rad/s.
    """

    model: RotorModel
    truth: Mapping[str, float]
    speeds: tuple[float, ...]
    known: tuple[str, ...] = ()

    def sweep(self, lines: int) -> Float:
        """Signed frequencies, rad/s, half of the lines backward, up to 1.5 times the highest mode."""
        theta = self.model.vector(self.truth)
        modes = np.concatenate([eigenvalues(self.model, theta, speed) for speed in self.speeds])
        top = 1.5 * float(np.abs(modes.imag).max())
        half = np.linspace(0.0, top, lines // 2 + 1)[1:]
        return np.concatenate([-half[::-1], half])

    def test(self, lines: int, level: float, rng: np.random.Generator | None = None) -> PerturbationTest:
        """Circular forces at every plane and speed, read at every coordinate.

        Args:
            lines: signed frequencies in each sweep.
            level: noise of real and imaginary part over the channel's rms response; the fit is told.
            rng: source of the noise; without it the readings are exact.
        """
        w = self.sweep(lines)
        theta = self.model.vector(self.truth)
        parts: list[dict[str, NDArray[np.generic]]] = []
        for plane in self.model.planes:
            for speed in self.speeds:
                force = self.model.force_vector(plane, w, np.full(w.size, FORCE))
                exact = np.einsum("lij,lj->li", self.model.receptance(theta, w, speed), force)
                for coordinate, response in zip(self.model.coordinates, exact.T, strict=True):
                    sigma = level * float(np.sqrt(np.mean(np.abs(response) ** 2)))
                    noise = 0.0 if rng is None else sigma * _complex_normal(rng, w.size)
                    direction = "rz" if coordinate.axis == "r" else coordinate.axis
                    row = {
                        "run": f"force at {plane}, {speed:g} rad/s",
                        "speed": speed,
                        "frequency": w,
                        "force_plane": plane,
                        "force": complex(FORCE),
                        "plane": coordinate.plane,
                        "direction": direction,
                        "response": response + noise,
                        "sigma": sigma,
                    }
                    parts.append({key: np.broadcast_to(np.asarray(cell), w.shape) for key, cell in row.items()})
        columns: dict[str, Any] = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
        return perturbation_test(**columns, source=f"benchmark rig {self.model.name}")

    def problem(self, lines: int, level: float) -> Problem:
        """The fit of such a test, with exact readings."""
        settings = FitSettings(known={name: self.truth[name] for name in self.known})
        return build_problem(self.model, self.test(lines, level), settings)


def chain_rig(planes: int) -> Rig:
    """A uniform shaft as a chain of masses, on springs at both ends and lightly damped."""
    truth = {f"M{i + 1}": 1.0 + 0.02 * i for i in range(planes)}
    truth |= {f"K{i + 1}": 6.0e4 + 500.0 * i for i in range(planes + 1)}
    truth |= {f"Ds{i + 1}": 20.0 + 0.5 * i for i in range(planes)}
    return Rig(Chain(planes), truth, (0.0,))


def with_noise(problem: Problem, rng: np.random.Generator) -> Problem:
    """The same problem with other noise on its exact readings."""
    blocks = []
    for block in problem.blocks:
        if not isinstance(block, Responses):
            raise TypeError(f"noise is made for responses, not for {type(block).__name__}")
        noisy = block.measured + block.sigma * _complex_normal(rng, block.measured.size)
        blocks.append(replace(block, measured=noisy))
    return replace(problem, blocks=tuple(blocks))


def true_vector(problem: Problem, truth: Mapping[str, float]) -> Float:
    """Truth in the order of the fitted vector."""
    return np.array([truth[name] for name in problem.space.names])


def _complex_normal(rng: np.random.Generator, size: int) -> ComplexArray:
    return np.asarray(rng.normal(size=size) + 1j * rng.normal(size=size))


RIGS: dict[str, Rig] = {
    # A light journal in a fluid bearing; K, Ds and the fluid's K0, D cannot be told apart at one plane.
    "one-mode": Rig(
        OneMode(),
        {"M": 1.2, "K": 8000.0, "Ds": 8.0, "K0": 9000.0, "D": 450.0, "lam": 0.46, "Mf": 0.4},
        (100.0, 180.0),
        ("K", "Ds"),
    ),
    "whirl-whip": Rig(
        WhirlWhip(),
        {
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
        (100.0, 200.0),
        ("K3",),
    ),
    "anisotropic": Rig(
        Anisotropic(),
        {
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
        (0.0,),
    ),
    # Stiffness and mass of the published two-disk rig (eq. 21).
    "two-disk": Rig(
        TwoDisk(),
        {
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
        (0.0,),
        ("beta1", "beta2"),
    ),
    "overhung": Rig(
        Overhung(),
        {"M": 8.0, "It": 0.06, "Ip": 0.11, "k11": 4.0e5, "k12": -5.0e4, "k22": 2.0e4, "d1": 60.0, "d2": 0.6},
        (150.0, 400.0),
    ),
}
