"""Do printed intervals hold the truth where something acts that the model knows nothing of, and is it named?

    python benchmarks/systematic_causes.py --rigs 60

writes results/systematic_causes.md and .csv. Rigs are equations written out here, with values off the typical ones by a
tenth: one mode, and a disk on a chain with a journal. Each row is one cause: of normal size with the standard deviation
stated where no data of the kind can tell it, else of a fixed size. Values that change are those at the mean tested
speed, at rest and in the middle of a sweep; the threshold is that of the rig with its change. Coverage is counted for
the interval that is printed, with the systematic share; for that with a share of found causes alone, all plausible
sizes zero; and for the statistical part alone. A cause is named where the first fixed cause that the fit says is the
one that acts; where none acts, any is a false alarm. Exit status 1 says that a printed interval holds the truth in less
than 85 %, and that fits do not say either that their model limits them.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, root

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from reporting import RESULTS, environment, table, write_csv  # noqa: E402

import rotorfit as rf  # noqa: E402
from rotorfit.fitting.assumptions.shifts import assuming  # noqa: E402

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

LINES = 40
PROMISED = 0.85
QUANTITIES = ("D", "lam", "K0", "threshold_speed")


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A rotor by its masses, springs and dampers; what only the simulator knows comes last."""

    M: Float  # masses, kg, from the disk to the journal, shape ``(n,)``
    Ds: Float  # external dampers, N s/m
    K: Float  # springs to ground, N/m
    K12: float  # shaft between the two planes, N/m
    K0: float
    D: float
    lam: float
    Mf: float
    known: dict[str, float] = field(default_factory=dict)  # what the fit is given
    internal: float = 0.0  # damping that turns with the shaft, N s/m
    damper: float = 0.0  # at the journal, N s/m
    gyroscopic: float = 0.0  # at the last plane, kg
    hysteresis: float = 0.0  # imaginary stiffness of a forward whirl at the first plane, N/m
    second_seal: float = 0.0  # at the disk, as a share of the fluid at the journal
    uneven: float = 0.0  # half the difference of stiffness in x and y at the first plane, N/m
    lam_rise: float = 0.0  # share by which lam rises from `speed` to twice that
    K0_power: float = 0.0  # power of the speed over `speed` that K0 grows with
    speed: float = 1.0  # rad/s
    rest: float = 0.0  # eccentricity at rest
    exponents: tuple[float, float, float] = (1.0, 1.0, 0.5)  # of K0, D and lam in eccentricity

    def at(self, speed: float) -> Rig:
        """The rig with the values of its fluid at a speed."""
        lam = self.lam * (1 + self.lam_rise * (speed / self.speed - 1))
        return replace(self, lam=lam, K0=self.K0 * (speed / self.speed) ** self.K0_power, lam_rise=0.0, K0_power=0.0)

    def stiffness(self, s: Complex, speed: float) -> Complex:
        """Dynamic stiffness at the planes, shape ``(L, n, n)``: force over motion."""
        if self.lam_rise or self.K0_power:
            return self.at(speed).stiffness(s, speed)
        n = self.M.size
        shaft = self.K12 * np.array([[1.0, -1.0], [-1.0, 1.0]]) if n == 2 else np.zeros((1, 1))
        twist = shaft / self.K12 if n == 2 else np.ones((1, 1))
        s = np.asarray(s, dtype=complex)[:, None, None]
        found = np.diag(self.K) + shaft + s * np.diag(self.Ds) + s**2 * np.diag(self.M)
        found = found + self.internal * (s - 1j * speed) * twist
        shape = 1 - self.rest**2
        ratio = self.lam * (1 - self.rest) ** self.exponents[2]
        slip = s - 1j * ratio * speed
        fluid = self.K0 * shape ** -self.exponents[0] + self.D * shape ** -self.exponents[1] * slip + self.Mf * slip**2
        fluid = fluid + self.damper * s - 1j * self.gyroscopic * speed * s
        found[:, -1, -1] += fluid[:, 0, 0]
        found[:, 0, 0] += self.second_seal * (self.K0 + self.D * (s[:, 0, 0] - 1j * self.lam * speed))
        found[:, 0, 0] += 1j * self.hysteresis * np.where(s[:, 0, 0].imag < 0, -1.0, 1.0)
        return np.asarray(found)

    def growth(self, speed: float) -> float:
        """Largest real part of the roots, 1/s, by linearisation of the polynomial in s."""
        n = self.M.size
        at = [self.stiffness(np.array([s]), speed)[0] for s in (-1.0, 0.0, 1.0)]
        K, C, M = at[1], (at[2] - at[0]) / 2, (at[2] + at[0]) / 2 - at[1]
        inverse = np.linalg.inv(M)
        roots = np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ C]]))
        return float(roots.real.max())

    def truth(self) -> dict[str, float]:
        """Values of the fluid and threshold of the centred journal."""
        centred = replace(self, rest=0.0)
        speeds = np.geomspace(1.0, 5000.0, 60)
        first = next(k for k, speed in enumerate(speeds) if centred.growth(speed) > 0)
        onset = brentq(centred.growth, speeds[first - 1], speeds[first])
        return {"K0": self.K0, "D": self.D, "lam": self.lam, "threshold_speed": onset}


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """How a rig is tested, and what readings go through."""

    speeds: tuple[float, ...] = (100.0, 180.0)  # rad/s
    directions: str = "z"  # of probes: "z", "x" or "xy"
    one_run: bool = False
    sigma_given: bool = True
    noise: float = 0.005  # of each probe, over the rms of its readings
    gain: float = 1.0  # that nobody knows of
    gain_scatter: float = 0.0  # standard deviation from run to run
    jitter: float = 0.0  # of the force, from line to line
    proportional: float = 0.0  # noise of each reading, as a share of it
    filter: float = math.inf  # corner of a low-pass on all channels, over the highest frequency
    filter_y: float = math.inf  # the same on y alone
    turned: float = 0.0  # phase reference, rad, from rest to the highest frequency
    clock: float = 0.0  # time by which marks are behind at the end of a sweep from rest, s
    drift: float = 0.0  # of D, as a share, from the beginning of a sweep to its end
    probe: float = 0.0  # share by which probes read too much at their largest amplitude
    law: float = 0.0  # eccentricity of the largest orbit, in a fluid of a Muszynska law with n = 2
    load: float = 0.0  # constant, at the journal of a fluid of that law, over what moves it by the clearance at rest
    model: dict[str, Any] = field(default_factory=dict)  # arguments of the model that is fitted


