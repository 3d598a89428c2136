"""Do printed errors hold the truth where many causes act at once, and are they no wider than they must be?

    python benchmarks/error_populations.py --rigs 60

writes results/error_populations.md and .csv. Rigs are equations written out here: masses on a line of springs, one of
them in a fluid, three rotors of 1.2 to 80 kg with values up to 12 % off the typical ones. Causes act in full and not to
first order: each of the fit's list for that rig, drawn from a normal distribution of its size, or half of one where it
is never negative, times the factor of the row, with as many rigs in each part of the distribution. Values that change
are those at the mean tested speed and in the middle of a sweep; the threshold is that of the rig with its causes. Exit
status 1 says that a row of at most usual sizes, two speeds and both directions, has less than PROMISED in some column.
"""

from __future__ import annotations

import argparse
import csv
import math
import re
import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))

from reporting import RESULTS, environment, table, write_csv

import rotorfit as rf

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

LINES = 25
"""Lines of a sweep."""
NOISE = 0.005
"""Standard deviation of real and imaginary part over the rms of a sweep's readings."""
PROMISED = 0.88
OUTPUTS = ("D", "lam", "M", "K0", "Mf", "threshold")

# ---- rigs ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Rotor:
    """Masses on a line of springs from bearing to bearing, the last one in a fluid that turns."""

    planes: tuple[str, ...]
    M: Float  # kg, shape ``(n,)``
    K: Float  # N/m, from the first bearing to the last, shape ``(n + 1,)``
    Ds: Float  # external dampers, N s/m
    K0: float
    D: float
    lam: float
    Mf: float
    law: tuple[float, float, float] | None = None  # exponents of K0, D and lam in eccentricity
    clearance: float = 0.0  # that is told, m

    def stiffness(
        self,
        s: Complex,
        speed: float,
        acting: Mapping[str, float],
        sweep: Sweep | None = None,
        eccentricity: Float | float = 0.0,
    ) -> Complex:
        """Dynamic stiffness, force over motion, shape ``(L, n, n)``, with causes by name.

        Args:
            s: complex frequency, rad/s.
            speed: true rotative speed, rad/s.
            acting: sizes of causes.
            sweep: how the rig was tested; without it nothing drifts.
            eccentricity: of the last mass on each line.
        """
        n, K, Ds = self.M.size, self.K.copy(), self.Ds.copy()
        for name in acting:
            if known := re.fullmatch(r"K(\d?)", name):
                K[int(known[1] or 1) - 1] += acting[name]
            elif known := re.fullmatch(r"Ds(\d?)", name):
                Ds[int(known[1] or 1) - 1] += acting[name]
        line = np.diag(K[:-1] + K[1:]) - np.diag(K[1:-1], 1) - np.diag(K[1:-1], -1)
        found = line + s[:, None, None] * np.diag(Ds) + (s**2)[:, None, None] * np.diag(self.M)
        found = found.astype(complex)
        beyond = 0.0 if sweep is None else speed / sweep.mean - 1
        rise = {k: 1 + acting.get(f"speed[{k}]", 0.0) * beyond for k in ("lam", "K0", "D")}
        K0, D, lam = self.K0 * rise["K0"], self.D * rise["D"], self.lam * rise["lam"]
        if self.law is not None:
            wide = 1 - np.asarray(eccentricity) ** 2
            K0, D = K0 * wide ** -self.law[0], D * wide ** -self.law[1]
            lam = lam * (1 - np.asarray(eccentricity)) ** self.law[2]
        if sweep is not None and "drift" in acting:
            D = D * (1 + acting["drift"] * sweep.progress(s.imag))
        slip = s - 1j * lam * speed
        found[:, -1, -1] += K0 + D * slip / (1 + acting.get("lag", 0.0) * slip) + self.Mf * slip**2
        found[:, 0, 0] += acting.get("loss", 0.0) * (s - 1j * speed)
        for name, size in acting.items():
            found += size * self._beside(name, s, speed).reshape(-1, n, n)
        return found

    def _beside(self, name: str, s: Complex, speed: float) -> Complex:
        """What a cause at planes adds, by a unit of its size."""
        kind, _, where = name.rstrip("]").partition("[")
        law = {
            "damper": s, "mass": s**2, "gyro": -1j * speed * s, "hysteresis": 1j * np.sign(s.imag), "q": s**4,
        }.get(kind)  # fmt: skip
        added = np.zeros((s.size, self.M.size, self.M.size), dtype=complex)
        if law is None or not where:
            return added
        at = [self.planes.index(plane) for plane in where.split(", ")]
        added[:, at[0], at[-1]] = added[:, at[-1], at[0]] = law
        return added

    def onset(self, acting: Mapping[str, float], sweep: Sweep | None = None) -> float:
        """Lowest speed at which it whirls without force, rad/s: that without causes, followed as these grow."""
        speed = self._first_onset()
        w = float(self._roots(speed)[-1].imag)
        at = np.array([w, speed])
        for share in np.linspace(0.1, 1, 10) if acting else [0.0]:
            part = {name: share * size for name, size in acting.items()}
            for _ in range(30):
                value = self._singular(at, part, sweep)
                columns = [
                    (self._singular(at * (1 + way), part, sweep) - value) / (1e-6 * own)
                    for way, own in ((np.array([1e-6, 0]), at[0]), (np.array([0, 1e-6]), at[1]))
                ]
                slope = np.array([[c.real for c in columns], [c.imag for c in columns]])
                step = np.linalg.solve(slope, [value.real, value.imag])
                at = at - step
                if np.abs(step / at).max() < 1e-11:
                    break
        return float(at[1])

    def _singular(self, at: Float, acting: Mapping[str, float], sweep: Sweep | None) -> complex:
        found = self.stiffness(np.array([1j * at[0]]), float(at[1]), acting, sweep)[0]
        size = np.sqrt(np.abs(np.diag(self.stiffness(np.array([0j]), 0.0, {})[0])))
        return complex(np.linalg.det(found / np.outer(size, size)))

    def _roots(self, speed: float) -> Complex:
        """Roots in s without causes, by growth."""
        n = self.M.size
        down, still, up = (self.stiffness(np.array([s]), speed, {})[0] for s in (-1.0 + 0j, 0j, 1.0 + 0j))
        C, M = (up - down) / 2, (up + down) / 2 - still
        inverse = np.linalg.inv(M)
        roots = np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ still, -inverse @ C]]))
        return np.asarray(roots[np.argsort(roots.real)])

    def _first_onset(self) -> float:
        natural = math.sqrt((self.K.sum() + self.K0) / self.M.min())
        speeds = np.geomspace(0.01 * natural, 100 * natural, 400)
        high = int(np.argmax([self._roots(speed)[-1].real > 0 for speed in speeds]))
        low, up = speeds[high - 1], speeds[high]
        for _ in range(50):
            middle = (low + up) / 2
            low, up = (low, middle) if self._roots(middle)[-1].real > 0 else (middle, up)
        return float(low)

    def value(self, name: str) -> float:
        """A value by the name that the model of such a rig has for it."""
        if name in ("K0", "D", "lam", "Mf"):
            return float(getattr(self, name))
        if name == "sigma":
            return 1.0
        symbol, place = name.rstrip("123456789db"), name.lstrip("MKDs")
        number = {"": 1, "d": 1, "b": self.M.size}.get(place) or int(place)
        return float({"M": self.M, "K": self.K, "Ds": self.Ds}[symbol][number - 1])

    @property
    def top(self) -> float:
        """Highest natural frequency without damping, rad/s."""
        n = self.M.size
        still = self.stiffness(np.zeros(1, dtype=complex), 0.0, {})[0].real
        mass = np.diag(self.M) + np.diag([0.0] * (n - 1) + [self.Mf])
        return math.sqrt(float(np.linalg.eigvals(np.linalg.inv(mass) @ still).real.max()))


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """How a rig is tested."""

    speeds: tuple[float, ...]  # told, rad/s
    low: float  # rad/s
    high: float
    both: bool  # directions of whirl

    @property
    def mean(self) -> float:
        """Mean tested speed."""
        return float(np.mean(self.speeds))

    def progress(self, w: Float) -> Float:
        """Place in a sweep, -1 to 1."""
        return np.asarray((np.abs(w) - (self.high + self.low) / 2) / ((self.high - self.low) / 2))


