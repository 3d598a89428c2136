"""Complex scalars and matrices for CasADi, which knows only real ones.

Nothing outside :mod:`rotorfit.models` sees this type: compiled model functions hand out plain complex NumPy arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias, Union

import casadi as ca

Real: TypeAlias = Union[float, int, "ca.SX"]
Number: TypeAlias = Union[Real, complex, "Complex"]


class Complex:
    """A complex scalar or matrix held as two CasADi ``SX`` of equal shape."""

    __slots__ = ("im", "re")

    def __init__(self, re: Real, im: Real = 0.0) -> None:
        self.re = re if isinstance(re, ca.SX) else ca.SX(re)
        self.im = im if isinstance(im, ca.SX) else ca.SX(im)
        if self.im.shape != self.re.shape:
            self.im = self.im * ca.SX.ones(self.re.shape)

    @staticmethod
    def of(value: Number) -> Complex:
        """Lift a number or symbol; what is complex already stays as it is."""
        if isinstance(value, Complex):
            return value
        if isinstance(value, complex):
            return Complex(value.real, value.imag)
        return Complex(value)

    @staticmethod
    def matrix(rows: Complex | Sequence[Sequence[Number]]) -> Complex:
        """Build a matrix from nested sequences of scalars; one that is a matrix already stays as it is."""
        if isinstance(rows, Complex):
            return rows
        return Complex.block([[Complex.of(entry) for entry in row] for row in rows])

    @staticmethod
    def block(rows: Sequence[Sequence[Complex]]) -> Complex:
        """Build a matrix from blocks."""
        re = ca.vertcat(*[ca.horzcat(*[entry.re for entry in row]) for row in rows])
        im = ca.vertcat(*[ca.horzcat(*[entry.im for entry in row]) for row in rows])
        return Complex(re, im)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.re.shape
        return int(rows), int(columns)

    def __add__(self, other: Number) -> Complex:
        other = Complex.of(other)
        return Complex(self.re + other.re, self.im + other.im)

    __radd__ = __add__

    def __neg__(self) -> Complex:
        return Complex(-self.re, -self.im)

    def __sub__(self, other: Number) -> Complex:
        return self + (-Complex.of(other))

    def __rsub__(self, other: Number) -> Complex:
        return Complex.of(other) + (-self)

    def __mul__(self, other: Number) -> Complex:
        """Elementwise product, a scalar spreads over a matrix."""
        other = Complex.of(other)
        return Complex(self.re * other.re - self.im * other.im, self.re * other.im + self.im * other.re)

    __rmul__ = __mul__

    def __truediv__(self, other: Number) -> Complex:
        other = Complex.of(other)
        size = other.re**2 + other.im**2
        return self * Complex(other.re / size, -other.im / size)

    def __rtruediv__(self, other: Number) -> Complex:
        return Complex.of(other) / self

    def __matmul__(self, other: Complex) -> Complex:
        """Matrix product."""
        return Complex(self.re @ other.re - self.im @ other.im, self.re @ other.im + self.im @ other.re)

    @property
    def T(self) -> Complex:  # noqa: N802 - the name every array library uses
        """Transpose, without conjugation."""
        return Complex(self.re.T, self.im.T)

    def conj(self) -> Complex:
        """Complex conjugate."""
        return Complex(self.re, -self.im)


J = Complex(0.0, 1.0)
"""The imaginary unit."""