def _forward(
    rig: Rig, test: Campaign, w: Float, speed: float, force: Complex, largest: float
) -> tuple[Complex, Complex]:
    """Motion with the force and, conjugate, against it, each of shape ``(L, n)``."""
    n, kappa = rig.M.size, rig.stiffness(1j * w, speed)
    seal = rig.at(speed)
    slip = seal.D * (1j * w - 1j * seal.lam * speed)
    share = (np.abs(w) - np.abs(w).min()) / np.ptp(np.abs(w)) - 0.5
    z = np.linalg.solve(kappa, force[..., None])[..., 0]
    for _ in range(40 if test.law else 1):
        stiffer = (1 - (test.law * np.abs(z[:, -1]) / largest) ** 2) ** -2.0 - 1 if test.law else 0.0
        changed = kappa.copy()
        changed[:, -1, -1] += stiffer * (seal.K0 + slip) + test.drift * share * slip
        z = np.linalg.solve(changed, force[..., None])[..., 0]
    against = np.zeros_like(z)
    if rig.uneven:  # dK conj(z): the pair of w and -w
        mirror = rig.stiffness(-1j * w, speed).conj()
        both = np.block([[changed, np.zeros_like(changed)], [np.zeros_like(changed), mirror]])
        both[:, 0, n] = both[:, n, 0] = rig.uneven
        z, against = np.split(np.linalg.solve(both, np.hstack([force, 0 * force])[..., None])[..., 0], 2, axis=1)
    return z, against


CLEARANCE = 200e-6


