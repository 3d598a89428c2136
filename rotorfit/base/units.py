"""Units at the edges: how a column name such as ``amplitude_mil_pp`` turns into a factor to SI.

Everything inside rotorfit is SI with 0-peak amplitudes; only readers, writers and plots multiply by these factors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorfit.base.digits import significant
from rotorfit.base.names import unknown_name

RAD_S_PER_RPM = math.pi / 30
RPM_PER_RAD_S = 30 / math.pi

STANDARD_GRAVITY = 9.80665
"""m/s^2, by definition."""

_LENGTH = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "in": 0.0254, "mil": 25.4e-6}
ANGLE = {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": math.pi / 180}
_PEAK = {"": 1.0, "_pk": 1.0, "_0p": 1.0, "_pp": 0.5, "_rms": math.sqrt(2.0)}
"""Suffix that tells how an amplitude was taken, and its factor to 0-peak; no suffix means 0-peak."""


def _amplitudes(units: dict[str, float]) -> dict[str, float]:
    return {unit + peak: factor * share for unit, factor in units.items() for peak, share in _PEAK.items()}


UNITS: dict[str, dict[str, float]] = {
    "frequency": {"rad_s": 1.0, "hz": 2 * math.pi, "rpm": RAD_S_PER_RPM, "cpm": RAD_S_PER_RPM},
    "length": _LENGTH,
    "displacement": _amplitudes(_LENGTH),
    "tilt": _amplitudes(ANGLE),
    "velocity": _amplitudes({"m_s": 1.0, "mm_s": 1e-3, "um_s": 1e-6, "in_s": 0.0254}),
    "acceleration": _amplitudes({"m_s2": 1.0, "mm_s2": 1e-3, "in_s2": 0.0254, "g": STANDARD_GRAVITY}),
    "force": {"n": 1.0, "mN": 1e-3, "kn": 1e3, "MN": 1e6, "lbf": 4.4482216152605, "kgf": STANDARD_GRAVITY},
    "unbalance": {
        "kg_m": 1.0,
        "kg_mm": 1e-3,
        "g_m": 1e-3,
        "g_cm": 1e-5,
        "g_mm": 1e-6,
        "g_in": 0.0254e-3,
        "oz_in": 0.028349523125 * 0.0254,
    },
    "angle": {"deg": math.pi / 180, "rad": 1.0},
    "phase": {"deg": math.pi / 180, "rad": 1.0, "lag_deg": -math.pi / 180, "lag_rad": -1.0},
}
"""Factor to SI (rad/s, m, rad, N, kg m; amplitudes 0-peak, phases lead) by quantity and unit, units in lower case
but for those that only their case tells apart."""


@dataclass(frozen=True)
class Shown:
    """Units of frequencies and amplitudes in figures and tables, by their names in column names."""

    rate: str = "rpm"
    length: str = "um"

    @property
    def rate_name(self) -> str:
        """Unit of frequencies, as it is written."""
        return {"hz": "Hz", "rad_s": "rad/s"}.get(self.rate, self.rate)

    def rates(self, low: float, high: float) -> str:
        """A range of frequencies given in rad/s."""
        ends = (significant(end / UNITS["frequency"][self.rate], 5) for end in (low, high))
        return f"{' to '.join(ends)} {self.rate_name}"


_shown: ContextVar[Shown] = ContextVar("shown", default=Shown())  # noqa: B039  (frozen)


def shown_units() -> Shown:
    """Units in which frequencies and amplitudes are shown here."""
    return _shown.get()


@contextmanager
def shown_in(units: Shown) -> Iterator[None]:
    """Figures and tables in some units, within the block."""
    before = _shown.set(units)
    try:
        yield
    finally:
        _shown.reset(before)


def in_rad_s(name: str, value: Any, *, needed: bool = True, **by_unit: Any) -> Any:
    """A speed or frequency in rad/s, which may have been given by its name with a unit: ``rpm=speed_rpm``; None where
    it was not given and is not needed."""
    given = {} if value is None else {name: value}
    for unit, one in by_unit.items():
        if one is not None:
            try:
                given[f"{name}_{unit}"] = np.asarray(one, dtype=float)[()] * UNITS["frequency"][unit]
            except (TypeError, ValueError):
                raise ValueError(f"{name}_{unit} is {one!r}; numbers are needed") from None
    words = " or ".join([f"{name}= (rad/s)", ", ".join(f"{name}_{unit}=" for unit in by_unit)])
    if len(given) > 1:
        raise TypeError(f"{' and '.join(given)} are given; one is enough: {words}")
    if needed and not given:
        raise TypeError(f"{words} is needed")
    return next(iter(given.values()), None)


def si_factor(quantity: str, unit: str) -> float:
    """Factor that takes a value in ``unit`` to SI, 0-peak, phase lead."""
    if quantity not in UNITS:
        raise ValueError(unknown_name("quantity", quantity, UNITS))
    units = UNITS[quantity]
    factor = find_unit(unit, units)
    if factor is None:
        raise ValueError(unknown_name(f"unit of {quantity}", unit, units))
    return factor


def find_unit(unit: str, units: Mapping[str, float]) -> float | None:
    """Factor of a unit however it is spelled, ``None`` for one that the table does not have."""
    spelled = unit.replace("\u00b5", "u").replace("\u03bc", "u")
    if spelled in units:
        return units[spelled]
    same = [known for known in units if known.lower() == spelled.lower()]
    if len(same) > 1:
        raise ValueError(f"unit {unit!r} may be {' or '.join(same)}: m is milli and M is mega, write the one meant")
    base = spelled.partition("_")[0]
    if same and base[:1] == "M" and base[1:].islower() and same[0][1:] in units:
        raise ValueError(f"unit {unit!r} begins with M, which is mega; milli is {same[0]!r}")
    return units[same[0]] if same else None


def units_of(*quantities: str) -> dict[str, float]:
    """Units of several quantities in one table, for columns that may hold either."""
    return {unit: factor for quantity in quantities for unit, factor in UNITS[quantity].items()}
