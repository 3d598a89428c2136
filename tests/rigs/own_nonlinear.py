"""Models of a user's own, written from what the class of models documents, with readings computed without them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from scipy.optimize import brentq

import rotorfit as rf
from rotorfit.models import Muszynska, Parameter, RotorModel, fluid_force
from rotorfit.models.complexes import J


class Damper(RotorModel):
    """A squeeze-film damper: damping and added mass of the film grow with eccentricity."""

    name = "squeeze-film-damper"
    planes = ("damper",)
    clearance = 150e-6
    parameters = (
        Parameter("m", "kg", "mass of the ring", scale=5.0, lower=0.0),
        Parameter("k", "N/m", "stiffness of the cage", scale=1e6),
        Parameter("c", "N s/m", "damping of the film", scale=1000.0),
        Parameter("a", "kg", "added mass of the film", scale=1.0),
        Parameter("g", "1", "exponent of the film's growth", upper=5.0),
    )

    def equation(self, p, speed, eccentricity):
        grown = (1 - eccentricity**2) ** -p.g
        return [[p.k]], [[p.c * grown]], [[p.m + p.a * eccentricity**2 * grown]]


class ThreeModes(RotorModel):
    """Two disks and a seal whose force has a law inside, under names of the user's own."""

    name = "three-modes"
    planes = ("left", "middle", "seal")
    clearance = 250e-6
    law = Muszynska()
    parameters = (
        *(Parameter(f"m{i}", "kg", "mass", scale=2.0, lower=0.0) for i in (1, 2, 3)),
        *(Parameter(f"k{i}", "N/m", "shaft stiffness", scale=1e5) for i in (1, 2, 3)),
        Parameter("c", "N s/m", "damping at both disks", scale=20.0),
        Parameter("stiff", "N/m", "fluid stiffness", scale=2e4),
        Parameter("damp", "N s/m", "fluid damping", scale=500.0),
        Parameter("ratio", "1", "velocity ratio", scale=0.5, lower=-2.0, upper=2.0),
        *law.parameters,
    )

    def equation(self, p, speed, eccentricity):
        inside = self.law.at(SimpleNamespace(**vars(p), K0=p.stiff, D=p.damp), eccentricity)
        ratio = p.ratio * inside.ratio
        fluid = fluid_force(inside.K0, inside.D, 0.0, ratio, ratio, speed)
        stiffness = [[p.k1 + p.k2, -p.k2, 0], [-p.k2, p.k2 + p.k3, -p.k3], [0, -p.k3, p.k3 + fluid.K]]
        return stiffness, _diagonal(p.c, p.c, fluid.C), _diagonal(p.m1, p.m2, p.m3)


class LaggingSeal(RotorModel):
    """A seal whose damping falls with frequency, ``D/(1 + tau s)``: its film is a plane without a probe."""

    name = "lagging-seal"
    planes = ("seal", "film")
    parameters = (
        Parameter("M", "kg", "mass", scale=10.0, lower=0.0),
        Parameter("K", "N/m", "stiffness", scale=1e6),
        Parameter("D", "N s/m", "damping of slow motion", scale=2000.0),
        Parameter("tau", "s", "time by which the film relaxes", scale=1e-3, lower=0.0),
        Parameter("lam", "1", "velocity ratio", scale=0.5, lower=-2.0, upper=2.0),
    )

    def equation(self, p, speed, eccentricity):
        unit = 1e6  # N/m, of the film's own row
        stiffness = [[p.K, -J * (p.D * p.lam * speed)], [-unit, unit]]
        return stiffness, [[0, p.D], [0, unit * p.tau]], [[p.M, 0], [0, 0]]


class ShortSeal(RotorModel):
    """A seal on a mass, all of its force in names of the user's own."""

    name = "short-seal"
    planes = ("shaft",)
    clearance = 2e-4
    parameters = (
        Parameter("m", "kg", "mass", scale=2.0, lower=0.0),
        Parameter("s", "N/m", "stiffness", scale=2e4),
        Parameter("c", "N s/m", "damping", scale=300.0),
        Parameter("r", "1", "ratio", scale=0.5),
        Parameter("e", "1", "growth"),
        Parameter("f", "1", "fall of the ratio", scale=0.5),
    )

    def equation(self, p, speed, eccentricity):
        grown = (1 - eccentricity**2) ** -p.e
        ratio = p.r * (1 - eccentricity) ** p.f
        return [[p.s * grown - J * (p.c * grown * ratio * speed)]], [[p.c * grown]], [[p.m]]


