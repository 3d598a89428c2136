"""Arithmetic of numbers that were fitted: errors follow from the covariance, units from the units."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol, Self

from rotorfit.estimators.blocks.correlated import quantile
from rotorfit.estimators.significance import CHANCE_ERRORS
from rotorfit.models.digits import plus_minus, two_digits

if TYPE_CHECKING:
    from rotorfit.fitting.quantities import Quantity

_NEWTON = {"kg": 1, "m": 1, "s": -2}
_SHOWN = ({"N": 1, "m": -1}, {"N": 1}, {"N": 1, "s": 1, "m": -1}, {"N": 1, "m": 1})
"""Units with a newton that are written as such: stiffness, force, damping, moment."""


def is_left_open(value: float, error: float, systematic: float) -> bool:
    """True if what the data do not show may well move a number by more than itself: two such shares of it, beyond what
    its error does. Then it is no number."""
    return CHANCE_ERRORS * systematic > abs(value) and systematic > error


class Source(Protocol):
    """A result that knows how its parameters vary together, and what they rest on."""

    def quantity(self, value: float, slopes: Mapping[str, float], unit: str) -> Quantity:
        """A quantity with its derivatives by the parameters, by name."""

    def systematic(self, name: str) -> float:
        """Standard uncertainty of a parameter by what the model leaves out or takes as known."""

    def moved_by(self, name: str) -> str:
        """What of it leaves the number open, in words; empty where the number stands."""


class Number:
    """Operand of sums, products and powers: a value with its unit and its derivatives by parameters of one fit.

    Numbers of one fit know their covariance. Those of another fit, and those that stand for themselves, are independent
    of it: their errors add as squares.
    """

    value: float
    unit: str
    freedom: float

    if TYPE_CHECKING:  # fields of one kind of number, computed for the other

        @property
        def source(self) -> Source | None:
            """The result whose parameters it is made of; None for a number on its own."""

        @property
        def slopes(self) -> Mapping[str, float]:
            """Derivatives by parameters of ``source``, by name."""

        @property
        def alone(self) -> tuple[float, float]:
            """Standard error and systematic share."""

    def __add__(self, other: Number | float) -> Quantity:
        return combined(self, 1.0, other, 1.0, float(self) + float(other), _same_unit(self, other))

    def __sub__(self, other: Number | float) -> Quantity:
        return combined(self, 1.0, other, -1.0, float(self) - float(other), _same_unit(self, other))

    def __mul__(self, other: Number | float) -> Quantity:
        a, b = float(self), float(other)
        return combined(self, b, other, a, a * b, unit_of((self, 1), (other, 1)))

    def __truediv__(self, other: Number | float) -> Quantity:
        a, b = float(self), float(other)
        return combined(self, 1 / b, other, -a / b**2, a / b, unit_of((self, 1), (other, -1)))

    def __pow__(self, power: float) -> Quantity:
        a = float(self)
        return combined(self, power * a ** (power - 1), 0.0, 0.0, a**power, unit_of((self, power)))

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

    def interval(self, level: float = 0.95, *, statistical: bool = False) -> tuple[float, float]:
        """Confidence interval by ``stderr`` and ``systematic``, Student's t with the degrees of freedom of ``stderr``.

        Args:
            level: probability that such intervals hold the truth.
            statistical: by ``stderr`` alone.

        Raises:
            ValueError: a level that is no probability.
        """
        if not 0 < level < 1:
            raise ValueError(f"level is {level!r}; an interval has a probability between 0 and 1")
        stderr, systematic = self.alone
        wide, freedom = stderr if statistical else math.hypot(stderr, systematic), self.freedom
        if wide > stderr > 0:
            freedom *= (wide / stderr) ** 4  # Satterthwaite: the systematic share is taken as known
        half = wide * quantile(level, freedom)
        return self.value - half, self.value + half

    def sqrt(self) -> Quantity:
        """Square root, which NumPy asks for."""
        return self**0.5

    def __float__(self) -> float:
        return float(self.value)

    def __repr__(self) -> str:
        return f"<{self}>"

    def __str__(self) -> str:
        stderr, systematic = self.alone
        if not math.isfinite(stderr):
            return "not determined by these data"
        if is_left_open(self.value, stderr, systematic):
            size = f"{two_digits(systematic)} {shown_unit(self.unit)}".rstrip()
            return f"not determined: what these data do not show moves it by {size}"
        shown = f"{plus_minus(self.value, math.hypot(stderr, systematic))} {shown_unit(self.unit)}".rstrip()
        shares = f" ({two_digits(stderr)} statistical, {two_digits(systematic)} systematic)"
        return shown + (shares if systematic else "")

    def __pos__(self) -> Self:
        return self


def combined(a: Number, by_a: float, b: Number | float, by_b: float, value: float, unit: str) -> Quantity:
    """A quantity of two numbers, of which one at least is of a fit, by its derivatives by both."""
    from rotorfit.fitting.quantities import Quantity

    if not isinstance(b, Number):
        b, by_b = a, 0.0
    if a.source is not None and a.source is b.source:
        slopes = {}
        for name in {**a.slopes, **b.slopes}:
            one, other = by_a * a.slopes.get(name, 0.0), by_b * b.slopes.get(name, 0.0)
            slopes[name] = 0.0 if math.isclose(one, -other) else one + other
        return a.source.quantity(value, slopes, unit)
    shares = [(by_a + by_b, a.alone)] if b is a else [(by_a, a.alone), (by_b, b.alone)]
    stderr, systematic = (math.hypot(*(factor * share[i] for factor, share in shares)) for i in (0, 1))
    return Quantity(value, stderr, unit, min(a.freedom, b.freedom), systematic)


def _same_unit(a: Number, b: Number | float) -> str:
    """The unit of a sum; a plain zero, where Python's ``sum`` begins, has any."""
    if not isinstance(b, Number) and b == 0:
        return a.unit
    other = b.unit if isinstance(b, Number) else "1"
    if _dimensions(a.unit) != _dimensions(other):
        raise ValueError(f"a sum needs one unit; these are {a.unit or '1'} and {other or '1'}")
    return a.unit


