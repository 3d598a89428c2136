"""Answers to questions about the stability of a fitted rotor, as records, a table and text."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.base.accessors import Accessor
from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant
from rotorfit.base.equality import ByValue
from rotorfit.base.text_table import Table, Tabled
from rotorfit.base.units import RPM_PER_RAD_S

if TYPE_CHECKING:
    from pandas import DataFrame

SENSITIVITY = "sensitivity function"
_CITED_SENSITIVITY = "limit of the sensitivity function: 3 is cited as zone A of ISO 14839-3, not checked there"
DIRECTIONS = {1: "forward", -1: "backward", 0: "sense unknown"}
"""Of modes, by their sense."""
_CITED = "as published programs cite API 617 and 684, not checked against the standards"


@dataclass(frozen=True, kw_only=True)
class Criterion:
    """One question about the rotor with its answer.

    Attributes:
        name: what is asked.
        case: of the rotor, empty for as identified.
        value: of the fitted rotor, in ``unit``.
        interval: in which the true value lies with the report's probability, NaN where the data do not determine it.
        unit: of value and limit.
        limit: that the value should reach, or of amplitudes should not exceed.
        at_least: whether the value should be at least, or at most, the limit.
        probability: that the criterion is met; NaN where the data do not determine it.
        source: name of a limit that is cited from a standard, empty for limits of the user's.
    """

    name: str
    case: str
    value: float
    interval: tuple[float, float]
    unit: str
    limit: float
    at_least: bool
    probability: float
    source: str

    @property
    def met(self) -> bool:
        """True if the fitted rotor itself meets it."""
        return self.value >= self.limit if self.at_least else self.value <= self.limit


@dataclass(frozen=True, kw_only=True)
class ModeDamping:
    """One mode of free vibration at the highest running speed."""

    frequency: float  # rad/s, signed
    decrement: float  # logarithmic decrement, with its interval
    interval: tuple[float, float]  # of the decrement
    damping_ratio: float  # share of critical damping
    direction: str  # ``forward``, ``backward``, or ``sense unknown`` where no speed tells

    @property
    def overdamped(self) -> bool:
        """True for a mode without a resonance of its own."""
        # Damping ratio from which a mode has no resonance: the amplitude of a forced response has no peak
        overdamped = 1 / math.sqrt(2)
        return self.damping_ratio >= overdamped


@dataclass(frozen=True, eq=False, kw_only=True)
class Curve:
    """A quantity against another with its band."""

    label: str  # what it is
    x: Float  # shape ``(N,)``
    y: Float  # of the fitted rotor, shape ``(N,)``
    band: Float  # lower and upper limit, shape ``(N, 2)``


def damping_ratio(decrement: Float) -> Float:
    """Damping ratios of logarithmic decrements, ``zeta = delta / sqrt(4 pi^2 + delta^2)``; one of infinite ones."""
    return np.asarray(np.sin(np.arctan(decrement / (2 * np.pi))))


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class StabilityReport(ByValue, Tabled):
    """Criteria of a fitted rotor at running speed; see :meth:`FitResult.stability_report`.

    Attributes:
        criteria: with intervals and probabilities.
        modes: at the highest running speed, the least damped first.
        running: lowest and highest running speed, rad/s.
        level: probability of intervals and bands.
        draws: number of rotors drawn, which limits how near to one a probability is known.
        curves: what computes :attr:`decrement`, :attr:`unbalance`, :attr:`cross_coupling` and :attr:`sensitivity`.
        notes: what a reader must know.
        caution: why no number may be relied on as it stands; empty where there is nothing.
        rig: what was tested, by the names of its files.
    """

    criteria: tuple[Criterion, ...]
    modes: tuple[ModeDamping, ...]
    running: tuple[float, float]
    level: float
    draws: int
    curves: Mapping[str, Callable[[], tuple[Curve, ...]]] = field(compare=False)
    notes: tuple[str, ...]
    caution: str
    rig: str

    plot = Accessor()

    @cached_property
    def decrement(self) -> tuple[Curve, ...]:
        """Of each mode against speed, rad/s."""
        return self.curves["decrement"]()

    @property
    def damping_ratio(self) -> tuple[Curve, ...]:
        """The same as shares of critical damping."""
        return tuple(replace(c, y=damping_ratio(c.y), band=damping_ratio(c.band)) for c in self.decrement)

    @cached_property
    def unbalance(self) -> tuple[Curve, ...]:
        """Amplitude against speed, rad/s and m; empty without an unbalance."""
        return self.curves["unbalance"]()

    @cached_property
    def cross_coupling(self) -> tuple[Curve, ...]:
        """Decrement of the least stable forward mode against cross-coupled stiffness, N/m; likewise."""
        return self.curves["cross_coupling"]()

    @cached_property
    def sensitivity(self) -> tuple[Curve, ...]:
        """Modulus of the sensitivity function against signed frequency, rad/s; likewise."""
        return self.curves["sensitivity"]()

    @property
    def met(self) -> bool:
        """True if the fitted rotor meets every criterion.

        Example:
            >>> fit.stability_report(max_speed_rpm=2000).met
            True
        """
        return all(criterion.met for criterion in self.criteria)

    def to_dataframe(self) -> DataFrame:
        """The criteria as a table.

        Example:
            >>> list(fit.stability_report(max_speed_rpm=2000).to_dataframe().columns[:3])
            ['criterion', 'case', 'value']
        """
        from pandas import DataFrame

        names = ["criterion", "case", "value", "low", "high", "unit", "limit", "sense", "probability", "met", "source"]
        sense = {True: "at least", False: "at most"}
        rows = [
            (c.name, c.case, c.value, *c.interval, c.unit, c.limit, sense[c.at_least], c.probability, c.met, c.source)
            for c in self.criteria
        ]
        return DataFrame(rows, columns=names)

    def rows(self, case: str = "") -> list[list[str]]:
        """The criteria of a case in words, head first.

        Args:
            case: its name, empty for as identified.

        Example:
            >>> fit.stability_report(max_speed_rpm=2000).rows()[1][4]
            'met'
        """
        ends = f"{significant(100 * self.level, 4)} % interval"
        head = [case or "as identified", "value", ends, "limit", "", "probability"]
        return [head, *(self._row(c) for c in self.criteria if c.case == case)]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Where limits come from, and :attr:`notes`."""
        sources = list(dict.fromkeys(c.source for c in self.criteria if c.source))
        api = [f"limits of {', '.join(s for s in sources if s != SENSITIVITY)}: {_CITED}"] if sources else []
        return (*api, *([_CITED_SENSITIVITY] if SENSITIVITY in sources else []), *self.notes)

    def parts(self) -> list[str | Table]:
        """What is printed."""
        low, high = (RPM_PER_RAD_S * speed for speed in self.running)
        where = f"{significant(high, 5)} rpm" if low == high else f"{significant(low, 5)} to {significant(high, 5)} rpm"
        parts: list[str | Table] = [f"stability at {where}", *([self.caution] if self.caution else [])]
        layout = f"<{max(len(c.name) for c in self.criteria)} >9 >18 >11 <8 >11"
        for case in dict.fromkeys(c.case for c in self.criteria):
            parts += [Table(self.rows(case), layout), ""]
        return [*parts, self._modes(), *self.remarks]

    def _row(self, c: Criterion) -> list[str]:
        low, high = c.interval
        ends = (
            f"{significant(low, 4)} or more" if math.isinf(high) else f"{significant(low, 4)} to {significant(high, 4)}"
        )
        ends = "not determined" if math.isnan(c.probability) else "" if math.isinf(low) else ends
        limit = f"{'>=' if c.at_least else '<='} {significant(c.limit, 4)} {c.unit}".rstrip()
        value = "none" if math.isinf(c.value) else significant(c.value, 4)
        known = 3 / self.draws  # probability of an event seen in no draw, with 95 % certainty: nearer ones are bounds
        sign = "> " if c.probability > 1 - known else "< " if c.probability < known else ""
        chance = f"{sign}{100 * min(max(c.probability, known), 1 - known):.1f} %"
        chance = "not known" if math.isnan(c.probability) else chance
        return [c.name, value, ends, limit, "met" if c.met else "NOT MET", chance]

    def _modes(self) -> Table:
        ends = f"{significant(100 * self.level, 4)} % interval"
        rows = [["mode, rpm", "", "damping ratio", "log. decrement", ends, ""]]
        for mode in self.modes:
            decrement, low, high = (significant(part, 3) for part in (mode.decrement, *mode.interval))
            cells = [decrement, f"{low} to {high}", "unstable" if mode.decrement < 0 else ""]
            cells = ["", "", "overdamped, no resonance"] if mode.overdamped else cells
            frequency = significant(abs(mode.frequency) * RPM_PER_RAD_S, 5)
            rows.append([frequency, mode.direction, significant(mode.damping_ratio, 3), *cells])
        return Table(rows, f">10 <{max([9, *(len(mode.direction) for mode in self.modes)])} >13 >14 >20 <1")
