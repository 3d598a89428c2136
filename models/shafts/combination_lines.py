"""Spectral lines of a shaft that is not round, and of its twist: harmonic balance in turning coordinates.

With ``z = zeta exp(j Om t)`` every motion under a force at w is a sum of lines ``exp(j(m (w - Om) + n Om) t)``, m and n
integers. Without twist the lines go in pairs (m, n), (-m, -n), which are solved exactly. Twist is driven by products of
lateral lines and drives them back in proportion to itself. One pass follows that, the coupling being weak: at the
resonance of the twist of the record behind Figs 37 and 38 first order misses 5e-4 of the motion, one pass 2e-6, which
is what the lines that are left out amount to.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias, Union

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.names import unknown_name

Order = tuple[int, int]


LATERAL: dict[str, Order] = {
    "w": (1, 0),
    "2Om-w": (-1, 0),
    "1x": (0, 0),
    "2x": (0, 1),
    "0": (0, -1),
    "w-Om": (1, -1),
    "3Om-w": (-1, 1),
    "w+Om": (1, 1),
    "Om-w": (-1, -1),
    "2w-Om": (2, 0),
    "3Om-2w": (-2, 0),
}
"""Lines of the lateral motion by name, with their orders (m, n) in turning coordinates."""

TWIST: dict[str, Order] = {
    "w-Om": (1, 0),
    "w-2Om": (1, -1),
    "2w-2Om": (2, 0),
    "w": (1, 1),
    "1x": (0, 1),
    "2x": (0, 2),
    "0": (0, 0),
}
"""Lines of the twist by name, ``phi = Re(Phi exp(j nu t))`` with signed nu, with their orders."""

_SPELLINGS = {"2(w-Om)": "2w-2Om", "Om": "1x", "2Om": "2x", "-w+2Om": "2Om-w", "-2Om+w": "w-2Om", "-Om+w": "w-Om"}


def line_order(direction: str, name: str) -> Order:
    """Orders (m, n) of a line, of the lateral motion or (direction ``twist``) of the twist."""
    lines = TWIST if direction == "twist" else LATERAL
    plain = re.sub(r"[\s*]", "", name)
    plain = _SPELLINGS.get(plain, plain)
    if plain not in lines:
        raise ValueError(unknown_name("line of the twist" if direction == "twist" else "lateral line", name, lines))
    return lines[plain]


_LATERAL = tuple(LATERAL.values())
_DRIVEN: tuple[Order, ...] = ((1, 0), (-1, 0), (0, 0), (0, 1), (0, -1))
"""Lateral lines that force, unbalance and side load drive by themselves; twist adds the others."""
_TWIST = tuple(TWIST.values())
_BOTH = tuple(dict.fromkeys((*_TWIST, *((-m, -n) for m, n in _TWIST))))
"""Orders of the twist and their negatives, which a real motion has too."""


@dataclass(frozen=True, kw_only=True)
class Torsion:
    """Stiffness against the twist, jets of one row."""

    J: Jet  # polar inertia, stiffness and damping, kg m^2, N m/rad, N m s/rad
    kt: Jet
    ct: Jet


@dataclass(frozen=True, kw_only=True, eq=False)
class ShaftValues:
    """Values that the lines depend on: jets of one row, and arrays of shape ``(R,)``."""

    M: Jet  # kg, N s/m, N/m
    D: Jet
    K: Jet
    delta: Jet  # ``dK exp(2jg)``, N/m
    eps: Jet  # eccentricity, ahead of the Keyphasor mark as a complex number, m
    side: Jet  # side load, N
    speed: Float  # Om and w, rad/s
    frequency: Float
    force: ComplexArray  # complex amplitude at w, N
    torsion: Torsion | None  # inertia, stiffness and damping of the twist; None of a shaft that does not twist

    def turning_frequency(self, orders: Sequence[Order]) -> Float:
        """Frequencies of orders in turning coordinates, rad/s, shape ``(n, R)``."""
        m, n = np.array(orders, dtype=float).T[:, :, None]
        return np.asarray(m * (self.frequency - self.speed) + n * self.speed)

    def fixed_frequency(self, orders: Sequence[Order]) -> Float:
        """Frequencies of lateral lines in fixed coordinates, rad/s, shape ``(n, R)``."""
        return self.turning_frequency(orders) + self.speed


def solve_lines(
    v: ShaftValues, lateral: Sequence[Order], twist: Sequence[Order]
) -> tuple[dict[Order, Jet], dict[Order, Jet]]:
    """Lateral lines, of ``z exp(-j Om t)``, and of the twist by orders, the twist's back action included."""
    sources = Jet.rows([Jet(v.force[None]), v.M * v.eps * v.speed**2, v.side])

    def driven(orders: Sequence[Order]) -> Jet:
        return sources.placed([_place(((1, 0), (0, 0), (0, -1)), order) for order in orders])

    if v.torsion is None:
        wanted = _with_images(order for order in lateral if order in _DRIVEN)
        return _by_order(wanted, _lateral(v, wanted, driven(wanted))) if wanted else {}, {}
    alone = _lateral(v, _DRIVEN, driven(_DRIVEN))
    phi = _twist(v, v.torsion, _DRIVEN, alone, _TWIST)
    orders = _LATERAL if twist else _with_images(lateral)
    lines = _lateral(v, orders, driven(orders) + _back_action(v, _DRIVEN, alone, phi, orders))
    wanted = tuple(twist)
    return _by_order(orders, lines), _by_order(wanted, _twist(v, v.torsion, orders, lines, wanted)) if wanted else {}


