"""Tests of rotors with Muszynska's law, made by formulas written out here, without rotorfit's models or solvers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import brentq

import rotorfit as rf
from rotorfit.base.array_types import ComplexArray, Float

Values = Mapping[str, float]

CLEARANCE = 200e-6
CLEARANCE_UM = 200.0
ONE_MODE = {
    "M": 1.2, "K": 8000.0, "Ds": 8.0, "K0": 9000.0, "D": 450.0, "lam": 0.46, "Mf": 0.4, "n_K": 2.0, "n_D": 1.4,
    "b": 0.5,
}  # fmt: skip
LIGHT = ONE_MODE | {"D": 150.0}
"""Lightly damped, so that it rings."""
JUMPING = ONE_MODE | {"K": 2000.0, "D": 40.0, "n_D": 0.5}
"""Has several orbits under one force."""
WHIRL_WHIP = {
    "Md": 0.95, "Ds": 25.0, "K1": 14000.0, "K2": 15000.0, "sigma": 1.0, "Mb": 0.3, "K3": 6000.0, "K0": 10000.0,
    "D": 450.0, "lam": 0.475, "Mf": 0.35, "n_K": 2.0, "n_D": 1.4, "b": 0.5,
}  # fmt: skip


def fluid(v: Values, eps: Any) -> tuple[Any, Any, Any]:
    """K0, D and lam at an eccentricity."""
    wide = 1 - eps**2
    return v["K0"] * wide ** -v["n_K"], v["D"] * wide ** -v["n_D"], v["lam"] * (1 - eps) ** v["b"]


def kappa(v: Values, w: Any, speed: float, eps: Any) -> ComplexArray:
    """Dynamic stiffness of eqs (13) and (18), shape ``(n, n)``."""
    K0, D, lam = fluid(v, eps)
    force = K0 + 1j * D * (w - lam * speed) - v["Mf"] * (w - lam * speed) ** 2
    if "M" in v:
        return np.array([[v["K"] + force - v["M"] * w**2 + 1j * v["Ds"] * w]])
    disk = v["K1"] + v["K2"] - v["Md"] * w**2 + 1j * v["Ds"] * w
    journal = v["K3"] + v["K2"] * v["sigma"] - v["Mb"] * w**2 + force
    return np.array([[disk, -v["K2"] * v["sigma"]], [-v["K2"], journal]])


def planes_of(v: Values) -> tuple[str, ...]:
    return ("journal",) if "M" in v else ("disk", "journal")


def orbits(v: Values, w: float, speed: float, force: ComplexArray, points: int = 400) -> list[tuple[float, Any]]:
    """Every circular orbit: eccentricity and amplitudes."""

    def excess(eps: float) -> float:
        return float(abs(np.linalg.solve(kappa(v, w, speed, eps), force)[-1]) / CLEARANCE - eps)

    grid = np.linspace(0.0, 1 - 1e-9, points)
    values = [excess(eps) for eps in grid]
    roots = [
        float(brentq(excess, a, b, xtol=1e-15, rtol=1e-14))
        for a, b, at, after in zip(grid, grid[1:], values, values[1:], strict=False)
        if at * after < 0
    ]
    return [(eps, np.linalg.solve(kappa(v, w, speed, eps), force)) for eps in roots]


def sweep(
    v: Values,
    *,
    levels: Sequence[float],
    speeds: Sequence[float] = (100.0,),
    lines: int = 40,
    top: float = 400.0,
    noise: float = 0.01,
    seed: int = 0,
    branch: int | str = 0,
) -> rf.PerturbationTest:
    """Sweeps at several force levels at the journal, noise a fraction of each response's rms.

    ``branch`` is the number of the orbit where there are several, or "alternate" for first and last in turn.
    """
    rng = np.random.default_rng(seed)
    half = np.linspace(2 * top / lines, top, lines // 2)
    w = np.concatenate([-half[::-1], half])
    rows: dict[str, list[Any]] = {}
    planes = planes_of(v)
    force = np.zeros(len(planes), dtype=complex)
    for speed in speeds:
        for level in levels:
            force[-1] = level
            found = [orbits(v, x, speed, force, 120) for x in w.tolist()]
            at = [(-1 if i % 2 else 0) if branch == "alternate" else int(branch) for i in range(w.size)]
            A = np.array([one[k][1] for one, k in zip(found, at, strict=True)])
            for number, plane in enumerate(planes):
                spread = noise * float(np.sqrt(np.mean(np.abs(A[:, number]) ** 2)))
                z = A[:, number] + spread * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
                row = {
                    "run": f"{speed:g} rad/s {level:g} N", "speed": speed, "frequency": w, "force_plane": "journal",
                    "force": level, "plane": plane, "direction": "z", "response": z, "sigma": spread or np.nan,
                }  # fmt: skip
                for key, cell in row.items():
                    rows.setdefault(key, []).append(np.broadcast_to(np.asarray(cell), w.shape))
    joined: dict[str, Any] = {key: np.concatenate(parts) for key, parts in rows.items()}
    return rf.perturbation_test(**joined, source="sweep")


def equilibrium(v: Values, speed: float, load: complex) -> ComplexArray:
    """Displacements under a constant load at the journal."""
    force = np.zeros(len(planes_of(v)), dtype=complex)
    force[-1] = load
    return np.asarray(orbits(v, 0.0, speed, force, 120)[0][1])


def static(
    v: Values,
    *,
    speeds: Sequence[float] = (100.0, 180.0, 260.0),
    loads: Sequence[float] = (2.0, 10.0, 18.0, 26.0, 35.0, 45.0),
    angle: float = -np.pi / 2,
    sigma: float = 0.3e-6,
    seed: int = 1,
) -> rf.StaticTest:
    rng = np.random.default_rng(seed)
    rows = []
    for speed in speeds:
        for load in loads:
            vector = load * np.exp(1j * angle)
            z = equilibrium(v, speed, vector)
            for plane, value in zip(planes_of(v), z, strict=True):
                error = sigma * (rng.normal() + 1j * rng.normal())
                rows.append((f"{speed:g} rad/s", speed, "journal", vector, plane, value + error, sigma or np.nan))
    names = ("run", "speed", "load_plane", "load", "plane", "displacement", "sigma")
    columns: dict[str, Any] = {n: np.array(column) for n, column in zip(names, zip(*rows, strict=True), strict=True)}
    return rf.StaticTest(**columns, source="static")


def small_motion(v: Values, speed: float, z0: complex) -> tuple[Float, Float, Float]:
    """Real 2x2 stiffness, damping and mass of one mode about z0, by central differences of the force."""

    def force(z: complex, velocity: complex, acceleration: complex) -> complex:
        K0, D, lam = fluid(v, abs(z) / CLEARANCE)
        turning = 1j * lam * speed
        whirl = acceleration - 2 * turning * velocity + turning**2 * z
        own = v["K"] * z + v["Ds"] * velocity + v["M"] * acceleration
        return complex(own + K0 * z + D * (velocity - turning * z) + v["Mf"] * whirl)

    matrices = []
    for place, step in enumerate((1e-6 * CLEARANCE, 1e-3, 1.0)):
        columns = []
        for direction in (1.0, 1j):
            ahead, behind = [z0, 0j, 0j], [z0, 0j, 0j]
            ahead[place] += step * direction
            behind[place] -= step * direction
            slope = (force(*ahead) - force(*behind)) / (2 * step)
            columns.append([slope.real, slope.imag])
        matrices.append(np.array(columns).T)
    return matrices[0], matrices[1], matrices[2]


def free_vibration(v: Values, speed: float, eps: float) -> tuple[ComplexArray, ComplexArray]:
    """Eigenvalues and eigenvectors of the state (x, y, x', y') about an equilibrium on the x axis."""
    K, C, M = small_motion(v, speed, eps * CLEARANCE)
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    s, modes = np.linalg.eig(A)
    return s, modes


def whirl(v: Values, speed: float, eps: float) -> complex:
    """The least damped eigenvalue."""
    s, _ = free_vibration(v, speed, eps)
    s = s[s.imag > 1]
    return complex(s[np.argmax(s.real / np.abs(s))])


def impulse(
    v: Values,
    *,
    speeds: Sequence[float] = (100.0, 180.0),
    eccentricities: Sequence[float] = (0.0, 0.15, 0.3, 0.45, 0.6),
    sigma: float = 0.3,
    seed: int = 2,
) -> rf.ImpulseTest:
    rng = np.random.default_rng(seed)
    rows = []
    for speed in speeds:
        for eps in eccentricities:
            s = whirl(v, speed, eps) + sigma * (rng.normal() + 1j * rng.normal())
            rows.append((f"{speed:g} rad/s", speed, s.imag, -s.real / abs(s), eps, sigma or np.nan))
    names = ("run", "speed", "frequency", "damping_ratio", "eccentricity", "sigma")
    columns: dict[str, Any] = {n: np.array(column) for n, column in zip(names, zip(*rows, strict=True), strict=True)}
    return rf.ImpulseTest(**columns, position=np.full(len(rows), complex(np.nan, np.nan)), source="impulse")


def ring_down(
    v: Values,
    *,
    speed: float = 180.0,
    eccentricities: Sequence[float] = (0.0, 0.3, 0.6),
    noise: float = 0.05e-6,
    duration: float = 0.4,
    samples: int = 800,
    seed: int = 3,
) -> rf.RingDownTest:
    """Records after a small velocity step, from the matrix exponential of the linearised motion."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, duration, samples)
    parts: dict[str, list[Any]] = {}
    for eps in eccentricities:
        s, modes = free_vibration(v, speed, eps)
        start = np.linalg.solve(modes, np.array([0.0, 0.0, 5e-4, 2e-4]))
        motion = np.einsum("ik,k,tk->ti", modes[:2], start, np.exp(np.outer(time, s))).real
        motion = motion + [eps * CLEARANCE, 0.0] + noise * rng.normal(size=motion.shape)
        record = {"run": f"eps {eps:g}", "speed": speed, "time": time, "x": motion[:, 0], "y": motion[:, 1]}
        for key, cell in (record | {"eccentricity": np.nan}).items():
            parts.setdefault(key, []).append(np.broadcast_to(np.asarray(cell), time.shape))
    columns: dict[str, Any] = {key: np.concatenate(cells) for key, cells in parts.items()}
    return rf.RingDownTest(**columns, source="records")


