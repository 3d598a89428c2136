"""Complex arrays that carry their derivatives by real parameters: forward differentiation of array arithmetic.

Where a quantity is made of few parameters by many products of the same shape, as the lines of a shaft are, arithmetic
on whole arrays with their derivatives takes a small part of the operations that a graph of scalars has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, Union

import numpy as np
from numpy.typing import NDArray

from rotorfit.models.array_types import Float, Index

Values: TypeAlias = NDArray[np.inexact[Any]]
Factor: TypeAlias = Union["Jet", Values, complex]


@dataclass(frozen=True, eq=False)
class Jet:
    """Values, and their derivatives by the parameters."""

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

    def __neg__(self) -> Jet:
        return Jet(-self.value, None if self.slope is None else -self.slope)

    def __sub__(self, other: Jet) -> Jet:
        return self + (-other)

    def __mul__(self, other: Factor) -> Jet:
        if not isinstance(other, Jet):
            return Jet(self.value * other, None if self.slope is None else self.slope * other)
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
        return Jet(self.value.conj(), None if self.slope is None else self.slope.conj())

    def real(self) -> Jet:
        """Real part."""
        return Jet(self.value.real, None if self.slope is None else self.slope.real)

    def take(self, places: Index | Sequence[int]) -> Jet:
        """Some of the rows, in the order asked for."""
        return Jet(self.value.take(places, axis=-2), None if self.slope is None else self.slope.take(places, axis=-2))

    def placed(self, places: Sequence[int]) -> Jet:
        """Some of the rows, in the order asked for, and rows of zeros for -1."""
        none = np.asarray(places)[:, None] < 0
        value = np.where(none, 0.0, self.value.take(places, axis=-2))
        return Jet(value, None if self.slope is None else np.where(none, 0.0, self.slope.take(places, axis=-2)))

    def folded(self, other: Jet, partners: tuple[Index, Index]) -> Jet:
        """Sums of products of rows of two jets of full width, by a table of the partners of either, -1 for none."""
        beside_own, beside_other = (
            _filled(jet.value, table) for jet, table in zip((other, self), partners, strict=True)
        )
        value = np.einsum("nar,ar->nr", beside_own, self.value)
        if self.slope is None or other.slope is None:
            return Jet(value, None)
        if other is self:
            return Jet(value, _mixed(self.slope, beside_own) * 2.0)
        return Jet(value, _mixed(self.slope, beside_own) + _mixed(other.slope, beside_other))


def _filled(value: Values, table: Index) -> Values:
    """Rows by a table of their numbers, zeros where that is -1, shape ``(*table.shape, R)``."""
    return np.concatenate([value, np.zeros_like(value[:1])])[table]


def _mixed(slope: Values, weights: Values) -> Values:
    """``sum_a slope[p, a, r] weights[n, a, r]``, shape ``(P, n, R)``, a product of small matrices for each r."""
    return np.ascontiguousarray((slope.transpose(2, 0, 1) @ weights.transpose(2, 1, 0)).transpose(1, 2, 0))
