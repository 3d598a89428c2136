"""Do printed intervals hold the truth where something acts that the model knows nothing of, and is it named?

    python benchmarks/systematic_causes.py --rigs 60

writes results/systematic_causes.md and .csv. Rigs are equations written out here, with values off the typical ones by
a tenth: one mode, and a disk on a chain with a journal; and shafts of finite elements (tests/rigs/fe_rigs.py). Each
row is one cause: of normal size with the standard deviation stated where no data of the kind can tell it, else of a
fixed size. Values that change are those at the mean tested speed, at rest and in the middle of a sweep; the threshold
is that of the rig with its change. Coverage is counted for the interval that is printed, with the systematic share, of
the numbers that are given; for that with a share of found causes alone, all plausible sizes zero; and for the
statistical part alone. A cause is named where the first fixed cause that the fit says is the one that acts; where none
acts, any is a false alarm. Each fit is asked whether the rotor is stable at a speed 2 to 20 % above its threshold,
where it is not. Exit status 1 says that a printed interval holds the truth in less than 85 %.
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
sys.path[:0] = [str(HERE), str(HERE.parent / "tests" / "rigs")]

import fe_rigs  # noqa: E402
from reporting import RESULTS, environment, table, write_csv  # noqa: E402

import rotorfit as rf  # noqa: E402
from rotorfit.base.digits import significant  # noqa: E402
from rotorfit.identify.fitting.assumptions.shifts import assuming  # noqa: E402

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

LINES = 40
PROMISED = 0.85
MASSES = ("M", "Md", "Mb")
"""Names that share a column of the table."""


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
    gyroscopic: tuple[float, ...] = (0.0,)  # by plane, kg
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
        if not (self.lam_rise or self.K0_power):
            return self
        lam = self.lam * (1 + self.lam_rise * (speed / self.speed - 1))
        return replace(self, lam=lam, K0=self.K0 * (speed / self.speed) ** self.K0_power, lam_rise=0.0, K0_power=0.0)

    def stiffness(self, s: Complex, speed: float | Float) -> Complex:
        """Dynamic stiffness at the planes, shape ``(L, n, n)``: force over motion; one speed, or one a line."""
        if self.lam_rise or self.K0_power:
            return self.at(float(speed)).stiffness(s, speed)
        n = self.M.size
        shaft = self.K12 * np.array([[1.0, -1.0], [-1.0, 1.0]]) if n == 2 else np.zeros((1, 1))
        twist = shaft / self.K12 if n == 2 else np.ones((1, 1))
        s, speed = np.asarray(s, dtype=complex)[:, None, None], np.asarray(speed)[..., None, None]
        found = np.diag(self.K) + shaft + s * np.diag(self.Ds) + s**2 * np.diag(self.M)
        found = found + self.internal * (s - 1j * speed) * twist
        shape = 1 - self.rest**2
        ratio = self.lam * (1 - self.rest) ** self.exponents[2]
        slip = s - 1j * ratio * speed
        fluid = self.K0 * shape ** -self.exponents[0] + self.D * shape ** -self.exponents[1] * slip + self.Mf * slip**2
        fluid = fluid + self.damper * s
        found = found - 1j * speed * s * np.diag(np.broadcast_to(self.gyroscopic, n))
        found[:, -1, -1] += fluid[:, 0, 0]
        found[:, 0, 0] += self.second_seal * (self.K0 + self.D * (s - 1j * self.lam * speed))[:, 0, 0]
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
        """Values of the fluid, masses and threshold of the centred journal."""
        centred = replace(self, rest=0.0)
        speeds = np.geomspace(1.0, 5000.0, 60)
        first = next(k for k, speed in enumerate(speeds) if centred.growth(speed) > 0)
        onset = brentq(centred.growth, speeds[first - 1], speeds[first])
        masses = dict(zip(MASSES[1:] if self.M.size > 1 else MASSES, self.M.tolist(), strict=False))
        values = {"D": self.D, "lam": self.lam, "K0": self.K0, "Mf": self.Mf}
        return {**values, **masses, "threshold_speed": float(onset)}


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """How a rig is tested, and what readings go through."""

    speeds: tuple[float, ...] = (100.0, 180.0)  # rad/s
    directions: str = "z"  # of probes: "z", "x" or "xy"
    one_run: bool = False
    sigma_given: bool = True
    sigma_factor: float = 1.0  # that it is given off by
    memory: int = 1  # lines over which noise is a moving average
    wander: float = 0.0  # rms share by which the speed moves within a run, as logged
    refined: bool = False
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
    rig: Rig, test: Campaign, w: Float, speed: float | Float, force: Complex, largest: float
) -> tuple[Complex, Complex]:
    """Motion with the force and, conjugate, against it, each of shape ``(L, n)``."""
    n, kappa = rig.M.size, rig.stiffness(1j * w, speed)
    seal = rig if test.wander else rig.at(float(speed))
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


def _moving(rng: np.random.Generator, size: int, memory: int) -> Float:
    """Normal numbers of unit variance for both halves of the frequencies, averaged over neighbours."""
    halves = [np.convolve(rng.normal(size=size // 2 + memory - 1), np.ones(memory), "valid") for _ in range(2)]
    return np.concatenate(halves) / math.sqrt(memory)


def measured(rig: Rig, test: Campaign, rng: np.random.Generator) -> rf.PerturbationTest:
    """Responses of all planes to a force of 5 N at each, forward and backward; noise is common to no two probes."""
    if isinstance(rig, FiniteElements):
        return rig.rig.campaign(test.speeds, int(rng.integers(2**31)), lines=50)
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
            speeds = speed * (1 + test.wander * _moving(rng, w.size, 10)) if test.wander else np.full(w.size, speed)
            actual = speeds if test.wander else speed
            along, against = _forward(rig, test, w, actual, force, float(largest[-1]))
            for read, probe in enumerate(planes):
                for way in test.directions:
                    z = _read(test, way, w, along[:, read], against[:, read], float(largest[read]))
                    sigma = test.noise * float(np.sqrt(np.mean(np.abs(z) ** 2)))
                    spread = np.hypot(sigma, test.proportional * np.abs(z))
                    z = z + spread * (_moving(rng, w.size, test.memory) + 1j * _moving(rng, w.size, test.memory))
                    run = np.where(w > 0, f"{plane} {speed:g} forward", f"{plane} {speed:g} backward")
                    parts.append((np.full(w.size, "one") if test.one_run else run, speeds, plane, probe, way, z, sigma))
    return rf.perturbation_test(
        run=np.concatenate([p[0] for p in parts]),
        speed=np.concatenate([p[1] for p in parts]),
        frequency=np.tile(w, len(parts)),
        force_plane=np.repeat([p[2] for p in parts], w.size),
        force=5.0,
        plane=np.repeat([p[3] for p in parts], w.size),
        direction=np.repeat([p[4] for p in parts], w.size),
        response=np.concatenate([p[5] for p in parts]),
        **({"sigma": test.sigma_factor * np.repeat([p[6] for p in parts], w.size)} if test.sigma_given else {}),
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


@dataclass(frozen=True, kw_only=True)
class FiniteElements(Rig):
    """A shaft of finite elements with a disk and a journal, which no model of a few masses is."""

    rig: fe_rigs.Rig

    def growth(self, speed: float) -> float:
        """Largest real part of the eigenvalues, 1/s."""
        return float(self.rig.growth(speed))

    def truth(self) -> dict[str, float]:
        """Values of the fluid and threshold; masses and stiffness of a chain are none of this rotor."""
        return {"D": self.D, "lam": self.lam, "Mf": self.Mf, "threshold_speed": self.rig.threshold()}


def finite_elements(disk: int, rng: np.random.Generator) -> FiniteElements:
    """A shaft with its disk at a node of 14, values off the typical ones by a tenth."""
    values = {name: value * rng.normal(1.0, 0.1) for name, value in fe_rigs.TYPICAL.items()} | {"noise": 0.005}
    K0, D, lam, Mf = (values[name] for name in ("K0", "D", "lam", "Mf"))
    rig, none = fe_rigs.Rig(**values, disk=disk), np.zeros(0)
    return FiniteElements(rig=rig, M=none, Ds=none, K=none, K12=0, K0=K0, D=D, lam=lam, Mf=Mf, known={"K3": fe_rigs.K3})


middle = partial(finite_elements, fe_rigs.DISK)
near_bearing = partial(finite_elements, 4)
"""Disks in the middle of the span and at 0.29 of it."""

Kind = Callable[[np.random.Generator], Rig]

MODELS: dict[Kind, Callable[..., rf.models.RotorModel]] = {
    one_mode: rf.models.OneMode,
    chain: rf.models.WhirlWhip,
    middle: rf.models.WhirlWhip,
    near_bearing: rf.models.WhirlWhip,
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


def _gyroscopic(
    rig: Rig, rng: np.random.Generator, effect: tuple[float, ...], speeds: tuple[float, ...] = (100.0, 180.0)
) -> tuple[Rig, Campaign]:
    """A large disk that the model takes for a point."""
    return replace(rig, gyroscopic=effect), Campaign(speeds=speeds)


CAUSES: dict[str, tuple[Kind, Draw]] = {
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
    "gyroscopic effect, 6 % of M, one speed": (
        one_mode,
        lambda rig, rng: (replace(rig, gyroscopic=(abs(rng.normal(0, 0.06)) * rig.M[0],)), Campaign(speeds=(180.0,))),
    ),
    "gyroscopic effect, 0.3 kg, one mode": (one_mode, partial(_gyroscopic, effect=(0.3,))),
    "gyroscopic effect, 0.1 kg, one mode": (one_mode, partial(_gyroscopic, effect=(0.1,))),
    "gyroscopic effect, 0.1 kg at the disk, chain": (chain, partial(_gyroscopic, effect=(0.1, 0.0))),
    "gyroscopic effect, 0.05 kg at the journal, chain": (chain, partial(_gyroscopic, effect=(0.0, 0.05))),
    **{
        f"finite elements, disk {where}, {words}": (kind, partial(_read_through, speeds=speeds, refined=True))
        for where, kind in (("in the middle", middle), ("at 0.29 of the span", near_bearing))
        for words, speeds in (("two speeds", (100.0, 180.0)), ("one speed", (100.0,)))
    },
    "finite elements, disk at 0.29 of the span, two speeds, as printed": (near_bearing, _read_through),
    "finite elements, disk at 0.29 of the span, one speed, as printed": (
        near_bearing, partial(_read_through, speeds=(100.0,)),
    ),
    "lam +5 % a half threshold, four speeds": (one_mode, partial(_with_speed, lam_rise=0.05)),
    "lam +5 % a half threshold, four speeds, chain": (chain, partial(_with_speed, lam_rise=0.05)),
    "lam +5 % a half threshold, two speeds": (one_mode, partial(_with_speed, shares=(0.4, 0.7), lam_rise=0.05)),
    "lam +5 % a half threshold, one speed": (one_mode, partial(_with_speed, shares=(0.5,), lam_rise=0.05)),
    "K0 as speed^0.3, four speeds": (one_mode, partial(_with_speed, K0_power=0.3)),
    "K0 as speed^0.3, two speeds": (one_mode, partial(_with_speed, shares=(0.4, 0.7), K0_power=0.3)),
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
    "noise in proportion, 1 %, and correlated": (
        one_mode, partial(_read_through, proportional=0.01, memory=3, sigma_given=False),
    ),
    "noise in proportion, 1 %, and correlated, chain": (
        chain, partial(_read_through, proportional=0.01, memory=3, sigma_given=False),
    ),
    "noise correlated, sigma given half": (one_mode, partial(_read_through, memory=3, sigma_factor=0.5)),
    "noise correlated, sigma given double": (one_mode, partial(_read_through, memory=3, sigma_factor=2.0)),
    "force jitters and gain scatters by 1 %": (
        one_mode, partial(_read_through, jitter=0.01, gain_scatter=0.01, sigma_given=False),
    ),
    **{
        f"speed wanders by {100 * wander:g} %, {words}": (
            one_mode, partial(_read_through, wander=wander, directions=ways, noise=0.0005, sigma_given=False),
        )
        for wander in (0.0002, 0.003, 0.01)
        for words, ways in (("one probe", "x"), ("both probes", "xy"))
    },
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
    printed: float  # of the intervals that are given; NaN if no fit gives the number
    found: float  # of plausible sizes none, but causes that were found
    statistical: float
    given: float  # share of the fits that give the number
    half: float  # median of the printed half width, over the value
    wider: float  # median of the printed width over the statistical one
    named: float  # share of the rigs of which the fit says the cause; of those without one, that are given any
    limited: float  # share of the rigs of which the fit says that its model limits it
    stable: float  # share of the unstable running speeds called stable with more than 95 %


def study(cause: str, rigs: int, seed: int) -> list[Row]:
    """Coverage under one cause."""
    rng = np.random.default_rng(seed)
    kind, draw = CAUSES[cause]
    expected = [name for start, name in NAMES.items() if cause.startswith(start)]
    held, widths, stands, named, limited, stable = [], [], [], [], [], []
    names: list[str] = []
    for _ in range(rigs):
        rig, test = draw(kind(rng), rng)
        fit = rf.fit(MODELS[kind](**test.model), measured(rig, test, rng), known=rig.known)
        fit = rf.refine(fit).best if test.refined else fit
        truth = rig.truth()
        said = [cause.name for cause in fit.noise.causes] if fit.noise else []
        said += [entry.name for entry in fit.assumptions().entries if entry.name.startswith("supports by both")]
        plausible = {entry.name: 0.0 for entry in fit.assumptions().entries if entry.name not in said}
        alone = assuming(fit, plausible)
        names = list(truth)
        ends = np.array(
            [
                [one.interval(name, statistical=part) for name in names]
                for one, part in ((fit, False), (alone, False), (fit, True))
            ]
        )  # printed, of found causes alone or statistical; quantity, end
        values = np.array(list(truth.values()))
        stands.append([not fit.moved_by(name) for name in names] & np.isfinite(ends[0]).all(axis=-1))
        held.append((ends[..., 0] <= values) & (values <= ends[..., 1]))
        widths.append(np.diff(ends, axis=-1)[..., 0] / np.abs(values))
        limited.append(fit.model_limited)
        named.append(said[0].startswith(expected[0]) if said and expected else bool(said) and not expected)
        stable.append(_called_stable(fit, truth["threshold_speed"] * rng.uniform(1.02, 1.2)))
    holds, wide = np.array(held, dtype=float), np.array(widths)
    given = np.array(stands)
    with np.errstate(invalid="ignore"):
        printed = np.sum(holds[:, 0] * given, axis=0) / given.sum(axis=0)
        wider = np.median(wide[:, 0] / wide[:, 2], axis=0)
    return [
        Row(
            cause=cause,
            quantity=name,
            printed=printed[i],
            found=holds[:, 1, i].mean(),
            statistical=holds[:, 2, i].mean(),
            given=given[:, i].mean(),
            half=np.median(wide[:, 0, i]) / 2,
            wider=wider[i],
            named=float(np.mean(named)),
            limited=float(np.mean(limited)),
            stable=float(np.mean(stable)),
        )
        for i, name in enumerate(names)
    ]


def _called_stable(fit: rf.FitResult, speed: float) -> bool:
    """True if a fit is all but sure that the rotor is stable at a speed, rad/s."""
    report = fit.stability_report(max_speed_rpm=speed * 30 / math.pi)
    return any(one.name.startswith("threshold speed over") and one.probability > 0.95 for one in report.criteria)


def main() -> int:
    """Count, write, and say whether printed intervals hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=60, help="rigs of each cause [%(default)s]")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first cause [%(default)s]")
    parser.add_argument("--only", default="", help="rows that begin so, printed and not written")
    options = parser.parse_args()
    chosen = [(i, cause) for i, cause in enumerate(CAUSES) if cause.startswith(options.only)]
    rows = []
    for i, cause in chosen:
        rows += study(cause, options.rigs, options.seed + i)
        print(cause, file=sys.stderr, flush=True)
    command = f"python benchmarks/systematic_causes.py --rigs {options.rigs} --seed {options.seed}"
    where = environment("numpy", "scipy", "casadi")
    head = "# Coverage of 95 % intervals where something acts that the model lacks"
    lines = [head, "", f"`{command}`; {where}", "", *_table(rows), ""]
    if not options.only:
        write_csv(rows, RESULTS / "systematic_causes.csv", command, where)
        (RESULTS / "systematic_causes.md").write_text("\n".join(lines), encoding="utf-8")
    print("\n".join(lines))
    return int(any(row.printed < PROMISED for row in rows))