def _diagonal(*entries):
    return [[entry if row == column else 0.0 for column in range(3)] for row, entry in enumerate(entries)]


DAMPER = {"m": 6.0, "k": 1.2e6, "c": 1500.0, "a": 0.8, "g": 1.5}
THREE = {
    "m1": 3.2, "m2": 2.8, "m3": 0.9, "k1": 2.2e5, "k2": 1.6e5, "k3": 1.9e5, "c": 18.0,
    "stiff": 4e4, "damp": 420.0, "ratio": 0.46, "n_K": 1.2, "n_D": 1.6, "b": 0.4,
}  # fmt: skip
SEAL = {"M": 9.0, "K": 1.3e6, "D": 2600.0, "tau": 1.5e-3, "lam": 0.44}


def damper_stiffness(w: float, eps: float) -> complex:
    """Dynamic stiffness of the damper, written down a second time."""
    grown = (1 - eps**2) ** -1.5
    return 1.2e6 + 1500.0j * grown * w - (6.0 + 0.8 * eps**2 * grown) * w**2


def three_stiffness(w: float, eps: float, speed: float = 200.0) -> np.ndarray:
    """Dynamic stiffness of the three modes, likewise."""
    wide = 1 - eps**2
    kappa = np.diag([3.8e5 + 18j * w - 3.2 * w**2, 3.5e5 + 18j * w - 2.8 * w**2, 1.9e5 - 0.9 * w**2]).astype(complex)
    kappa[2, 2] += 4e4 * wide**-1.2 + 420j * wide**-1.6 * (w - 0.46 * (1 - eps) ** 0.4 * speed)
    kappa[0, 1] = kappa[1, 0] = -1.6e5
    kappa[1, 2] = kappa[2, 1] = -1.9e5
    return kappa


def _orbit(response, clearance: float) -> np.ndarray:
    """The smallest orbit of the last coordinate that makes itself."""

    def excess(eps: float) -> float:
        return float(abs(response(eps)[-1]) / clearance - eps)

    grid = np.linspace(0.0, 0.995, 200)
    signs = np.array([excess(eps) for eps in grid]) > 0
    first = int(np.flatnonzero(signs[:-1] & ~signs[1:])[0])
    return response(brentq(excess, grid[first], grid[first + 1]))


def _test(name, speed, w, plane, force, planes, motion, sigma, rng):
    noise = sigma * (rng.normal(size=motion.shape) + 1j * rng.normal(size=motion.shape))
    return rf.perturbation_test(
        run=name,
        speed=speed,
        frequency=np.tile(w, len(planes)),
        force_plane=plane,
        force=force,
        plane=np.repeat(planes, w.size),
        direction="z",
        response=(motion + noise).T.ravel(),
        sigma=sigma,
    )


def damper_tests(seed: int = 1):
    """Sweeps of the damper at three forces."""
    rng, w = np.random.default_rng(seed), np.r_[-700:-80:40.0, 100:720:40.0]
    return [
        _test(
            f"{force:g} N", 0.0, w, "damper", force, Damper.planes,
            np.array([_orbit(lambda e, f=force, v=v: np.array([f / damper_stiffness(v, e)]), 150e-6) for v in w]),
            2e-7, rng,
        )
        for force in (40.0, 120.0, 200.0)
    ]  # fmt: skip


def three_tests(seed: int = 2):
    """Sweeps of the three modes at three forces."""
    rng, w = np.random.default_rng(seed), np.r_[-420:-30:15.0, 30:425:15.0]
    found = []
    for force in (15.0, 40.0, 80.0):

        def motion(v, eps, force=force):
            return np.linalg.solve(three_stiffness(v, eps), [0, force, 0])

        orbits = np.array([_orbit(lambda e, v=v, motion=motion: motion(v, e), 250e-6) for v in w])
        found.append(_test(f"{force:g} N", 200.0, w, "middle", force, ThreeModes.planes, orbits, 3e-7, rng))
    return found


def seal_tests(seed: int = 3):
    """Sweeps of the seal at two speeds."""
    rng, w = np.random.default_rng(seed), np.r_[-700:-20:14.0, 20:705:14.0]
    found = []
    for speed in (200.0, 400.0):
        kappa = 1.3e6 - 9.0 * w**2 + 2600.0j * (w - 0.44 * speed) / (1 + 1.5e-3j * w)
        motion = (20.0 / kappa)[:, None]
        found.append(_test(f"{speed:g} rad/s", speed, w, "seal", 20.0, ("seal",), motion, 2e-8, rng))
    return found