def _with_images(orders: Iterable[Order]) -> tuple[Order, ...]:
    return tuple(dict.fromkeys(both for m, n in orders for both in ((m, n), (-m, -n))))


def _by_order(orders: Sequence[Order], lines: Jet) -> dict[Order, Jet]:
    return {order: lines.take([i]) for i, order in enumerate(orders)}


def _lateral(v: ShaftValues, orders: tuple[Order, ...], force: Jet) -> Jet:
    """Solve ``kappa(w) A + delta conj(B) = F, kappa(2 Om - w) B + delta conj(A) = G``, B the image of A."""
    image = [orders.index((-m, -n)) for m, n in orders]
    w = v.fixed_frequency(orders)
    own = v.K + v.D * (1j * w) - v.M * w**2
    other = own.take(image).conj()
    return (other * force - v.delta * force.take(image).conj()) / (other * own - v.delta * v.delta.conj())


def _twist(v: ShaftValues, torsion: Torsion, lines: tuple[Order, ...], lateral: Jet, wanted: tuple[Order, ...]) -> Jet:
    """Twist under the torque ``Im(delta conj(zeta)^2) - M Im(conj(eps) z'' exp(-j Om t))``, zeta with all its lines."""
    orders = (*wanted, *((-m, -n) for m, n in wanted))
    w = v.fixed_frequency(orders)
    own = v.eps.conj() * v.M * (lateral.placed([_place(lines, order) for order in orders]) * w**2)
    torque = own + v.delta * lateral.folded(lateral, _partners(orders, lines, lines, (-1, -1))).conj()
    count = len(wanted)
    both = torque.take(range(count)) - torque.take(range(count, 2 * count)).conj()
    nu = v.turning_frequency(wanted)
    inertia = torsion.J + v.eps * v.eps.conj() * v.M
    # The steady motion adds M Om^2 Re(conj(eps) U) - 2 Re(delta conj(zeta)^2) to the torsional stiffness.
    U, sag, twice = (lateral.take([lines.index((0, n))]) for n in (0, -1, 1))
    steady = v.eps.conj() * v.M * (U * v.speed**2) - v.delta * (U * U + sag * twice * 2.0).conj() * 2.0
    stiffness = steady.real() + torsion.kt + torsion.ct * (1j * nu) - inertia * nu**2
    # The mean twist is not the real part of a vector that turns.
    return both * np.array([[-0.5j if order == (0, 0) else -1j] for order in wanted]) / stiffness


def _back_action(v: ShaftValues, lines: tuple[Order, ...], lateral: Jet, twist: Jet, wanted: tuple[Order, ...]) -> Jet:
    """Lateral force ``M eps (2 Om phi' - j phi'' + j Om^2 phi) - 2j phi delta conj(zeta)`` in turning coordinates."""
    own = [_place(_TWIST, order) for order in _BOTH]
    other = [_place(_TWIST, (-m, -n)) for m, n in _BOTH]
    phi = (twist.placed(own) + twist.conj().placed(other)) * 0.5
    alone = phi.take([_BOTH.index(order) for order in wanted]) * (1j * v.fixed_frequency(wanted) ** 2)
    crossed = phi.folded(lateral.conj(), _partners(wanted, _BOTH, lines, (1, -1)))
    return v.eps * v.M * alone + v.delta * (crossed * -2j)


def _place(orders: tuple[Order, ...], order: Order) -> int:
    """Number of an order, -1 where it is none of them."""
    return orders.index(order) if order in orders else -1


@cache
def _partners(
    made: tuple[Order, ...], first: tuple[Order, ...], second: tuple[Order, ...], signs: tuple[int, int]
) -> tuple[Index, Index]:
    """Partners of each first and of each second factor in products of some orders, -1 for none."""
    tables = np.full((len(made), len(first)), -1), np.full((len(made), len(second)), -1)
    for row, (p, q) in enumerate(made):
        for i, (m, n) in enumerate(first):
            k = _place(second, (signs[1] * (p - signs[0] * m), signs[1] * (q - signs[0] * n)))
            if k >= 0:
                tables[0][row, i], tables[1][row, k] = k, i
    return tables


