"""A test that may be made: possible speeds, planes, directions and lines, limits of force and motion, and its time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import Float, Index
from rotorfit.base.digits import significant
from rotorfit.base.names import unknown_name
from rotorfit.base.units import RAD_S_PER_RPM, RPM_PER_RAD_S, in_rad_s
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import journals
from rotorfit.models.motion.stability import decay_rate
from rotorfit.studies.planning.expectation import refuse_speed


@dataclass(frozen=True, kw_only=True)
class Design:
    """Speeds, frequencies, planes and limits of a rotating-force test, for :func:`rotorfit.plan` to choose from.

    Attributes:
        speed_rpm: rotative speeds that are possible.
        frequency_rpm: frequencies of a sweep, positive.
        speed: the speeds in rad/s.
        frequency: the frequencies in rad/s.
        frequency_hz: the same in Hz.
        directions: ``forward`` and ``backward``, or one of them.
        force_planes: planes that can be forced; all of the model unless given.
        probes: planes that are read in x and y, or probes, ``"disk rx"``; all of the model unless given.
        force_N: largest force.
        mr_g_mm: unbalance of the perturbator, whose force is m r w^2, up to ``force_N``.
        clearance_share: largest motion at the fluid as a share of the clearance.
        clearance_um: radial clearance there; that of the model unless given.
        levels: shares of the largest force, each a run of its own: several tell how a fluid changes with eccentricity.
        speed_count: how many of the speeds can be run; all unless given.
        average_s: averaging time at each line in an even test, s: the noise of the plan is that of such a reading.
        sweep_rpm_per_s: rate of a sweep in place of dwells; a line then lasts as long as the sweep takes to the next.
        change_s: time to change to another run: speed, plane or direction, s.

    Example:
        >>> design = rf.Design(speed_rpm=[1000, 2000], frequency_rpm=[400, 800, 1200], force_N=5.0)
    """

    speed_rpm: ArrayLike | None = None
    frequency_rpm: ArrayLike | None = None
    speed: ArrayLike | None = None
    frequency: ArrayLike | None = None
    frequency_hz: ArrayLike | None = None
    directions: str | Sequence[str] = ("forward", "backward")
    force_planes: str | Sequence[str] | None = None
    probes: str | Sequence[str] | None = None
    force_N: float | None = None
    mr_g_mm: float | None = None
    clearance_share: float | None = None
    clearance_um: float | None = None
    levels: Sequence[float] = (1.0,)
    speed_count: int | None = None
    average_s: float = 1.0
    sweep_rpm_per_s: float | None = None
    change_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("speed_rpm", "frequency_rpm", "speed", "frequency", "frequency_hz"):
            value = getattr(self, name)  # lists compare as a whole
            object.__setattr__(self, name, value.tolist() if isinstance(value, np.ndarray) else value)
        for name in ("force_N", "mr_g_mm", "clearance_share", "clearance_um", "average_s", "sweep_rpm_per_s"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int | float) and 0 < value < math.inf):
                raise ValueError(f"{name} is {value!r}; it must be a positive number")
        if not (isinstance(self.change_s, int | float) and 0 <= self.change_s < math.inf):
            raise ValueError(f"change_s is {self.change_s!r}; it must be a time in s, zero or more")
        if self.clearance_share is not None and self.clearance_share >= 1:
            raise ValueError(
                f"clearance_share is {self.clearance_share:g}; the journal moves within its clearance: below 1"
            )
        if self.force_N is None and self.mr_g_mm is None and self.clearance_share is None:
            raise ValueError("a design needs a limit of the force: force_N, mr_g_mm or clearance_share")
        if not len(self.levels) or not all(isinstance(v, int | float) and 0 < v <= 1 for v in self.levels):
            raise ValueError(f"levels is {self.levels!r}; shares of the largest force are needed, above 0 and up to 1")
        if (self.speeds < 0).any():
            raise ValueError("speed_rpm must not be negative; directions of the force are relative to the rotation")
        if (self.frequencies <= 0).any():
            raise ValueError("frequency_rpm must be positive; directions= says which way the force turns")
        for one in self.words("directions"):
            if one not in SENSE:
                raise ValueError(unknown_name("direction", one, SENSE))
        count = self.speed_count
        if count is not None and not (isinstance(count, int) and 1 <= count <= self.speeds.size):
            raise ValueError(f"speed_count is {count!r} of {self.speeds.size} possible speeds")

    @property
    def speeds(self) -> Float:
        """Possible speeds, rad/s, ascending."""
        return _rates("speed", self.speed, rpm=self.speed_rpm)

    @property
    def frequencies(self) -> Float:
        """Frequencies of a sweep, rad/s, ascending."""
        return _rates("frequency", self.frequency, rpm=self.frequency_rpm, hz=self.frequency_hz)

    def words(self, name: str) -> tuple[str, ...]:
        """One word or several as a tuple.

        Args:
            name: of the attribute.
        """
        given = getattr(self, name)
        return (given,) if isinstance(given, str) else tuple(given)


SENSE = {"forward": 1.0, "backward": -1.0}
"""Sign of the frequency of each direction."""


def _rates(name: str, values: Any, **by_unit: Any) -> Float:
    given = {name: values, **{f"{name}_{unit}": one for unit, one in by_unit.items()}}
    told = ", ".join(f"{one}={value!r}" for one, value in given.items() if value is not None)
    rates = in_rad_s(name, values, **by_unit)
    try:
        found: Float = np.unique(np.atleast_1d(np.asarray(rates, dtype=float)))
    except (TypeError, ValueError):
        raise ValueError(f"{told}: numbers are needed") from None
    if not found.size or not np.isfinite(found).all():
        raise ValueError(f"{told}: finite numbers are needed, at least one")
    return found


_TRANSIENT = 0.01
"""Share of a transient that is left when a line is read, and of the lag behind a sweep."""


def candidate_test(design: Design, model: RotorModel, theta: Float, band: float) -> PerturbationTest:
    """All lines with forces as large as the limits allow, to be read; runs are named by plane, speed and direction.
    Eigenvalues up to a band count."""
    planes = model.planes if design.force_planes is None else design.words("force_planes")
    if model.turns:
        raise ValueError(
            f"{model.name} shows itself in images and twist, and a design has responses at the force's frequency "
            "only; give LineTests as patterns"
        )
    for plane in planes:
        if plane not in model.planes:
            raise ValueError(unknown_name(f"force plane of {model.name}", plane, model.planes))
    for speed in design.speeds.tolist():
        if decay_rate(model, theta, speed, band) < 0:
            refuse_speed(model, theta, speed, band)
    channels = _channels(design, model)
    columns: dict[str, list[Any]] = {}
    for plane, speed, way, level in product(planes, design.speeds.tolist(), design.words("directions"), design.levels):
        w = SENSE[way] * design.frequencies
        name = f"{plane} {speed * RPM_PER_RAD_S:.5g} rpm {way}" + (f" {level:.0%}" if len(design.levels) > 1 else "")
        force = level * _force(design, model, theta, plane, speed, w)
        for where, direction in channels:
            for key, cell in (
                ("run", name), ("speed", speed), ("frequency", w), ("force_plane", plane), ("force", force),
                ("plane", where), ("direction", direction),
            ):  # fmt: skip
                columns.setdefault(key, []).append(np.broadcast_to(np.asarray(cell), w.shape))
    whole: dict[str, Any] = {key: np.concatenate(parts) for key, parts in columns.items()}
    unread = np.full(whole["speed"].size, np.nan)
    return PerturbationTest(**whole, response=unread + 0j, sigma=unread, source="design")


def _channels(design: Design, model: RotorModel) -> list[tuple[str, str]]:
    own = [
        (c.plane, direction)
        for c in model.coordinates
        if c.plane in model.read_planes
        for direction in ({"z": ("x", "y"), "r": ("rx", "ry")}.get(c.axis, (c.axis,)))
    ]
    if design.probes is None:
        return own
    found: list[tuple[str, str]] = []
    for name in design.words("probes"):
        plane, _, direction = name.rpartition(" ")
        named = [one for one in own if one == (plane, direction) or (one[0] == name and one[1] in "xy")]
        if not named:
            raise ValueError(unknown_name(f"probe of {model.name}", name, [*model.planes, *map(" ".join, own)]))
        found += named
    return list(dict.fromkeys(found))


def _force(design: Design, model: RotorModel, theta: Float, plane: str, speed: float, w: Float) -> Float:
    """Largest force at each line, N."""
    force = np.full(w.shape, math.inf if design.force_N is None else design.force_N)
    if design.mr_g_mm is not None:
        force = np.minimum(force, design.mr_g_mm * 1e-6 * w**2)
    if design.clearance_share is None:
        return force
    unit = model.force_vector(plane, w, np.ones(w.shape))
    # Of fluids that change with eccentricity, the force that keeps the journals at that eccentricity.
    receptance = model.receptance(theta, w, np.full(w.shape, speed), design.clearance_share)
    moved = np.abs(np.einsum("lij,lj->li", receptance, unit))
    for place in [seat.plane for seat in journals(model)] if model.eccentricity_dependent else model.planes[-1:]:
        clearance = model.clearance_at(place) if design.clearance_um is None else design.clearance_um * 1e-6
        if clearance is None:
            raise ValueError("clearance_share needs clearance_um: the model knows no clearance")
        at = [i for i, c in enumerate(model.coordinates) if c.plane == place and c.axis != "r"]
        force = np.minimum(force, design.clearance_share * clearance / moved[:, at].max(axis=1))
    return np.asarray(force)


def line_times(
    design: Design, model: RotorModel, theta: Float, test: PerturbationTest, first: Index, band: float
) -> tuple[Float, Float]:
    """Times to settle and to average at lines of the test, given by their first rows, s."""
    speed, w = test.speed[first], test.frequency[first]
    if design.sweep_rpm_per_s is not None:
        steps = np.gradient(design.frequencies) if design.frequencies.size > 1 else np.zeros(1)
        order = np.searchsorted(design.frequencies, np.abs(w))
        return np.zeros(w.size), steps[order] / (design.sweep_rpm_per_s * RAD_S_PER_RPM)
    distinct, number = np.unique(speed, return_inverse=True)
    decay = np.array([float(decay_rate(model, theta, one, band)) for one in distinct.tolist()])
    return math.log(1 / _TRANSIENT) / decay[number], np.full(w.size, design.average_s)


def too_fast(design: Design, model: RotorModel, theta: Float, band: float) -> str:
    """A sentence where the sweep is too fast for the vibration to follow; else empty. A response swept at the rate r
    lags behind by about ``r / decay^2`` of itself at a resonance."""
    if design.sweep_rpm_per_s is None:
        return ""
    decay = min(float(decay_rate(model, theta, one, band)) for one in design.speeds.tolist())
    limit = _TRANSIENT * decay**2 * RPM_PER_RAD_S
    if design.sweep_rpm_per_s <= limit:
        return ""
    return (
        f"Sweep more slowly: at {significant(design.sweep_rpm_per_s, 3)} rpm/s the vibration lags by more "
        f"than {_TRANSIENT:.0%}; up to {significant(limit, 2)} rpm/s it follows."
    )