def loaded_orbit(rig: Rig, w: float, speed: float, force: float, load: float, begin: Complex | None) -> Complex:
    """A closed orbit of one mode under a turning and a constant force, by points that its harmonics go through."""
    points = 16
    s = 1j * w * np.fft.fftfreq(points, 1 / points)
    acting = force * np.exp(2j * np.pi * np.arange(points) / points) + load
    n_K, n_D, b = rig.exponents

    def missing(x: Float) -> Float:
        z = x[:points] + 1j * x[points:]
        v, a = np.fft.ifft(np.array([s, s**2]) * np.fft.fft(z))
        eps = np.minimum(np.abs(z) / CLEARANCE, 0.98)
        turn = 1j * rig.lam * (1 - eps) ** b * speed
        fluid = rig.K0 * (1 - eps**2) ** -n_K * z + rig.D * (1 - eps**2) ** -n_D * (v - turn * z)
        fluid = fluid + rig.Mf * (a - 2 * turn * v + turn**2 * z)
        left = rig.M[0] * a + rig.Ds[0] * v + rig.K[0] * z + fluid - acting
        return np.concatenate([left.real, left.imag]) / (rig.K0 * CLEARANCE)

    z = np.full(points, 0.1 * CLEARANCE + 0j) if begin is None else begin
    found = root(missing, np.concatenate([z.real, z.imag]), options={"xtol": 1e-12})
    if np.abs(found.fun).max() > 1e-9:
        raise RuntimeError(f"no orbit at {w} rad/s under {force} and {load} N")
    return np.asarray(found.x[:points] + 1j * found.x[points:])


def _under_load(rig: Rig, test: Campaign, rng: np.random.Generator) -> rf.PerturbationTest:
    """Both probes of one mode in a fluid of a law of eccentricity, at two levels of force, under a constant load."""
    sizes = np.linspace(5, 200, LINES // 2)
    load = test.load * CLEARANCE * (rig.K[0] + rig.K0)
    parts = []
    for speed in test.speeds:
        for force in (1.0, 4.0):
            for way in (1.0, -1.0):
                orbits: list[Complex] = []
                for w in way * sizes:
                    orbits.append(loaded_orbit(rig, w, speed, force, load, orbits[-1] if orbits else None))
                harmonics = np.fft.fft(orbits) / len(orbits[0])
                along, against = harmonics[:, 1], harmonics[:, -1].conj()
                for direction, z in (("x", along + against), ("y", (along - against) / 1j)):
                    sigma = test.noise * float(np.sqrt(np.mean(np.abs(z) ** 2)))
                    noisy = z + sigma * (rng.normal(size=z.size) + 1j * rng.normal(size=z.size))
                    read = noisy if way > 0 else noisy.conj()
                    parts.append((f"{speed:g} {force:g} {way:g}", speed, force, direction, sigma, way * sizes, read))
    run, speeds, forces, directions, sigmas = (np.repeat([p[k] for p in parts], sizes.size) for k in range(5))
    return rf.perturbation_test(
        run=run, speed=speeds, frequency=np.concatenate([p[5] for p in parts]), force_plane="journal", force=forces,
        plane="journal", direction=directions, response=np.concatenate([p[6] for p in parts]), sigma=sigmas,
    )  # fmt: skip


def _read(test: Campaign, way: str, w: Float, along: Complex, against: Complex, largest: float) -> Complex:
    """Reading of a probe of the motion with the force and, conjugate, against it."""
    size = np.abs(w)
    z = along if way == "z" else along + against if way == "x" else (along - against) / 1j
    z = z * (1 + test.probe * np.abs(z) ** 2 / largest**2)
    z = z * np.exp(1j * np.sign(w) * test.turned * size / size.max()) / (1 + 1j * w / (test.filter * size.max()))
    z = z * np.exp(-1j * w * test.clock * size / size.max())
    if way == "y":
        z = z / (1 + 1j * w / (test.filter_y * size.max()))
    return np.asarray(z if way == "z" else np.where(w > 0, z, z.conj()))  # phasors turn by exp(j |w| t)


def measured(rig: Rig, test: Campaign, rng: np.random.Generator) -> rf.PerturbationTest:
    """Responses of all planes to a force of 5 N at each, forward and backward; noise is common to no two probes."""
    if "clearance_um" in test.model:
        return _under_load(rig, test, rng)
    planes = ("disk", "journal")[-rig.M.size :]
    highest = 1.5 * float(np.sqrt((rig.K.sum() + rig.K12 + rig.K0) / rig.M.min()))
    w = np.concatenate([-np.linspace(highest, 5, LINES), np.linspace(5, highest, LINES)])
    H = [5.0 * test.gain * np.abs(np.linalg.inv(rig.stiffness(1j * w, speed))) for speed in test.speeds]
    largest = np.max(H, axis=(0, 1, 3))  # of each plane
    parts = []
    for speed in test.speeds:
        for forced, plane in enumerate(planes):
            if test.one_run and forced < len(planes) - 1:
                continue
            force = np.zeros((w.size, len(planes)), dtype=complex)
            force[:, forced] = 5.0 * test.gain
            if test.gain_scatter or test.jitter:
                force *= 1 + test.gain_scatter * np.where(w > 0, rng.normal(), rng.normal())[:, None]
                force *= 1 + test.jitter * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))[:, None]
            along, against = _forward(rig, test, w, speed, force, float(largest[-1]))
            for read, probe in enumerate(planes):
                for way in test.directions:
                    z = _read(test, way, w, along[:, read], against[:, read], float(largest[read]))
                    sigma = test.noise * float(np.sqrt(np.mean(np.abs(z) ** 2)))
                    spread = np.hypot(sigma, test.proportional * np.abs(z))
                    z = z + spread * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
                    run = np.where(w > 0, f"{plane} {speed:g} forward", f"{plane} {speed:g} backward")
                    parts.append((np.full(w.size, "one") if test.one_run else run, speed, plane, probe, way, z, sigma))
    return rf.perturbation_test(
        run=np.concatenate([p[0] for p in parts]),
        speed=np.repeat([p[1] for p in parts], w.size),
        frequency=np.tile(w, len(parts)),
        force_plane=np.repeat([p[2] for p in parts], w.size),
        force=5.0,
        plane=np.repeat([p[3] for p in parts], w.size),
        direction=np.repeat([p[4] for p in parts], w.size),
        response=np.concatenate([p[5] for p in parts]),
        **({"sigma": np.repeat([p[6] for p in parts], w.size)} if test.sigma_given else {}),
    )


