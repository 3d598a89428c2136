"""One number of a result with its error: a fitted parameter, a derived quantity, the agreement of one response.

Sums, products and powers of numbers that were fitted have errors by the covariance, and units by the units.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, Protocol, Self, SupportsIndex, TypeAlias, overload
from weakref import WeakKeyDictionary

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.digits import NOT_DETERMINED, significant, with_error, with_errors
from rotorfit.base.equality import ByValue
from rotorfit.base.names import unknown_name
from rotorfit.base.significance import quantile
from rotorfit.base.text_table import Printed, Table, Tabled
from rotorfit.base.written_units import dimensions, product_unit, shown_unit, si_of
from rotorfit.estimators.inference.joint_errors import JointErrors, Reach

Share: TypeAlias = Literal["all", "noise"]
"""Part of an error that an interval is of."""

THRESHOLD = "threshold_speed"
"""Name of the threshold speed where a parameter could stand."""

CAUSE = "cause "
"""Before the name of a cause, where it stands beside names of parameters."""

_OF_EACH_TEST = ("drift", "clock")
"""Causes that two tests of one rig do not have in common."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ErrorBar:
    """Standard error of a result, its shares, which add up as squares, and how far its interval reaches."""

    noise: float  # if every cause were known
    bounded: float  # by causes that had to be found from the data
    on_trust: Mapping[str, float]  # by the size that each cause is given before the data, by name, signed as its slope
    slopes: Mapping[str, float]  # by a unit of each cause, the fitted values following it
    reach: Reach
    freedom: float  # degrees of freedom

    @classmethod
    def of(
        cls, errors: JointErrors, names: Sequence[str], noise: float, along: Float, freedom: float = math.inf
    ) -> ErrorBar:
        """That of a result by its error by the noise and its slopes along the causes of these names, ``(k,)``."""
        shares = errors.shares(noise, along)
        return cls(
            noise=noise,
            bounded=shares.bounded,
            on_trust=dict(zip(names, shares.trust.tolist(), strict=True)),
            slopes=dict(zip(names, along.tolist(), strict=True)),
            reach=errors.reach(noise, along),
            freedom=freedom,
        )

    @property
    def trust(self) -> float:
        """What rests on sizes that causes are given before the data."""
        return math.hypot(*self.on_trust.values())

    @property
    def systematic(self) -> float:
        """What all causes leave, found and on trust."""
        return math.hypot(self.bounded, self.trust)

    @property
    def stderr(self) -> float:
        """The whole."""
        return math.hypot(self.noise, self.bounded, self.trust)

    @property
    def largest_on_trust(self) -> str:
        """Name of the cause that most rests on."""
        most = max(map(abs, self.on_trust.values()), default=0.0)
        alike = 0.999  # of the largest: of causes that go alike, round-off would choose
        return next((name for name, share in self.on_trust.items() if abs(share) >= alike * most), "")


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A number as every table, page and text writes it, to the second significant digit of its error."""

    value: str  # or that the data do not determine it
    error: str = ""  # none of a known value, a dash where the search did not converge
    low: str = ""  # ends of the 95 % interval, likewise
    high: str = ""
    unit: str = ""  # none without dimension

    def __str__(self) -> str:
        return " ".join(filter(None, (self.number, self.unit)))

    @property
    def number(self) -> str:
        """Value and error without the unit."""
        return f"{self.value} +- {self.error}" if self.error.strip("-") else self.value


class Source(Protocol):
    """A result that knows how its parameters vary together, and what they rest on."""

    def quantity(self, value: float, slopes: Mapping[str, float], unit: str) -> Quantity:
        """A quantity with its derivatives by the parameters, by name."""

    def error_of(self, slopes: Mapping[str, float]) -> ErrorBar | None:
        """The error of a result by its slopes, share by share; None where no causes were solved."""

    def error_parts(self, slopes: Mapping[str, float]) -> Float:
        """The error of a result by independent parts that all results share; their squares add up to its variance."""


class Number(ByValue, Printed):
    """Operand of sums, products and powers: a value with its unit and its derivatives by parameters of one fit.

    Numbers of one fit know their covariance. Those of another fit, and those that stand for themselves, are independent
    of it: their errors add as squares.
    """

    value: float
    stderr: float
    unit: str

    if TYPE_CHECKING:

        @property
        def _quantity(self) -> Quantity:
            """The number as a quantity."""

        @property
        def error(self) -> ErrorBar | None:
            """The error share by share."""

        def interval(self, level: float = 0.95, *, share: Share = "all") -> tuple[float, float]:
            """Confidence interval."""

    @property
    def noise(self) -> float:
        """Share of ``stderr`` by the noise: the error if every cause were known."""
        return self.stderr if self.error is None else self.error.noise

    @property
    def bounded(self) -> float:
        """Share of ``stderr`` by causes that had to be found from the data."""
        return 0.0 if self.error is None else self.error.bounded

    @property
    def trust(self) -> float:
        """Share of ``stderr`` that rests on sizes that causes are given before the data."""
        return 0.0 if self.error is None else self.error.trust

    @property
    def systematic(self) -> float:
        """Share of ``stderr`` by causes, found and on trust."""
        return 0.0 if self.error is None else self.error.systematic

    @property
    def determined(self) -> bool:
        """True if the data determine it."""
        return math.isfinite(self._quantity.value) and not math.isinf(self._quantity.stderr)

    def shown(self) -> Shown:
        """The number as every table and page of it shows it.

        Example:
            >>> fit.params["D"].shown().number
            '449 +- 16'
        """
        own = self._quantity
        if not self.determined:
            return Shown(value=NOT_DETERMINED)
        unit = shown_unit(own.unit)
        if own.stderr == 0:
            return Shown(value=significant(own.value, 7), unit=unit)
        value, error = with_error(own.value, own.stderr)
        low, high = (with_error(end, own.stderr)[0] for end in self.interval())
        return Shown(value=value, error=error, low=low, high=high, unit=unit)

    def __add__(self, other: Number | float) -> Quantity:
        return _combined(self, 1.0, other, 1.0, self.value + _value(other), _same_unit(self, other))

    def __sub__(self, other: Number | float) -> Quantity:
        return _combined(self, 1.0, other, -1.0, self.value - _value(other), _same_unit(self, other))

    def __mul__(self, other: Number | float) -> Quantity:
        a, b = self.value, _value(other)
        return _combined(self, b, other, a, a * b, _unit_of((self, 1), (other, 1)))

    def __truediv__(self, other: Number | float) -> Quantity:
        a, b = self.value, _value(other)
        return _combined(self, 1 / b, other, -a / b**2, a / b, _unit_of((self, 1), (other, -1)))

    def __pow__(self, power: float) -> Quantity:
        a = self.value
        return _combined(self, power * a ** (power - 1), 0.0, 0.0, a**power, _unit_of((self, power)))

    def __neg__(self) -> Quantity:
        return self * -1.0

    def __radd__(self, other: float) -> Quantity:
        return self + other

    def __rmul__(self, other: float) -> Quantity:
        return self * other

    def __rsub__(self, other: float) -> Quantity:
        return (-self) + other

    def __rtruediv__(self, other: float) -> Quantity:
        return self**-1.0 * other

    def change_from(self, before: Number) -> Quantity:
        """The number less the same one of another test of the same rig, read by the same probes.

        What both rest on, a probe's gain or a known value, is in both alike and counts by its difference; ``-`` takes
        the errors of two fits for independent. Causes that each sweep has anew, ``drift`` and ``clock``, count twice.

        Args:
            before: of the other fit.

        Example:
            >>> later = rf.fit(fit.model, rig, known={"K3": 6000.0})
            >>> change = later.params["D"].change_from(fit.params["D"])
            >>> change.stderr < 0.2 * fit.params["D"].stderr
            True
        """
        a, b, apart = self._quantity, before._quantity, self - before
        mine, its = a.error, b.error
        if a.source is b.source or mine is None or its is None:
            return apart
        names = {**mine.on_trust, **its.on_trust}
        pairs = {name: (mine.on_trust.get(name, 0.0), its.on_trust.get(name, 0.0)) for name in names}
        trust = [math.hypot(x, y) if name in _OF_EACH_TEST else x - y for name, (x, y) in pairs.items()]
        return replace(apart, stderr=math.hypot(mine.noise, its.noise, mine.bounded, its.bounded, *trust))

    def to(self, unit: str) -> Quantity:
        """The number in another unit: rpm, Hz, um, mil, kN/m, N/mm, lbf/in, N s/mm, g mm, deg, ...

        Args:
            unit: its name, units as in columns of files; 1/s is rad/s.

        Raises:
            ValueError: a unit of something else, or an unknown one.

        Example:
            >>> print(fit.threshold_speed().to("rpm"))
            2654.0 +- 5.8 rpm
            >>> print(fit.params["D"].to("N s/mm"))
            0.449 +- 0.016 N s/mm
        """
        own, factor = self._quantity, si_of(self.unit, self.unit) / si_of(unit, self.unit)
        slopes = {name: slope * factor for name, slope in own.slopes.items()}
        return replace(own, value=own.value * factor, stderr=own.stderr * factor, unit=unit, slopes=slopes)

    def to_uncertainties(self) -> Any:
        """The number for the package ``uncertainties``, the unit left out. Numbers of one fit keep their correlations.

        Raises:
            ImportError: the package is not installed.

        Example:
            >>> K0, D = (fit.params[name].to_uncertainties() for name in ("K0", "D"))
            >>> print(f"{K0 / D:.2u}")
            6.43+/-0.64
        """
        from uncertainties import ufloat

        own = self._quantity
        if own.source is None or not math.isfinite(own.stderr):
            return ufloat(own.value, own.stderr)
        parts = own.source.error_parts(own.slopes).tolist()
        return own.value + sum(part * unit for part, unit in zip(parts, _units_of(own.source, len(parts)), strict=True))

    def log(self) -> Quantity:
        """Natural logarithm of the value in its unit, for ``np.log``."""
        a = self.value
        return _combined(self, 1 / a, 0.0, 0.0, math.log(a), "1")

    def log10(self) -> Quantity:
        """Common logarithm of the value in its unit, for ``np.log10``."""
        a = self.value
        return _combined(self, 1 / (a * math.log(10)), 0.0, 0.0, math.log10(a), "1")

    def exp(self) -> Quantity:
        """Exponential of a number without dimension, for ``np.exp``."""
        if dimensions(self.unit):
            raise ValueError(f"exp needs a number without dimension; this is in {self.unit}")
        a = math.exp(self.value)
        return _combined(self, a, 0.0, 0.0, a, "1")

    def sqrt(self) -> Quantity:
        """Square root, for ``np.sqrt``."""
        return self**0.5

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """NumPy's functions, number by number, each by the method of its name."""
        boxed = [np.array(one, dtype=object) if isinstance(one, Number) else one for one in inputs]
        return getattr(ufunc, method)(*boxed, **options)

    def __abs__(self) -> Quantity:
        return self * math.copysign(1.0, self.value)

    @overload
    def __round__(self, digits: None = None) -> int: ...
    @overload
    def __round__(self, digits: SupportsIndex) -> float: ...
    def __round__(self, digits: SupportsIndex | None = None) -> float:
        return round(self.value, digits)

    def __lt__(self, other: Number | float) -> bool:
        return self.value < _comparable(self, other)

    def __le__(self, other: Number | float) -> bool:
        return self.value <= _comparable(self, other)

    def __gt__(self, other: Number | float) -> bool:
        return self.value > _comparable(self, other)

    def __ge__(self, other: Number | float) -> bool:
        return self.value >= _comparable(self, other)

    def __format__(self, spec: str) -> str:
        """The value alone by ``.1f`` and the like, value and error by those of ``uncertainties``, ``.2u``, else the
        printed text."""
        if re.search(r"u|[PSL]$", spec):
            return format(self.to_uncertainties(), spec)
        return format(self.value if re.search(r"[.,]|[eEfFgGn%]$", spec) else str(self), spec)

    def __float__(self) -> float:
        """The value of a known number; of others the error would be lost without a word, as in ``math.sqrt``."""
        if self._quantity.stderr == 0:
            return float(self.value)
        raise TypeError(f"{self} has an error, which a plain number cannot hold; take .value, or np.sqrt and the like")

    def __pos__(self) -> Self:
        return self


