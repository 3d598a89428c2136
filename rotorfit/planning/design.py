"""A test that may be made: possible speeds, planes, directions and lines, limits of force and motion, and its time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.models.array_types import Float
from rotorfit.models.parameters import unknown_name
from rotorfit.units import RAD_S_PER_RPM


@dataclass(frozen=True, kw_only=True)
class Design:
    """Speeds, frequencies, planes and limits of a rotating-force test, for :func:`rotorfit.plan` to choose from.

    Attributes:
        speed_rpm: rotative speeds that are possible.
        frequency_rpm: frequencies of a sweep, positive.
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

    speed_rpm: ArrayLike
    frequency_rpm: ArrayLike
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
        return _rates("speed_rpm", self.speed_rpm)

    @property
    def frequencies(self) -> Float:
        """Frequencies of a sweep, rad/s, ascending."""
        return _rates("frequency_rpm", self.frequency_rpm)

    def words(self, name: str) -> tuple[str, ...]:
        """One word or several as a tuple.

        Args:
            name: of the attribute.
        """
        given = getattr(self, name)
        return (given,) if isinstance(given, str) else tuple(given)


SENSE = {"forward": 1.0, "backward": -1.0}
"""Sign of the frequency of each direction."""


def _rates(name: str, values: ArrayLike) -> Float:
    try:
        found = np.unique(np.atleast_1d(np.asarray(values, dtype=float)))
    except (TypeError, ValueError):
        raise ValueError(f"{name} is {values!r}; numbers in rpm are needed") from None
    if not found.size or not np.isfinite(found).all():
        raise ValueError(f"{name} must be finite numbers in rpm, at least one; got {values!r}")
    return np.asarray(found * RAD_S_PER_RPM)