def one_mode(rng: np.random.Generator) -> Rig:
    """A rotor of one mode on a seal."""
    off = rng.normal(1.0, 0.1, 7)
    rig = Rig(
        M=np.array([1.2 * off[0]]), Ds=np.array([8.0 * off[1]]), K=np.array([8000.0 * off[2]]), K12=1.0,
        K0=9000.0 * off[3], D=450.0 * off[4], lam=0.46 * off[5], Mf=0.4 * off[6],
    )  # fmt: skip
    return replace(rig, known={"K": float(rig.K[0]), "Ds": float(rig.Ds[0])})


def chain(rng: np.random.Generator) -> Rig:
    """A disk on a shaft that runs through a seal, on a spring behind it."""
    off = rng.normal(1.0, 0.1, 10)
    rig = Rig(
        M=np.array([0.95 * off[0], 0.3 * off[1]]), Ds=np.array([3.0 * off[2], 0.0]),
        K=np.array([14000.0 * off[3], 6000.0 * off[4]]), K12=15000.0 * off[5],
        K0=10000.0 * off[6], D=450.0 * off[7], lam=0.475 * off[8], Mf=0.35 * off[9],
    )  # fmt: skip
    return replace(rig, known={"K3": float(rig.K[1])})


MODELS: dict[Callable[[np.random.Generator], Rig], Callable[..., rf.models.RotorModel]] = {
    one_mode: rf.models.OneMode,
    chain: rf.models.WhirlWhip,
}

Draw = Callable[[Rig, np.random.Generator], tuple[Rig, Campaign]]


def _off_centre(rig: Rig, rng: np.random.Generator) -> tuple[Rig, Campaign]:
    exponents = (rng.uniform(0.8, 1.2), rng.uniform(0.8, 1.2), rng.uniform(0.4, 0.6))
    return replace(rig, rest=abs(rng.normal(0, 0.05)), exponents=exponents), Campaign()