@dataclass(frozen=True, eq=False, repr=False)
class Quantity(Number):
    """A derived quantity and its standard error, infinite where the data do not determine it, NaN for a stalled fit.

    Sums, products and powers keep the covariance with what else was derived from the same fit, and the unit.

    Attributes:
        value: in ``unit``.
        stderr: its standard error, likewise.
        unit: SI unit.
        freedom: degrees of freedom of ``stderr``.
        source: the result that it was derived from; None for a number on its own.
        slopes: derivatives by the parameters of the source, by name.
    """

    value: float
    stderr: float
    unit: str
    freedom: float = math.inf
    source: Source | None = field(default=None, compare=False, repr=False)
    slopes: Mapping[str, float] = field(default_factory=dict, compare=False, repr=False)

    @property
    def _quantity(self) -> Quantity:
        return self

    def interval(self, level: float = 0.95, *, share: Share = "all") -> tuple[float, float]:
        """Confidence interval, by Student's t with the degrees of freedom of ``stderr``.

        What rests on a cause that is never negative lengthens it to one side only.

        Args:
            level: probability that such intervals hold the truth.
            share: "noise" for the noise alone, as if every cause were known.

        Raises:
            ValueError: a level that is no probability.
        """
        if not 0 < level < 1:
            raise ValueError(f"level is {level!r}; an interval has a probability between 0 and 1")
        reach, bar = quantile(level, self.freedom), self.error
        below = above = reach * self.stderr
        if bar is not None and math.isfinite(self.stderr):
            below, above = (reach * bar.noise,) * 2 if share == "noise" else bar.reach.ends(reach)
        return self.value - below, self.value + above

    @property
    def error(self) -> ErrorBar | None:
        """The error share by share; None without causes, and for a number on its own."""
        return None if self.source is None else self.source.error_of(self.slopes)

    def __repr__(self) -> str:
        return f"<{self}>"

    def __str__(self) -> str:
        return str(self.shown()) if math.isfinite(self.stderr) else f"{NOT_DETERMINED} by these data"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class FittedParameter(Number):
    """One parameter of a result. Sums, products and powers of parameters of one result know their covariance.

    Attributes:
        name: name, with the group in brackets where it was fitted per attribute.
        value: estimate or known value, SI.
        stderr: standard error, as wide as the residuals ask, see ``noise`` of a result; where they were not studied,
            by sqrt(redchi) if that is above one; of known parameters what their tolerance leaves open, zero without
            one; infinite where the data do not determine the parameter, NaN where the search did not converge.
        init_value: start of the optimisation.
        unit: SI unit.
        meaning: a few words.
        min, max: bounds.
        vary: whether it was fitted.
        plain: value without causes.
        resolved: whether the data determine it.
        at_bound: the estimate rests on a bound, so its error bar is not symmetric.
        freedom: degrees of freedom of ``stderr``, few where it rests on differences between few runs.
        fit: the result that it belongs to, which knows what the parameter rests on.
    """

    name: str
    value: float
    stderr: float
    init_value: float
    unit: str
    meaning: str
    min: float
    max: float
    vary: bool
    plain: float = math.nan
    resolved: bool = True
    at_bound: bool = False
    freedom: float = math.inf
    fit: Source | None = field(default=None, init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        if math.isnan(self.plain):
            object.__setattr__(self, "plain", self.value)

    @property
    def _quantity(self) -> Quantity:
        alone = (self.value, self.stderr, self.unit, self.freedom)
        return Quantity(*alone, source=self.fit, slopes={self.name: 1.0})

    @property
    def determined(self) -> bool:
        """True if the data determine it, or it is known."""
        return self.resolved and not (self.vary and math.isinf(self.stderr))

    def shares(self) -> tuple[str, ...]:
        """Its error and shares of that by noise, bounded and on trust, as tables show them; nothing without an error.

        A dash stands for a share that is zero.
        """
        if not (self.determined and (self.vary or self.stderr)):
            return ()
        return tuple(with_errors(self.value, self.stderr, self.stderr, self.noise, self.bounded, self.trust)[1:])

    @property
    def error(self) -> ErrorBar | None:
        """The error share by share; None where no causes were solved, and for known parameters without a tolerance."""
        return self._quantity.error if self.vary or self.stderr else None

    def interval(self, level: float = 0.95, *, share: Share = "all") -> tuple[float, float]:
        """As :meth:`Quantity.interval`.

        Args:
            level, share: see there.
        """
        return self._quantity.interval(level, share=share)

    def __str__(self) -> str:
        return f"{self._quantity}{'' if self.vary else ', known'}"

    def __repr__(self) -> str:
        return f"<{self.name}: {self}>"


@dataclass(frozen=True, kw_only=True)
class ResponseQuality:
    """Agreement of one measured response with the fit."""

    name: str  # run and channel
    nrmse: float  # rms residual over rms response
    frac: float  # frequency response assurance criterion, 1 for responses of equal shape
    redchi: float  # mean squared whitened residual, 1 for noise alone
    count: int  # number of readings


def _combined(one: Number, by_a: float, other: Number | float, by_b: float, value: float, unit: str) -> Quantity:
    """A quantity of two numbers, of which one at least is of a fit, by its derivatives by both."""
    a = one._quantity
    b, by_b = (other._quantity, by_b) if isinstance(other, Number) else (a, 0.0)
    if a.source is not None and a.source is b.source:
        slopes = {}
        for name in {**a.slopes, **b.slopes}:
            mine, its = by_a * a.slopes.get(name, 0.0), by_b * b.slopes.get(name, 0.0)
            slopes[name] = 0.0 if math.isclose(mine, -its) else mine + its
        return a.source.quantity(value, slopes, unit)
    alone = other is one or not isinstance(other, Number)
    shares = [(by_a + by_b, a)] if alone else [(by_a, a), (by_b, b)]
    stderr = math.hypot(*(factor * number.stderr for factor, number in shares))
    return Quantity(value, stderr, unit, min(a.freedom, b.freedom))


def _value(number: Number | float) -> float:
    return number.value if isinstance(number, Number) else float(number)


def _comparable(one: Number, other: Number | float) -> float:
    """The value of another number in the unit of the first; plain ones are in it."""
    return other.to(one.unit).value if isinstance(other, Number) else float(other)


_SHARED: WeakKeyDictionary[Source, list[Any]] = WeakKeyDictionary()
"""Independent numbers of unit variance that those of one fit are made of, for ``uncertainties``."""


def _units_of(source: Source, count: int) -> list[Any]:
    from uncertainties import ufloat

    return _SHARED.setdefault(source, [ufloat(0.0, 1.0) for _ in range(count)])


class Parameters(Tabled, dict[str, FittedParameter]):
    """Parameters of a result by name."""

    def __missing__(self, name: str) -> FittedParameter:
        raise KeyError(unknown_name("parameter", str(name), self))

    def parts(self) -> list[str | Table]:
        """What is printed."""
        rows = [[name, str(p), p.meaning] for name, p in self.items()]
        return [Table([["parameter", "value", "meaning"], *rows], "<9 <20 <1")]


def _unit_of(*factors: tuple[Number | float, float]) -> str:
    """Unit of a product of powers of numbers."""
    return product_unit((number.unit, power) for number, power in factors if isinstance(number, Number))


def _same_unit(a: Number, b: Number | float) -> str:
    """The unit of a sum; a plain zero, where Python's ``sum`` begins, has any."""
    if not isinstance(b, Number) and b == 0:
        return a.unit
    other = b.unit if isinstance(b, Number) else "1"
    if dimensions(a.unit) != dimensions(other):
        raise ValueError(f"a sum needs one unit; these are {a.unit or '1'} and {other or '1'}")
    return a.unit
