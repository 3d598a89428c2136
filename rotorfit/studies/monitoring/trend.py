"""Changes in dated tests of one machine: levels, changes of level against the scatter between tests, causes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from rotorfit.base.accessors import Accessor
from rotorfit.base.array_types import Float
from rotorfit.base.chance import Seed, seed_of
from rotorfit.base.digits import significant
from rotorfit.base.equality import ByValue
from rotorfit.base.significance import P_CHANCE
from rotorfit.base.text_table import Printed
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.change import Change, along, fewest_dates, find_change
from rotorfit.identify.fitting.result import FitResult
from rotorfit.models.parameters import MATRIX_UNITS
from rotorfit.studies.monitoring.observed_stiffness import ObservedStiffness

_MEANING = {
    "K": "the support or the shaft became {way} (a crack or a loose support softens, a rub or misalignment stiffens)",
    "M": "the mass that moves became {way} (deposits, water in a hollow shaft, a part that came off)",
    "D": "the damping became {way} (worn or dry bearing or seal, other oil or temperature)",
    "all in proportion": "force and motion are in another proportion: the weight, its radius or a probe's sensitivity, "
    "rather than the rotor",
}
_WAYS = {"K": ("softer", "stiffer"), "M": ("smaller", "larger"), "D": ("smaller", "larger")}


@dataclass(frozen=True, kw_only=True)
class DatedValues:
    """Values of one date, to be followed by :func:`trend`.

    Attributes:
        date: ISO 8601, ``2026-03-01`` or ``2026-03-01T14:30``; empty where only the order is known.
        values: value and standard error by name, SI units.
        units: by name.
        place: what they are values of: values of one place are compared with each other.
        source: where they came from, for messages.
    """

    date: str
    values: Mapping[str, tuple[float, float]]
    units: Mapping[str, str]
    place: str = ""
    source: str = ""


@dataclass(frozen=True, kw_only=True)
class Cause:
    """One thing that may have changed, tried alone."""

    name: str  # K, M, D or "all in proportion"
    size: float  # change as a fraction of the level before
    stderr: float  # its standard error
    probability: float  # of what this cause leaves unexplained, were it alone


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaceTrend:
    """Values of one place over time."""

    place: str  # force plane and probe plane
    dates: tuple[str, ...]  # of the tests in order of time, or their sources where no dates are known
    dated: bool  # whether they are dates
    names: tuple[str, ...]  # names, units: of the values
    units: tuple[str, ...]
    values: Float  # values, stderr: shape ``(N, P)``; the errors are those of each test for itself
    stderr: Float
    change: Change | None  # the most likely change of level; ``None`` with too few dates
    found: bool  # the change is significant
    # what may have changed, alone; most probable first; empty unless a change was found in K, M and D
    causes: tuple[Cause, ...]

    def __str__(self) -> str:
        return "\n".join([self.place, *self.sentences()])

    def sentences(self) -> list[str]:
        """The change and its causes, in sentences."""
        n = len(self.dates)
        if self.change is None:
            return [f"{n} tests: at least {fewest_dates(1)} are needed to tell a change from their scatter"]
        scatter = np.sqrt(np.diag(self.change.scatter)) / np.abs(self.change.before)
        own = np.median(self.stderr, axis=0) / np.abs(self.change.before)
        words = [
            f"from test to test {', '.join(self.names)} scatter by {', '.join(f'{_percent(s)} %' for s in scatter)} "
            f"(errors of one test: {', '.join(f'{_percent(s)} %' for s in own)})"
        ]
        if not self.found:
            return [*words, f"no change of level in {n} tests (p = {significant(self.change.p_value, 2)})"]
        error = np.sqrt(np.diag(self.change.covariance))
        sizes = ", ".join(
            f"{name} {_percent(shift / abs(level), sign='+')} +- {_percent(e / abs(level))} %"
            for name, shift, level, e in zip(self.names, self.change.shift, self.change.before, error, strict=True)
        )
        since = f"a change between {self.dates[self.change.index - 1]} and {self.dates[self.change.index]}"
        sentence = f"{since} (p = {significant(self.change.p_value, 2)}): {sizes}"
        if self.names[0] in ("dK/K", "dK") and self.change.shift[0] > 0:
            return [*words, sentence, "a turning anisotropy that grows is what a propagating crack makes"]
        words.append(sentence)
        likely = [cause for cause in self.causes if cause.probability > P_CHANCE]
        if self.causes and not likely:
            words.append("neither K, M nor D alone, nor all in proportion, explains it: more than one thing changed")
        words += ["several single causes explain it:"] * (len(likely) > 1)
        for cause in likely:
            way = _WAYS.get(cause.name, ("", ""))[cause.size > 0]
            size = f"{_percent(cause.size, sign='+')} +- {_percent(cause.stderr)} %"
            words.append(f"{cause.name} alone ({size}) explains it: {_MEANING[cause.name].format(way=way)}")
        return words


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MachineTrend(ByValue, Printed):
    """Result of :func:`trend`, place by place.

    Attributes:
        places: one entry a place, for observed stiffness a pair of force plane and probe plane.
    """

    places: tuple[PlaceTrend, ...]

    plot = Accessor()

    @property
    def changed(self) -> bool:
        """True if a change was found anywhere."""
        return any(place.found for place in self.places)

    def __str__(self) -> str:
        return "\n\n".join(str(place) for place in self.places)


def trend(
    tests: Sequence[ObservedStiffness | DatedValues],
    *,
    false_alarm: float = 0.01,
    orders: int = 1999,
    rng: Seed = None,
    seed: Seed = None,
) -> MachineTrend:
    """Follow dated tests of one machine: is there a change of level, when, how large, and of what alone.

    The scatter between tests is taken from the tests themselves, weights mounted anew included, as a full covariance:
    the errors of one test say little of it. The significance is that of a permutation test.

    Args:
        tests: of :func:`rotorfit.observed_stiffness`, all dates together, or values of one's own.
        false_alarm: probability of finding a change in any place where there is none.
        orders: random orders of the tests that the change is compared with.
        rng: of the orders, a generator or its seed, 0 by default.
        seed: the same.

    Raises:
        ValueError: no tests, dates that cannot be read or are given for some only, or tests with nothing in common.

    Example:
        >>> levels = {f"2026-01-{day:02d}": 1e6 if day < 9 else 9e5 for day in range(1, 17)}
        >>> tests = [rf.DatedValues(date=d, values={"K": (K, 1e4)}, units={"K": "N/m"}) for d, K in levels.items()]
        >>> rf.trend(tests).changed
        True
    """
    entries = [_dated(test) for test in tests]
    if not entries:
        raise ValueError("there is no test to follow")
    if not 0 < false_alarm < 1:
        raise ValueError(f"false_alarm is a probability, between 0 and 1, got {false_alarm}")
    known = [bool(entry.date) for entry in entries]
    if any(known) and not all(known):
        raise ValueError(
            f"{entries[known.index(False)].source or 'a test'} has no date, others have: give all of them a column "
            "date, or none to keep the order in which they are given"
        )
    by_place: dict[str, list[DatedValues]] = {}
    for entry in entries:
        by_place.setdefault(entry.place, []).append(entry)
    level = false_alarm / len(by_place)
    if orders < 10 / level:
        orders = int(np.ceil(10 / level))  # a p-value below the level needs so many orders
    in_time = {
        name: sorted(own, key=lambda one: as_time(one.date, one.source or "a test")) if own[0].date else own
        for name, own in by_place.items()
    }
    start = seed_of(rng, seed, 0)
    places = (_place(name, own, level, orders, start) for name, own in in_time.items())
    return MachineTrend(places=tuple(places))


def _percent(share: float, sign: str = "-") -> str:
    """A share in per cent with two digits, never as a power of ten."""
    return f"{float(f'{100 * share:.2g}'):{sign}.12g}"


def _dated(test: ObservedStiffness | DatedValues) -> DatedValues:
    if isinstance(test, DatedValues):
        return test
    values, units = dict(test.observed), dict(MATRIX_UNITS)
    if not values:
        for speed, kappa, sigma in zip(test.speed, test.stiffness, test.sigma, strict=True):
            rpm = speed * RPM_PER_RAD_S
            values[f"direct at {rpm:.6g} rpm"] = (kappa.real, sigma)
            values[f"quadrature at {rpm:.6g} rpm"] = (kappa.imag, sigma)
        units = dict.fromkeys(values, "N/m")
    place = f"force at {test.force_plane}, motion at {test.plane}"
    return DatedValues(date=test.date, values=values, units=units, place=place, source=test.source)


def as_time(text: str, what: str) -> datetime:
    """A date of ISO 8601 as local time; ``what`` has it."""
    try:
        time = datetime.fromisoformat(text)
        return time if time.tzinfo is None else time.astimezone().replace(tzinfo=None)
    except (ValueError, OverflowError):
        raise ValueError(f"{what}: the date {text!r} cannot be read; write 2026-03-01 or 2026-03-01T14:30") from None


def _matching(name: str, values: Mapping[str, tuple[float, float]]) -> str | None:
    if name in values:
        return name
    part, at, rest = name.partition(" at ")
    if not at:
        return None
    rpm = float(rest.partition(" ")[0])
    near = [
        (abs(float(n.partition(" at ")[2].partition(" ")[0]) / rpm - 1), n) for n in values if n.startswith(part + at)
    ]
    same_speed = 0.02  # speeds of different dates within this fraction are compared with each other
    return min(near)[1] if near and min(near)[0] <= same_speed else None


def _place(place: str, entries: list[DatedValues], level: float, orders: int, seed: int) -> PlaceTrend:
    # Names that every date has, and under which name each date has them: speeds need not be the same to the digit.
    matching = {name: [_matching(name, entry.values) for entry in entries] for name in entries[0].values}
    common = {name: [str(one) for one in own] for name, own in matching.items() if all(own)}
    names, found = list(common), list(common.values())
    if not names:
        raise ValueError(
            f"{place or 'the tests'}: the tests have no value in common; {entries[0].source or 'the first'} has "
            f"{', '.join(entries[0].values)}"
        )
    pairs = np.array([[entry.values[n[i]] for n in found] for i, entry in enumerate(entries)])
    values, stderr = pairs[..., 0], pairs[..., 1]
    if not np.isfinite(values).all():
        bad = entries[int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])]
        raise ValueError(f"{bad.source or bad.date or 'a test'} has values that are not finite")
    count = len(names)
    while count > 1 and len(entries) < fewest_dates(count):  # too few dates for all: the first names alone
        count -= 1
    names, values, stderr = names[:count], values[:, :count], stderr[:, :count]
    change = find_change(values, orders=orders, seed=seed) if len(entries) >= fewest_dates(count) else None
    significant = change is not None and change.p_value <= level
    causes = []
    if change is not None and significant and names == list(MATRIX_UNITS):  # K, M and D one at a time, and all alike
        directions = {name: np.where(np.arange(len(names)) == i, change.before, 0.0) for i, name in enumerate(names)}
        for name, direction in {**directions, "all in proportion": change.before}.items():
            size, error, probability = along(change, direction)
            causes.append(Cause(name=name, size=size, stderr=error, probability=probability))
    return PlaceTrend(
        place=place,
        dates=tuple(entry.date or entry.source or f"test {i + 1}" for i, entry in enumerate(entries)),
        dated=bool(entries[0].date),
        names=tuple(names),
        units=tuple(entries[0].units[name] for name in names),
        values=values,
        stderr=stderr,
        change=change,
        found=significant,
        causes=tuple(sorted(causes, key=lambda cause: -cause.probability)),
    )


PLACE = "turning anisotropy"
"""Place of these values in a trend."""
RATIO = "dK/K"


def dated_anisotropy(fit: FitResult, date: str = "") -> DatedValues:
    """dK/K of a fit, or dK where there is no one K, as a value to follow: a crack that propagates makes it grow.

    ``rf.trend([rf.dated_anisotropy(fit, date) for fit, date in zip(fits, dates)])`` says whether it did.

    Args:
        fit: of a model with the parameters dK_cos and dK_sin, such as :class:`rotorfit.models.AnisotropicShaft`.
        date: ISO 8601; by default the attribute ``date`` of the test, and empty without one.

    Raises:
        ValueError: a model without turning anisotropy, a test that does not determine it, or tests of several dates.
    """
    sources = [experiment.source for experiment in fit.experiments if experiment.source]
    where = ", ".join(sources) or "the fit"
    found = fit.turning_anisotropy()
    whole = math.isfinite(found.ratio.value)
    name, value = (RATIO, found.ratio) if whole else ("dK", found.dK)
    if not found.dK.stderr < math.inf:
        raise ValueError(f"{where} does not determine dK/K: the image at 2 Om - w, or the 2x line, was not measured")
    dates = {str(d) for e in fit.experiments if "date" in e.attributes for d in set(e.attributes["date"].tolist())}
    if len(dates) > 1 and not date:
        raise ValueError(f"{where} has tests of several dates: {', '.join(sorted(dates))}; fit each date by itself")
    return DatedValues(
        date=date or "".join(dates),
        values={name: (value.value, value.stderr)},
        units={name: value.unit},
        place=PLACE,
        source=where,
    )