ROTORS: dict[str, list[dict[str, Any]]] = {
    "one mode": [
        {"M": [1.2], "K": [8e3, 0], "Ds": [8.0], "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4},
        {"M": [12.0], "K": [6e5, 0], "Ds": [80.0], "K0": 3e5, "D": 6e3, "lam": 0.42, "Mf": 2.5},
        {"M": [80.0], "K": [2e7, 0], "Ds": [1.2e3], "K0": 2.5e7, "D": 1e5, "lam": 0.48, "Mf": 15.0},
    ],
    "disk and journal": [
        {"M": [0.95, 0.3], "K": [14e3, 15e3, 6e3], "Ds": [3.0, 0], "K0": 1e4, "D": 450.0, "lam": 0.475, "Mf": 0.35},
        {"M": [12.0, 3.0], "K": [6e5, 8e5, 2e5], "Ds": [60.0, 0], "K0": 4e5, "D": 6e3, "lam": 0.44, "Mf": 3.0},
        {"M": [80.0, 15.0], "K": [2e7, 3e7, 5e6], "Ds": [900.0, 0], "K0": 2e7, "D": 1e5, "lam": 0.48, "Mf": 12.0},
    ],
    "chain of three": [
        {"M": [0.8, 0.7, 0.3], "K": [2e4, 2.5e4, 2e4, 6e3], "Ds": [3.0, 3.0, 0], "K0": 1e4, "D": 450.0, "lam": 0.475,
         "Mf": 0.35},
        {"M": [10.0, 8.0, 3.0], "K": [8e5, 1e6, 8e5, 2e5], "Ds": [50.0, 50.0, 0], "K0": 4e5, "D": 6e3, "lam": 0.44,
         "Mf": 3.0},
        {"M": [60.0, 50.0, 15.0], "K": [3e7, 4e7, 3e7, 5e6], "Ds": [800.0, 800.0, 0], "K0": 2e7, "D": 1e5, "lam": 0.48,
         "Mf": 12.0},
    ],
}  # fmt: skip
LAW, LAW_OF = "law of eccentricity", "one mode"
"""Rigs of the second kind with a fluid of Muszynska's law, at two levels of force."""
KINDS = (*ROTORS, LAW)
PLANES = {
    "one mode": ("journal",),
    LAW: ("journal",),
    "disk and journal": ("disk", "journal"),
    "chain of three": ("left", "disk", "journal"),
}


def rotor_of(kind: str, number: int, seed: int) -> Rotor:
    """The rig of that number: one of three rotors with values of its own."""
    rng = np.random.default_rng([seed, number, 1])
    typical = ROTORS[LAW_OF if kind == LAW else kind][number % 3]
    own = {name: np.asarray(value) * rng.uniform(0.88, 1.12, np.shape(value)) for name, value in typical.items()}
    values = {name: value if value.ndim else float(value) for name, value in own.items()}
    law = {"law": (2.0, 1.4, 0.5), "clearance": 200e-6} if kind == LAW else {}
    return Rotor(planes=PLANES[kind], **values, **law)


def model_of(kind: str) -> rf.models.RotorModel:
    """What is fitted."""
    planes = PLANES[kind]
    if kind == LAW:
        return rf.models.OneMode(planes, law=rf.models.Muszynska(), clearance_um=200.0)
    if kind == "one mode":
        return rf.models.OneMode(planes)
    return rf.models.WhirlWhip(planes) if len(planes) == 2 else rf.models.Chain(planes=planes, fluid=planes[-1])


def known_of(kind: str, rotor: Rotor, free: Iterable[str] = ()) -> dict[str, float]:
    """What the fit is told: what the fluid's stiffness and damping cannot be told from."""
    if kind in ("one mode", LAW):
        known = {"K": rotor.K[0], "Ds": rotor.Ds[0]}
    else:
        known = {"K3": rotor.K[2]} if kind == "disk and journal" else {"K4": rotor.K[3], "Ds3": 0.0}
    return {name: float(value) for name, value in known.items() if name not in free}


def truth_of(kind: str, rotor: Rotor, sweep: Sweep, acting: Mapping[str, float]) -> dict[str, float]:
    """True values of the outputs."""
    return {
        "D": rotor.D, "lam": rotor.lam, "M": float(rotor.M[0]), "K0": rotor.K0, "Mf": rotor.Mf,
        "threshold": rotor.onset({name: size for name, size in acting.items() if name != "drift"}, sweep),
    }  # fmt: skip


MASS = {"one mode": "M", LAW: "M", "disk and journal": "Md", "chain of three": "M1"}

# ---- tests -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Row:
    """One row of the table: what acts, on which rigs, in which tests."""

    kind: str = "one mode"
    speeds: int = 2
    both: bool = True  # directions of whirl
    factor: float = 0.0  # of the sizes of the list
    alone: str = ""  # the only kind of cause that acts; all where it is empty
    fixed: bool = False  # causes have their size times the factor, of either sign, and none is drawn
    runs: tuple[float, float] = (0.0, 0.0)  # gain and angle, rad, by which runs differ
    extra: Mapping[str, float] = field(default_factory=dict)  # causes of given sizes
    times: Mapping[str, float] = field(default_factory=dict)  # causes of so many times their size
    out: tuple[str, ...] = ()  # causes that are taken out of the list
    told: Mapping[str, float] = field(default_factory=dict)  # values told as known in place of the true ones
    free: tuple[str, ...] = ()  # values that are fitted though they may be known
    noise_told: bool = True
    foundation: float = 0.0  # compliance of a resonance in the band, of the rig's static compliance
    sizes: str = "usual"  # or "first": those of the first list of sizes
    gain: float | None = None  # size of the gain that the fit is given
    film: bool = False  # a full film of a short bearing, of which the fit knows the clearance and no law
    rest: float = 0.0  # square of the eccentricity at which the journal of a short bearing rests, given


def sweep_of(rotor: Rotor, row: Row) -> Sweep:
    """Speeds by the threshold, a band that holds the highest mode."""
    onset, high = rotor.onset({}), 1.5 * rotor.top
    shares = (0.45, 0.75) if row.speeds == 2 else (0.6,)
    return Sweep(speeds=tuple(share * onset for share in shares), low=0.05 * high, high=high, both=row.both)


def responses(rotor: Rotor, sweep: Sweep, acting: Mapping[str, float], row: Row, rng: np.random.Generator) -> Any:
    """A test of the rig with its causes."""
    n, size = rotor.M.size, np.linspace(sweep.low, sweep.high, LINES)
    by_run, told = [], []
    for speed, level, forced, way in product(
        sweep.speeds, _levels(rotor, sweep), sorted({0, n - 1}), (1, -1) if sweep.both else (1,)
    ):
        w = way * size
        z = _motion(rotor, sweep, acting, row, w, speed, forced, level)
        turn = acting.get("turned", 0.0) + way * acting.get("phase", 0.0)
        late = acting.get("delay", 0.0) + acting.get("clock", 0.0) * sweep.progress(w)
        z = z * (np.exp(1j * turn - 1j * w * late) / (1 + acting.get("high-pass", 0.0) / (1j * w)))[:, None]
        gain, angle = np.array(row.runs) * rng.normal(size=2)
        by_run.append(z * np.exp(acting.get("gain", 0.0)) * (1 + gain) * np.exp(1j * way * angle))
        told.append((speed, level, forced, w))
    largest = np.max(np.abs(by_run), axis=(0, 1))
    columns: dict[str, list[Any]] = {
        key: [] for key in ("run", "speed", "frequency", "force_plane", "force", "plane", "response", "sigma")
    }
    for z, (speed, level, forced, w) in zip(by_run, told, strict=True):
        for at, plane in enumerate(rotor.planes):
            read = z[:, at] * (1 + acting.get(f"curve[{plane}]", 0.0) * (np.abs(z[:, at]) / largest[at]) ** 2)
            read = read * np.exp(acting.get(f"gain[{plane}]", 0.0))
            sigma = NOISE * float(np.sqrt(np.mean(np.abs(read) ** 2)))
            read = read + sigma * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
            run = f"{rotor.planes[forced]} {speed:.4g} {level:.3g} {'forward' if w[0] > 0 else 'backward'}"
            cells = (run, speed, w, rotor.planes[forced], level, plane, read, sigma)
            for key, cell in zip(columns, cells, strict=True):
                columns[key].append(np.broadcast_to(np.asarray(cell), w.shape))
    whole = {key: np.concatenate(parts) for key, parts in columns.items()}
    if not row.noise_told:
        del whole["sigma"]
    return rf.perturbation_test(direction="z", **whole)


def _levels(rotor: Rotor, sweep: Sweep) -> tuple[float, ...]:
    """Forces, N: one newton, or by a law two, of which the larger moves the journal by a third of the clearance."""
    if rotor.law is None:
        return (1.0,)
    w = np.linspace(sweep.low, sweep.high, 200)
    largest = max(float(np.abs(1 / rotor.stiffness(1j * w, speed, {})).max()) for speed in sweep.speeds)
    return 0.1 * rotor.clearance / largest, 0.35 * rotor.clearance / largest


def _motion(
    rotor: Rotor, sweep: Sweep, acting: Mapping[str, float], row: Row, w: Float, speed: float, forced: int, level: float
) -> Complex:
    """Motion at the probes for a force at a plane, shape ``(L, n)``."""
    n, planes = rotor.M.size, rotor.planes
    true = speed * (1 + acting.get("speed label", 0.0))
    force = np.zeros(n)
    towards = [k + 1 if k + 1 < n else k - 1 for k in range(n)]
    off = acting.get(f"force[{planes[forced]}]", 0.0)
    force[forced] = level * (1 - off)
    if off:
        force[towards[forced]] += level * off
    z = np.linalg.inv(rotor.stiffness(1j * w, true, acting, sweep)) @ force
    gap = rotor.clearance * (1 + acting.get("clearance", 0.0))
    for _ in range(60 if rotor.law else 0):
        there = rotor.stiffness(1j * w, true, acting, sweep, np.abs(z[:, -1]) / gap)
        z = (z + np.linalg.inv(there) @ force) / 2
    z[:, forced] += level * acting.get(f"flex[{planes[forced]}]", 0.0)
    if row.foundation:  # a pedestal that resonates in the band, with 2 % damping, moves the probe of the forced plane
        place = 0.6 * sweep.high
        static = abs(np.linalg.inv(rotor.stiffness(np.zeros(1, dtype=complex), true, {})[0])[forced, forced])
        z[:, forced] += level * row.foundation * static / (1 - (w / place) ** 2 + 0.04j * w / place)
    read = z.copy()
    for at, plane in enumerate(planes):
        off = acting.get(f"probe[{plane}]", 0.0)
        if off:
            read[:, at] = (1 - off) * z[:, at] + off * z[:, towards[at]]
    return np.asarray(read)


FIRST = {
    "gain[": 1 / 2, "phase": 1 / 2, "damper[": 2 / 5, "gyro[": 3 / 2, "drift": 1 / 2,
}  # fmt: skip
"""The first list of sizes over the one in use, by the beginning of the name."""


def given_sizes(row: Row, listed: Mapping[str, tuple[float, bool]], sweep: Sweep) -> dict[str, float]:
    """Sizes that the fit is given."""
    given = {name: 0.0 for name in (*listed, *row.extra) if name.partition("[")[0] in row.out}
    if row.sizes == "first":
        planes = sum(name.startswith("gain[") for name in listed)
        for name, (size, _) in listed.items():
            if "," in name:
                continue
            factor = next((f for begin, f in FIRST.items() if name.startswith(begin)), 1.0)
            if name == "gain":
                factor = 2 / 3 if planes else math.hypot(0.02, 0.01) / math.hypot(0.03, 0.02)
            if name in ("delay", "clock"):
                factor = 2 * math.pi * 100 / sweep.high
            if name.startswith("damper["):
                factor *= math.sqrt(max(planes, 1))
            if name == "flex[journal]" and planes:
                factor = 1 / 3
            if factor != 1:
                given[name] = factor * size
    if row.rest:
        given["rest[journal]"] = row.rest
    if row.gain is not None:
        given |= {name: row.gain for name in listed if name.startswith("gain")}
    return given


@lru_cache(maxsize=4096)
def usual_sizes(kind: str, number: int, seed: int, speeds: int, both: bool, free: tuple[str, ...]) -> Any:
    """Sizes of the list for a rig, as the fit of readings without causes prints them, and which are never negative."""
    row = Row(kind=kind, speeds=speeds, both=both)
    rotor = rotor_of(kind, number, seed)
    sweep = sweep_of(rotor, row)
    test = responses(rotor, sweep, {}, row, np.random.default_rng([seed, number, 2]))
    fit = rf.fit(model_of(kind), test, known=known_of(kind, rotor, free), causes={})
    return {cause.name: (cause.size, cause.one_sided) for cause in fit.settings.solved.causes}


# ---- fits ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Found:
    """A fit of one rig against its truth, all relative to it."""

    error: Float  # of the outputs, shape ``(6,)``
    plain: Float
    deviation: Float  # printed
    low: Float  # lower end of the interval less the estimate
    high: Float
    false: tuple[str, ...]  # causes named that do not act
    right: int  # causes that act by three sizes or alone and are named
    pull: float  # mean square of pulls
    redchi: float

    @property
    def held(self) -> NDArray[np.bool_]:
        """Where the interval holds the truth."""
        return np.asarray((self.error + self.low <= 0) & (self.error + self.high >= 0))


def acting_in(
    row: Row,
    number: int,
    seed: int,
    listed: Mapping[str, tuple[float, bool]],
    sizes: Mapping[str, float],
    rigs: int = 60,
) -> dict[str, float]:
    """Sizes of the causes that act on a rig of so many, each cause with one rig in each part of its distribution."""
    acting = {}
    for place, (name, (size, positive)) in enumerate(listed.items()):
        rng = np.random.default_rng([seed, 3, KINDS.index(row.kind) + 1, place])
        unit = NormalDist().inv_cdf((rng.permutation(rigs)[number] + rng.random(rigs)[number]) / rigs)
        unit = math.copysign(1.0, unit) if row.fixed else unit
        drawn = row.factor * sizes.get(name, size) * (abs(unit) if positive else unit)
        if drawn and (not row.alone or name.startswith(row.alone)):
            acting[name] = drawn
    acting |= row.extra
    acting |= {name: times * listed[name][0] for name, times in row.times.items()}
    return acting


def found_in(row: Row, number: int, seed: int, rigs: int = 60) -> Found:
    """Draw a rig, test and fit it."""
    rotor = rotor_of(row.kind, number, seed)
    sweep = sweep_of(rotor, row)
    listed = usual_sizes(row.kind, number, seed, row.speeds, row.both, row.free)
    given = given_sizes(row, listed, sweep)
    acting = acting_in(row, number, seed, listed, given if row.sizes == "first" else {}, rigs)
    if row.told:
        name, share = next(iter(row.told.items()))
        rotor = replace(rotor, Ds=np.array([share * rotor.D]))
        known = known_of(row.kind, rotor) | {name: 0.0}
    else:
        known = known_of(row.kind, rotor, row.free)
    tested = replace(rotor, D=(1 + 3 * row.rest) * rotor.D)
    if row.film:
        tested = replace(tested, law=(0.0, 1.5, 0.0), clearance=200e-6)
    test = responses(tested, sweep, acting, row, np.random.default_rng([seed, number, 4]))
    model = rf.models.OneMode(rotor.planes, clearance_um=200.0) if row.film else model_of(row.kind)
    fit = rf.fit(model, test, known=known, causes=given)
    truth = truth_of(row.kind, rotor, sweep, acting)
    threshold = fit.threshold_speed()
    numbers = [fit.params[MASS[row.kind] if name == "M" else name] for name in OUTPUTS[:-1]]
    plain = {name: fit.params[MASS[row.kind] if name == "M" else name].plain for name in OUTPUTS[:-1]}
    printed = [*numbers, threshold]
    true = np.array([truth[name] for name in OUTPUTS])
    value = np.array([p.value for p in printed])
    ends = np.array([p.interval(0.95) for p in printed])
    solved = fit.settings.solved
    named = {cause.name for cause in fit.causes.found}
    told = solved.errors.determined > 0.3
    return Found(
        error=value / true - 1,
        plain=np.array([*plain.values(), _plain_onset(row.kind, rotor, fit)]) / true - 1,
        deviation=np.array([p.stderr for p in printed]) / true,
        low=ends[:, 0] / true - value / true,
        high=ends[:, 1] / true - value / true,
        false=tuple(sorted(named - set(acting))),
        right=len(named & set(acting)),
        pull=float(np.mean(solved.errors.pull[told] ** 2)) if told.any() else math.nan,
        redchi=float(fit.redchi),
    )


def _plain_onset(kind: str, rotor: Rotor, fit: Any) -> float:
    """Threshold by the values of the plain fit, by the equations of this file."""
    value = {name: p.plain if p.vary else p.value for name, p in fit.params.items()}
    K = [value["K"], 0.0] if len(rotor.M) == 1 else [value[f"K{k + 1}"] for k in range(rotor.K.size)]
    M = [value[name] for name in {1: ["M"], 2: ["Md", "Mb"]}.get(len(rotor.M), ["M1", "M2", "M3"])]
    Ds = [value.get("Ds", 0.0), 0.0][: rotor.M.size]
    if kind == "chain of three":
        Ds = [value[f"Ds{k + 1}"] for k in range(3)]
    own = replace(
        rotor, M=np.array(M), K=np.array(K), Ds=np.array(Ds), K0=value["K0"], D=value["D"], lam=value["lam"],
        Mf=value["Mf"],
    )  # fmt: skip
    try:
        return own.onset({})
    except (np.linalg.LinAlgError, ValueError):  # no rotor that could be
        return math.nan


# ---- the table -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Line:
    """A row of the table, each output's number in the order of OUTPUTS, joined by spaces."""

    row: str
    rigs: int
    covered: str  # share whose 95 % interval holds the truth, %
    printed_over_true: str  # one over the root mean square of error over printed standard error
    half_width: str  # median half width of the 95 % interval, %
    rms_joint: str  # root mean square error, %
    rms_plain: str
    false_names: int  # rigs with a cause named that does not act
    named: int  # rigs with one that does
    pull: float  # root mean square of pulls of causes that the data tell
    misfits: int  # rigs with redchi above 1.3
    seconds: float  # per rig


def line_of(name: str, row: Row, rigs: int, seed: int) -> tuple[Line, list[Found]]:
    """Fit the rigs of a row."""
    begin = time.perf_counter()
    found = [found_in(row, number, seed, rigs) for number in range(rigs)]
    seconds = (time.perf_counter() - begin) / rigs
    error, plain, deviation = (np.array([getattr(f, k) for f in found]) for k in ("error", "plain", "deviation"))
    held = np.array([f.held for f in found])
    half = np.array([(f.high - f.low) / 2 for f in found])
    pulls = np.array([f.pull for f in found])

    def cells(values: Float, form: str) -> str:
        return " ".join(format(value, form) for value in values)

    return Line(
        row=name,
        rigs=rigs,
        covered=cells(100 * held.mean(axis=0), ".0f"),
        printed_over_true=cells(1 / np.sqrt(np.nanmean((error / deviation) ** 2, axis=0)), ".2g"),
        half_width=cells(100 * np.nanmedian(half, axis=0), ".2g"),
        rms_joint=cells(100 * np.sqrt(np.nanmean(error**2, axis=0)), ".2g"),
        rms_plain=cells(100 * np.sqrt(np.nanmean(plain**2, axis=0)), ".2g"),
        false_names=sum(bool(f.false) for f in found),
        named=sum(bool(f.right) for f in found),
        pull=float(np.sqrt(np.nanmean(pulls))),
        misfits=sum(f.redchi > 1.3 for f in found),
        seconds=seconds,
    ), found


ALONE = (
    "K", "gain", "turned", "phase", "delay", "high-pass", "clock", "curve", "damper", "loss", "hysteresis", "gyro",
    "speed label", "speed[lam]", "speed[K0]", "speed[D]", "drift", "lag", "flex", "probe", "force", "mass", "q",
)  # fmt: skip
"""Beginnings of the names of causes that act alone."""
BOUNDED = ("turned", "phase", "curve", "speed[lam]", "speed[K0]", "speed[D]", "drift")
"""Those that two speeds and both directions tell."""


def _rows() -> dict[str, Row]:
    rows: dict[str, Row] = {}
    for kind in KINDS:
        for speeds, both in ((2, True), (1, True), (2, False), (1, False)):
            design = f"{speeds} speed{'s' * (speeds > 1)}, {'both directions' if both else 'forward'}"
            for factor in (0.0, 0.2, 0.5, 1.0, 2.0):
                acting = "nothing acts" if not factor else f"all at {factor:g}"
                rows[f"{kind}, {design}, {acting}"] = Row(kind=kind, speeds=speeds, both=both, factor=factor)
        for factor in (0.0, 0.5, 1.0):
            rows[f"{kind}, sizes of the first list, all at {factor:g}"] = Row(kind=kind, factor=factor, sizes="first")
        for cause in ALONE:
            if kind in ("one mode", LAW) and cause in ("probe", "force", "mass", "q"):
                continue
            rows[f"{kind}, {cause} alone at 1"] = Row(kind=kind, factor=1.0, alone=cause)
            if cause in BOUNDED:
                rows[f"{kind}, {cause} alone, three sizes"] = Row(kind=kind, factor=3.0, alone=cause, fixed=True)
        rows[f"{kind}, runs differ by 0.5 %, 0.5 deg, nothing else"] = Row(kind=kind, runs=RUNS)
        rows[f"{kind}, runs differ by 0.5 %, 0.5 deg, all at 0.5"] = Row(kind=kind, runs=RUNS, factor=0.5)
        rows[f"{kind}, noise not told, all at 0.5"] = Row(kind=kind, noise_told=False, factor=0.5)
        rows[f"{kind}, gains calibrated to 0.5 %, nothing acts"] = Row(kind=kind, gain=0.005)
        rows[f"{kind}, common gain 1.5 %"] = Row(kind=kind, extra={"gain": 0.015})
        rows[f"{kind}, phase reference 2 deg, forward"] = Row(kind=kind, both=False, extra={"phase": math.radians(2)})
        rows[f"{kind}, AC coupling 0.5 Hz"] = Row(kind=kind, extra={"high-pass": math.pi})
        rows[f"{kind}, AC coupling 0.5 Hz, not listed"] = Row(
            kind=kind, extra={"high-pass": math.pi}, out=("high-pass",)
        )
        rows[f"{kind}, lag 3 deg"] = Row(kind=kind, times={"lag": 1.5})
        for times in (1.0, 5.0):
            rows[f"{kind}, flex at {times:g}, listed"] = Row(kind=kind, times={"flex[journal]": times})
            rows[f"{kind}, flex at {times:g}, not listed"] = Row(
                kind=kind, times={"flex[journal]": times}, out=("flex",)
            )
            rows[f"{kind}, foundation {times:g} % in the band"] = Row(kind=kind, foundation=times / 100)
    rows["one mode, film of a short bearing"] = Row(film=True, extra={"film": 1.5})
    rows["one mode, film of a short bearing, not listed"] = Row(film=True, extra={"film": 1.5}, out=("film",))
    rows["one mode, at rest off the centre, listed"] = Row(rest=0.04, extra={"rest[journal]": 0.04})
    rows["one mode, damper 3 % told as known 0"] = Row(told={"Ds": 0.03})
    for factor in (0.0, 0.5, 1.0):
        rows[f"one mode, Ds fitted, all at {factor:g}"] = Row(factor=factor, free=("Ds",))
    return rows


RUNS = (0.005, math.radians(0.5))
"""Scatter of the gain and the angle from run to run."""
ROWS = _rows()


def main() -> int:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rows", default="", help="regular expression that the names of rows match")
    parser.add_argument("--keep", action="store_true", help="keep the other rows of the table as they are")
    parser.add_argument("--out", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    lines = read_lines(arguments.out / "error_populations.csv") if arguments.keep else {}
    for name, row in ROWS.items():
        if re.search(arguments.rows, name):
            lines[name], _ = line_of(name, row, arguments.rigs, arguments.seed)
            print(lines[name], flush=True)
            write([lines[name] for name in ROWS if name in lines], arguments)
    main_rows = (line for name, line in lines.items() if re.search(r"2 speeds.*(nothing|0\.2|0\.5|1$)", name))
    return int(any(min(map(float, line.covered.split())) < 100 * PROMISED for line in main_rows))


def read_lines(path: Path) -> dict[str, Line]:
    """Rows of a table written before."""
    if not path.exists():
        return {}
    with path.open(newline="", encoding="utf-8") as stream:
        found = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    kinds = {"row": str, "rigs": int, "false_names": int, "named": int, "misfits": int, "pull": float, "seconds": float}
    return {one["row"]: Line(**{name: kinds.get(name, str)(value) for name, value in one.items()}) for one in found}


def write(lines: list[Line], arguments: argparse.Namespace) -> None:
    """The results as files."""
    command = f"python benchmarks/error_populations.py --seed {arguments.seed}"
    write_csv(lines, arguments.out / "error_populations.csv", command, environment("numpy"))
    header = (
        "Row", "Rigs", "Covered, %", "Printed over true", "Half width, %", "Rms error, %", "Plain, %", "False names",
        "Named", "Pull", "Misfits",
    )  # fmt: skip
    cells = [
        [
            line.row, str(line.rigs), line.covered, line.printed_over_true, line.half_width, line.rms_joint,
            line.rms_plain, str(line.false_names), str(line.named), f"{line.pull:.2f}", str(line.misfits),
        ]
        for line in lines
    ]  # fmt: skip
    text = [
        "# Errors of rigs on which many causes act at once",
        "",
        f"`{command}`; {environment('numpy')}. Columns of six numbers are D, lam, M, K0, Mf and the threshold.",
        "",
        *table(header, cells),
    ]
    (arguments.out / "error_populations.md").write_text("\n".join(text) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
