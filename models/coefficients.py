"""Coefficients of an equation of motion and their derivatives, as functions of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index
from rotorfit.models.compiled import array_function
from rotorfit.models.complexes import Complex

Symbolic = tuple[ca.SX, ca.SX, ca.SX, list[Complex], list[Complex]]
"""Symbols of the parameters, the speed and the eccentricity, coefficient matrices and probe factors."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CoefficientJacobian:
    """Structurally nonzero derivatives of the coefficients, entry e being d C[power, row, column] / d input."""

    inputs: Index  # number of the input of each entry, parameters first, then speed, then eccentricity, shape ``(E,)``
    powers: Index  # place of each entry, shape ``(E,)``
    rows: Index
    columns: Index
    values: ComplexArray  # shape ``(..., E)``

    @classmethod
    def of(cls, number: int, changes: ComplexArray) -> Self:
        """Derivatives by one input, of matrices of each power, shape ``(K, n, n)``."""
        powers, rows, columns = np.nonzero(changes)
        inputs = np.full(powers.size, number)
        return cls(inputs=inputs, powers=powers, rows=rows, columns=columns, values=changes[powers, rows, columns])

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Entries of several, those of one place to be added."""
        names = ("inputs", "powers", "rows", "columns", "values")
        return cls(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})

    def select(self, entries: Bool | Index, place: Index) -> Self:
        """Some of the entries, rows and columns at other places."""
        return replace(
            self,
            inputs=self.inputs[entries],
            powers=self.powers[entries],
            rows=place[self.rows[entries]],
            columns=place[self.columns[entries]],
            values=self.values[..., entries],
        )


def _last(values: Float) -> Float:
    """Answer of a compiled function, shape ``(n, ...)``, with its entries last."""
    return values if values.ndim == 1 else values.transpose(*range(1, values.ndim), 0)


class CompiledModel:
    """Vectorised coefficient functions of a model, made once from its CasADi graph."""

    def __init__(self, symbolic: Symbolic) -> None:
        theta, speed, eccentricity, matrices, factors = symbolic
        size = matrices[0].shape[0]
        self._shape = (len(matrices), size, size)
        self.n_parameters = int(theta.numel())
        inputs = ca.vertcat(theta, speed, eccentricity)
        # Row-major order, as NumPy reshapes.
        flat = [part for m in matrices for part in (ca.vec(m.re.T), ca.vec(m.im.T))]
        parts = ca.densify(ca.vertcat(*flat))
        self.graph = ca.Function("coefficients", [inputs], [parts])
        self._values = array_function(self.graph)
        jacobian = ca.jacobian(parts, inputs)
        # Real and imaginary nonzeros of the Jacobian are merged to complex entries (power, row, column, input).
        row, column = (np.asarray(index, dtype=np.intp) for index in jacobian.sparsity().get_triplet())
        power, rest = np.divmod(row, 2 * size * size)
        imaginary, place = np.divmod(rest, size * size)
        entries, entry = np.unique((column * len(matrices) + power) * size * size + place, return_inverse=True)
        self._real, self._imag = np.flatnonzero(imaginary == 0), np.flatnonzero(imaginary == 1)
        self.real_entry, self.imag_entry = entry[self._real], entry[self._imag]
        self.inputs, rest = np.divmod(entries, len(matrices) * size * size)
        self.powers, place = np.divmod(rest, size * size)
        self.rows, self.columns = np.divmod(place, size)
        self.jacobian_graph = ca.Function("coefficient_jacobian", [inputs], [jacobian])
        self._jacobian = array_function(self.jacobian_graph)
        readout = ca.densify(ca.vertcat(*[part for f in factors for part in (f.re, f.im)]))
        self.factor_graph = ca.Function("factors", [inputs], [readout])
        self._factors = array_function(self.factor_graph)
        factor_jacobian = ca.densify(ca.jacobian(readout, theta))
        self._factor_jacobian = array_function(ca.Function("factor_jacobian", [inputs], [factor_jacobian]))
        self.has_probe_factors = bool(ca.depends_on(readout, theta))

    def _arguments(self, theta: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike) -> list[Float]:
        theta = np.asarray(theta, dtype=float)
        if theta.shape[-1] != self.n_parameters:
            raise ValueError(f"parameter vector has {theta.shape[-1]} entries, the model {self.n_parameters}")
        # Scalars stay scalars: a single evaluation costs a fraction of one with arrays of one element.
        parameters = list(theta) if theta.ndim == 1 else [theta[..., i] for i in range(self.n_parameters)]
        return [*parameters, np.asarray(speed, dtype=float)[()], np.asarray(eccentricity, dtype=float)[()]]

    def values(self, theta: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike) -> ComplexArray:
        """Coefficient matrices, shape ``(..., order + 1, n, n)``."""
        flat = _last(self._values(self._arguments(theta, speed, eccentricity)))
        powers, size, _ = self._shape
        parts = flat.reshape(*flat.shape[:-1], powers, 2, size, size)
        return np.asarray(parts[..., 0, :, :] + 1j * parts[..., 1, :, :])

    def jacobian(self, theta: ArrayLike, speed: ArrayLike, eccentricity: ArrayLike = 0.0) -> CoefficientJacobian:
        """Derivatives of the coefficients with respect to parameters, speed and eccentricity."""
        flat = _last(self._jacobian(self._arguments(theta, speed, eccentricity)))
        values = np.zeros((*flat.shape[:-1], self.inputs.size), dtype=complex)
        values.real[..., self.real_entry] = flat[..., self._real]
        values.imag[..., self.imag_entry] = flat[..., self._imag]
        return CoefficientJacobian(
            inputs=self.inputs, powers=self.powers, rows=self.rows, columns=self.columns, values=values
        )

    def factors(self, theta: ArrayLike) -> ComplexArray:
        """Probe factors, shape ``(..., n)``."""
        flat = np.moveaxis(self._factors(self._arguments(theta, 0.0, 0.0)), 0, -1)
        return np.asarray(flat[..., 0::2] + 1j * flat[..., 1::2])

    def factor_jacobian(self, theta: ArrayLike) -> ComplexArray:
        """Derivatives of the probe factors, shape ``(..., n, P)``."""
        flat = np.moveaxis(self._factor_jacobian(self._arguments(theta, 0.0, 0.0)), 0, -1)
        size = self._shape[1]
        parts = np.swapaxes(flat.reshape(*flat.shape[:-1], self.n_parameters, 2 * size), -1, -2)
        return np.asarray(parts[..., 0::2, :] + 1j * parts[..., 1::2, :])