def _known(rig: Rig, rng: np.random.Generator) -> tuple[Rig, Campaign]:
    name = "K3" if "K3" in rig.known else "K"
    return replace(rig, known={**rig.known, name: rig.known[name] * rng.normal(1, 0.01)}), Campaign()


def _read_through(rig: Rig, rng: np.random.Generator, **change: Any) -> tuple[Rig, Campaign]:
    return rig, Campaign(**change)


def _with_speed(
    rig: Rig,
    rng: np.random.Generator,
    shares: tuple[float, ...] = (0.2, 0.35, 0.5, 0.7),
    lam_rise: float = 0.0,
    K0_power: float = 0.0,
    fitted: str = "",
    **change: Any,
) -> tuple[Rig, Campaign]:
    """Values that change with speed, tested at shares of the threshold; they are those at the mean tested speed."""
    threshold = rig.truth()["threshold_speed"]
    speed = float(np.mean(shares)) * threshold
    changing = replace(rig, speed=speed, lam_rise=lam_rise * speed / (threshold / 2), K0_power=K0_power)
    law = rf.models.LinearInSpeed((fitted,), speed_rpm=speed * 30 / math.pi) if fitted else None
    return changing, Campaign(
        speeds=tuple(share * threshold for share in shares),
        model={"law": law} if law is not None else {},
        **change,
    )


def _with_law(rig: Rig, rng: np.random.Generator, load: float) -> tuple[Rig, Campaign]:
    """A fluid of a law of eccentricity, under a load that moves the journal by so much of the clearance at rest."""
    model = {"law": rf.models.Muszynska(), "clearance_um": 1e6 * CLEARANCE}
    return replace(rig, exponents=(2.0, 1.4, 0.5)), Campaign(load=load, model=model)


def _hysteresis(rig: Rig, rng: np.random.Generator) -> tuple[Rig, Campaign]:
    return replace(rig, hysteresis=0.01 * float(rig.K[0])), Campaign()


def _uneven(share: float, directions: str, noise: float, rig: Rig, rng: np.random.Generator) -> tuple[Rig, Campaign]:
    """Stiffness of the supports that differs in x and y by a share."""
    return replace(rig, uneven=share * float(rig.K[0]) / 2), Campaign(directions=directions, noise=noise)