COLUMNS: dict[str, tuple[str, ...]] = {
    **{name: (name,) for name in ("D", "lam", "K0", "Mf")},
    "masses": MASSES,
    "threshold": ("threshold_speed",),
}
"""Quantities whose least coverage a column of the table shows."""


def _table(rows: list[Row]) -> list[str]:
    """A line for each cause: coverage as printed by quantity, least coverage without a share, and what fits say."""
    head = ["cause", *COLUMNS, "found causes alone", "statistical alone"]
    head += ["half width of D", "of lam", "of the threshold", "given", "named", "limited", "unstable called stable"]
    cells = []
    for cause in dict.fromkeys(row.cause for row in rows):
        own = {row.quantity: row for row in rows if row.cause == cause}
        some = own["D"]
        printed = {name: row.printed for name, row in own.items() if row.given}
        least = [min((printed[n] for n in names if n in printed), default=math.nan) for names in COLUMNS.values()]
        least += [min(row.found for row in own.values()), min(row.statistical for row in own.values())]
        half = [f"{significant(100 * own[name].half, 2)} %" for name in ("D", "lam", "threshold_speed")]
        last = [min(row.given for row in own.values()), some.named, some.limited, some.stable]
        shares = ["-" if math.isnan(share) else f"{share:.0%}" for share in (*least, *last)]
        cells.append([cause, *shares[:8], *half, *shares[8:]])
    return table(head, cells)


if __name__ == "__main__":
    sys.exit(main())