def off_centre(
    v: Values, *, speed: float = 100.0, eps: float = 0.5, lines: int = 24, noise: float = 0.01, seed: int = 5
) -> rf.PerturbationTest:
    """Small forward and backward circular forces about an equilibrium at 0.7 rad, read in x and y."""
    rng = np.random.default_rng(seed)
    z0 = eps * CLEARANCE * np.exp(0.7j)
    K, C, M = small_motion(v, speed, z0)
    rows: dict[str, list[Any]] = {}
    for sense in (1, -1):
        w = np.linspace(300 / lines, 300, lines)
        F = 0.05 * np.exp(0.3j) * np.array([1.0, -1j * sense])
        H = np.linalg.inv(K - M * w[:, None, None] ** 2 + 1j * C * w[:, None, None])
        motion = H @ F
        for number, axis in enumerate("xy"):
            spread = noise * float(np.sqrt(np.mean(np.abs(motion[:, number]) ** 2)))
            value = motion[:, number] + spread * (rng.normal(size=lines) + 1j * rng.normal(size=lines))
            row = {
                "run": f"off {sense:+d}", "speed": speed, "frequency": sense * w, "force_plane": "journal",
                "force": 0.05 * np.exp(0.3j), "plane": "journal", "direction": axis, "response": value,
                "sigma": spread or np.nan,
            }  # fmt: skip
            for key, cell in row.items():
                rows.setdefault(key, []).append(np.broadcast_to(np.asarray(cell), w.shape))
    count = 4 * lines
    place = {
        "static_x_um": np.full(count, z0.real * 1e6),
        "static_y_um": np.full(count, z0.imag * 1e6),
    }
    joined: dict[str, Any] = {key: np.concatenate(parts) for key, parts in rows.items()}
    return rf.perturbation_test(**joined, attributes=place, source="off-centre")