CAUSES: dict[str, tuple[Callable[[np.random.Generator], Rig], Draw]] = {
    "none, one mode": (one_mode, lambda rig, rng: (rig, Campaign())),
    "none, chain": (chain, lambda rig, rng: (rig, Campaign())),
    "off centre by 0.05, one mode": (one_mode, _off_centre),
    "off centre by 0.05, chain": (chain, _off_centre),
    "gain of the only run, 1 %": (
        one_mode, lambda rig, rng: (rig, Campaign(one_run=True, gain=rng.normal(1, 0.01))),
    ),
    "gain of the only probe, 1.5 %": (
        one_mode, lambda rig, rng: (rig, Campaign(directions="x", gain=rng.normal(1, 0.015))),
    ),
    "internal damping, 1 N s/m": (
        one_mode, lambda rig, rng: (replace(rig, internal=abs(rng.normal(0, 1))), Campaign()),
    ),
    "damper at the journal, 3 % of D": (
        chain, lambda rig, rng: (replace(rig, damper=abs(rng.normal(0, 0.03)) * rig.D), Campaign()),
    ),
    "known stiffness, 1 %, one mode": (one_mode, _known),
    "known stiffness, 1 %, chain": (chain, _known),
    "gyroscopic effect, 3 % of M, one speed": (
        one_mode,
        lambda rig, rng: (replace(rig, gyroscopic=abs(rng.normal(0, 0.03)) * rig.M[0]), Campaign(speeds=(180.0,))),
    ),
    "lam +5 % a half threshold, four speeds": (one_mode, partial(_with_speed, lam_rise=0.05)),
    "lam +5 % a half threshold, four speeds, chain": (chain, partial(_with_speed, lam_rise=0.05)),
    "lam +5 % a half threshold, two speeds": (one_mode, partial(_with_speed, shares=(0.4, 0.7), lam_rise=0.05)),
    "lam +5 % a half threshold, one speed": (one_mode, partial(_with_speed, shares=(0.5,), lam_rise=0.05)),
    "K0 as speed^0.3, four speeds": (one_mode, partial(_with_speed, K0_power=0.3)),
    "K0 as speed^0.3, two speeds, noise 0.1 %, estimated": (
        one_mode, partial(_with_speed, shares=(0.4, 0.7), K0_power=0.3, noise=0.001, sigma_given=False),
    ),
    "in proportion to speed, lam +5 % a half threshold, four speeds": (
        one_mode, partial(_with_speed, lam_rise=0.05, fitted="lam"),
    ),
    "in proportion to speed, K0 as speed^0.3, four speeds": (
        one_mode, partial(_with_speed, K0_power=0.3, fitted="K0"),
    ),
    "K0 as speed^0.3, one speed": (one_mode, partial(_with_speed, shares=(0.5,), K0_power=0.3)),
    **{
        f"{words}, {kind.__name__.replace('_', ' ')}": (kind, partial(_read_through, **change))
        for words, change in {
            "low-pass on all channels, 20 times the band": {"filter": 20.0},
            "low-pass on y, 20 times the band": {"filter_y": 20.0, "directions": "xy"},
            "phase reference drifts by 2 degrees": {"turned": math.radians(2.0)},
            "D drifts by 10 %": {"drift": 0.1},
            "probes read 2 % too much": {"probe": 0.02},
            "fluid stiffens, eps 0.15": {"law": 0.15},
        }.items()
        for kind in (one_mode, chain)
    },
    "hysteresis of 1 %, one mode": (one_mode, _hysteresis),
    "hysteresis of 1 %, chain": (chain, _hysteresis),
    "anisotropy of 5 %, one probe": (one_mode, partial(_uneven, 0.05, "x", 0.005)),
    "anisotropy of 10 %, both probes, noise 0.1 %": (one_mode, partial(_uneven, 0.1, "xy", 0.001)),
    "anisotropy of 5 %, both probes, noise 0.1 %": (one_mode, partial(_uneven, 0.05, "xy", 0.001)),
    "anisotropy of 1 %, both probes": (one_mode, partial(_uneven, 0.01, "xy", 0.005)),
    "anisotropy of 10 %, both probes, chain": (chain, partial(_uneven, 0.1, "xy", 0.002)),
    "second seal at the disk, 1 %": (chain, lambda rig, rng: (replace(rig, second_seal=0.01), Campaign())),
    "second seal at the disk, 10 %": (chain, lambda rig, rng: (replace(rig, second_seal=0.1), Campaign())),
    "none, a law of eccentricity": (one_mode, partial(_with_law, load=0.0)),
    "static load under a law, eccentricity 0.05": (one_mode, partial(_with_law, load=0.05)),
    "static load under a law, eccentricity 0.15": (one_mode, partial(_with_law, load=0.15)),
    "none, noise estimated, one mode": (one_mode, partial(_read_through, sigma_given=False)),
    "none, noise estimated, chain": (chain, partial(_read_through, sigma_given=False)),
    "force jitters by 1 %": (one_mode, partial(_read_through, jitter=0.01, sigma_given=False)),
    "noise in proportion, 1 %": (one_mode, partial(_read_through, proportional=0.01, sigma_given=False)),
    "gain scatters by 1 %": (one_mode, partial(_read_through, gain_scatter=0.01)),
    "marks behind by 0.2 ms at the end, one mode": (one_mode, partial(_read_through, clock=2e-4)),
    "marks behind by 0.2 ms at the end, chain": (chain, partial(_read_through, clock=2e-4)),
}  # fmt: skip
"""What acts, on which rig: each draw gives the rig, its test, and what the fit is given."""