Values: TypeAlias = NDArray[np.inexact[Any]]
Factor: TypeAlias = Union["Jet", Values, complex]


@dataclass(frozen=True, eq=False)
class Jet:
    """Complex values that carry their derivatives by the parameters: forward differentiation of array arithmetic. Where
    a quantity is made of few parameters by many products of the same shape, as lines are, arithmetic on whole arrays
    with their derivatives takes a small part of the operations that a graph of scalars has."""

    value: Values  # shape ``(n, R)`` or one that broadcasts with it, rows being what is indexed by :meth:`take`
    # derivatives by P real parameters, shape ``(P, n, R)`` or one that broadcasts with it; None where none are
    # wanted, or there are none
    slope: Values | None = None

    __array_ufunc__ = None  # an array times a jet is a jet

    @staticmethod
    def parameters(vectors: Float, *, derivatives: bool) -> list[Jet]:
        """The parameters themselves."""
        unit = np.eye(vectors.shape[1])[:, :, None, None]
        return [Jet(column[None], unit[i] if derivatives else None) for i, column in enumerate(vectors.T)]

    @staticmethod
    def rows(parts: Sequence[Jet]) -> Jet:
        """One jet of the rows of others, one below the other."""
        width = max(part.value.shape[-1] for part in parts)
        values = [np.broadcast_to(part.value, (len(part.value), width)) for part in parts]
        count = max((len(part.slope) for part in parts if part.slope is not None), default=0)
        if not count:
            return Jet(np.concatenate(values))
        slopes = [
            np.broadcast_to(0.0 if part.slope is None else part.slope, (count, *value.shape))
            for part, value in zip(parts, values, strict=True)
        ]
        return Jet(np.concatenate(values), np.concatenate(slopes, axis=1))

    def __add__(self, other: Factor) -> Jet:
        if not isinstance(other, Jet):
            return Jet(self.value + other, self.slope)
        if self.slope is None or other.slope is None:
            return Jet(self.value + other.value, other.slope if self.slope is None else self.slope)
        return Jet(self.value + other.value, self.slope + other.slope)

    __radd__ = __add__

    def _each(self, function: Callable[[Values], Values]) -> Jet:
        """A jet of what a function that is linear in the values makes of them and of their derivatives."""
        return Jet(function(self.value), None if self.slope is None else function(self.slope))

    def __neg__(self) -> Jet:
        return self._each(np.negative)

    def __sub__(self, other: Jet) -> Jet:
        return self + (-other)

    def __mul__(self, other: Factor) -> Jet:
        if not isinstance(other, Jet):
            return self._each(lambda part: part * other)
        value = self.value * other.value
        if other.slope is None:
            return Jet(value, None if self.slope is None else self.slope * other.value)
        slope = other.slope * self.value
        return Jet(value, slope if self.slope is None else slope + self.slope * other.value)

    __rmul__ = __mul__

    def __truediv__(self, other: Jet) -> Jet:
        inverse = 1 / other.value
        value = self.value * inverse
        if other.slope is None:
            return Jet(value, None if self.slope is None else self.slope * inverse)
        change = -other.slope * value
        return Jet(value, (change if self.slope is None else self.slope + change) * inverse)

    def conj(self) -> Jet:
        """Complex conjugate."""
        return self._each(np.conj)

    def real(self) -> Jet:
        """Real part."""
        return self._each(np.real)

    def take(self, places: Index | Sequence[int]) -> Jet:
        """Some of the rows, in the order asked for."""
        return self._each(lambda part: part.take(places, axis=-2))

    def placed(self, places: Sequence[int]) -> Jet:
        """Some of the rows, in the order asked for, and rows of zeros for -1."""
        none = np.asarray(places)[:, None] < 0
        return self._each(lambda part: np.where(none, 0.0, part.take(places, axis=-2)))

    def folded(self, other: Jet, partners: tuple[Index, Index]) -> Jet:
        """Sums of products of rows of two jets of full width, by a table of the partners of either, -1 for none."""
        # Rows of zeros where there is no partner, shape ``(*table.shape, R)``.
        beside_own, beside_other = (
            np.concatenate([jet.value, np.zeros_like(jet.value[:1])])[table]
            for jet, table in zip((other, self), partners, strict=True)
        )
        value = np.einsum("nar,ar->nr", beside_own, self.value)
        if self.slope is None or other.slope is None:
            return Jet(value, None)
        if other is self:
            return Jet(value, _mixed(self.slope, beside_own) * 2.0)
        return Jet(value, _mixed(self.slope, beside_own) + _mixed(other.slope, beside_other))


def _mixed(slope: Values, weights: Values) -> Values:
    """``sum_a slope[p, a, r] weights[n, a, r]``, shape ``(P, n, R)``, a product of small matrices for each r."""
    return np.ascontiguousarray((slope.transpose(2, 0, 1) @ weights.transpose(2, 1, 0)).transpose(1, 2, 0))