def squeeze(
    v: Values,
    *,
    speed: float = 0.0,
    eccentricities: Sequence[float] = (0.1, 0.3, 0.5, 0.7),
    lines: int = 20,
    noise: float = 0.01,
    seed: int = 4,
) -> rf.DisplacementTest:
    """Circular orbits imposed on a journal, of one mode; without rotation the squeeze-film test."""
    rng = np.random.default_rng(seed)
    eps = np.repeat(np.asarray(eccentricities), lines)
    w = np.tile(np.linspace(-390, 410, lines), len(eccentricities))
    size = eps * CLEARANCE
    F = np.array([kappa(v, x, speed, e)[0, 0] for x, e in zip(w, eps, strict=True)]) * size
    spread = noise * float(np.sqrt(np.mean(np.abs(F) ** 2)))
    F = F + spread * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
    x = np.where(w < 0, F.conj(), F)
    return rf.DisplacementTest(
        run=np.full(w.size, f"imposed {speed:g}"), speed=np.full(w.size, speed), frequency=w,
        plane=np.full(w.size, "journal"), displacement=size.astype(complex), force_x=x,
        force_y=np.where(w < 0, 1j * x, -1j * x), sigma=np.full(w.size, spread * np.sqrt(2) or np.nan),
        source="squeeze",
    )  # fmt: skip