NAMES = {
    "lam +5": "change with speed[lam]",
    "K0 as": "change with speed[K0]",
    "in proportion to speed, K0": "bend with speed[K0]",
    "low-pass": "delay",
    "phase ref": "delay",
    "marks": "clock",
    "D drifts": "drift[D]",
    "probes": "probe amplitude",
    "fluid stiff": "fluid amplitude",
    "hyst": "hysteresis",
    "anisotropy of 5 %, one": "supports[",
    "anisotropy of 5 %, both": "supports by both probes",
    "anisotropy of 10 %": "supports by both probes",
    "static load": "static load",
    "second": "fluid elsewhere",
}
"""Fixed cause that the fit should say, by the beginning of a row's name; none for the others."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """Coverage of 95 % intervals of one quantity under one cause."""

    cause: str
    quantity: str
    printed: float
    found: float  # of plausible sizes none, but causes that were found
    statistical: float
    wider: float  # median of the printed width over the statistical one
    named: float  # share of the rigs of which the fit says the cause; of those without one, that are given any
    limited: float  # share of the rigs of which the fit says that its model limits it


def study(cause: str, rigs: int, seed: int) -> list[Row]:
    """Coverage under one cause."""
    rng = np.random.default_rng(seed)
    kind, draw = CAUSES[cause]
    expected = [name for start, name in NAMES.items() if cause.startswith(start)]
    found, named, limited = [], [], []
    for _ in range(rigs):
        rig, test = draw(kind(rng), rng)
        fit = rf.fit(MODELS[kind](**test.model), measured(rig, test, rng), known=rig.known)
        truth = rig.truth()
        said = [cause.name for cause in fit.noise.causes] if fit.noise else []
        said += [entry.name for entry in fit.assumptions().entries if entry.name.startswith("supports by both")]
        plausible = {entry.name: 0.0 for entry in fit.assumptions().entries if entry.name not in said}
        alone = assuming(fit, plausible)
        ends = np.array(
            [
                [one.interval(name, statistical=part) for name in QUANTITIES]
                for one, part in ((fit, False), (alone, False), (fit, True))
            ]
        )  # printed, of found causes alone or statistical; quantity, end
        values = np.array([truth[name] for name in QUANTITIES])
        found.append((((ends[..., 0] <= values) & (values <= ends[..., 1])), np.diff(ends, axis=-1)[..., 0]))
        limited.append(fit.model_limited)
        named.append(said[0].startswith(expected[0]) if said and expected else bool(said) and not expected)
    held = np.mean([held for held, _ in found], axis=0)
    wider = np.median([width[0] / width[-1] for _, width in found], axis=0)
    return [
        Row(
            cause=cause,
            quantity=name,
            printed=held[0, i],
            found=held[1, i],
            statistical=held[2, i],
            wider=wider[i],
            named=np.mean(named),
            limited=np.mean(limited),
        )
        for i, name in enumerate(QUANTITIES)
    ]


def main() -> int:
    """Count, write, and say whether printed intervals hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=60, help="rigs of each cause [%(default)s]")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first cause [%(default)s]")
    parser.add_argument("--only", default="", help="rows that begin so, printed and not written")
    options = parser.parse_args()
    chosen = [(i, cause) for i, cause in enumerate(CAUSES) if cause.startswith(options.only)]
    rows = [row for i, cause in chosen for row in study(cause, options.rigs, options.seed + i)]
    command = f"python benchmarks/systematic_causes.py --rigs {options.rigs} --seed {options.seed}"
    where = environment("numpy", "scipy", "casadi")
    if not options.only:
        write_csv(rows, RESULTS / "systematic_causes.csv", command, where)
    head = [
        "cause",
        "quantity",
        "printed",
        "with found causes alone",
        "statistical alone",
        "times as wide",
        "named",
        "limited",
    ]
    cells = []
    for r in rows:
        shares = [f"{share:.0%}" for share in (r.printed, r.found, r.statistical, r.named, r.limited)]
        cells.append([r.cause, r.quantity, *shares[:3], f"{r.wider:.2g}", *shares[3:]])
    lines = [
        "# Coverage of 95 % intervals where something acts that the model lacks",
        "",
        f"`{command}`; {where}",
        "",
        *table(head, cells),
        "",
    ]
    if not options.only:
        (RESULTS / "systematic_causes.md").write_text("\n".join(lines), encoding="utf-8")
    print("\n".join(lines))
    return int(any(max(row.printed, row.limited) < PROMISED for row in rows))


if __name__ == "__main__":
    sys.exit(main())