# ---- units --------------------------------------------------------------------------------------


def shown_unit(unit: str) -> str:
    """A unit behind a number, where a number without dimension has none."""
    return "" if unit == "1" else unit


def unit_of(*factors: tuple[Number | float, float]) -> str:
    """Unit of a product of powers, as people write it."""
    units = [(number.unit, power) for number, power in factors if isinstance(number, Number)]
    if len(units) == 1 and units[0][1] == 1:
        return units[0][0]
    total: dict[str, float] = {}
    for unit, power in units:
        for name, size in _dimensions(unit).items():
            total[name] = total.get(name, 0) + power * size
    total = {name: size for name, size in total.items() if size}
    for shown in _SHOWN:
        if _in_base(shown) == total:
            return _written(shown)
    return _written(total)


def _dimensions(unit: str) -> dict[str, float]:
    """Powers of kg, m and s in a unit such as ``N s/m`` or ``kg m^2``; a radian is a number."""
    above, _, below = unit.partition("/")
    found: dict[str, float] = {}
    for text, sign in ((above, 1), (below.strip("()"), -1)):
        for name, power in re.findall(r"([A-Za-z]+)\^?(-?\d+(?:\.\d+)?)?", text):
            found[name] = found.get(name, 0) + sign * float(power or 1)
    return {name: size for name, size in _in_base(found).items() if name != "rad"}


def _in_base(powers: Mapping[str, float]) -> dict[str, float]:
    """The same without newtons."""
    base = {name: float(size) for name, size in powers.items() if name != "N"}
    for name, size in _NEWTON.items():
        base[name] = base.get(name, 0.0) + size * powers.get("N", 0)
    return {name: size for name, size in base.items() if size}


def _written(powers: Mapping[str, float]) -> str:
    above = [_power(name, size) for name, size in powers.items() if size > 0]
    below = [_power(name, -size) for name, size in powers.items() if size < 0]
    under = below[0] if len(below) == 1 else f"({' '.join(below)})"
    return " ".join(above) or "1" if not below else f"{' '.join(above) or '1'}/{under}"


def _power(name: str, size: float) -> str:
    return name if size == 1 else f"{name}^{size:g}"
