"""Residuals given as a CasADi expression, with exact derivatives of both orders."""

from __future__ import annotations

import threading
from typing import Any

import casadi as ca
import numpy as np

from rotorfit.estimators.minimisation.objective import Matrix, Vector


class SymbolicResiduals:
    """An :class:`Objective` from a CasADi expression: half the sum of squares of ``residuals(x)``.

    Args:
        residuals: dense or sparse ``casadi.SX`` column of m residuals.
        x: the ``casadi.SX`` column of n symbols they depend on.

    Raises:
        ValueError: if either argument is not a column or the residuals contain other symbols.
    """

    def __init__(self, residuals: Any, x: Any) -> None:
        for name, value in (("residuals", residuals), ("x", x)):
            if value.shape[1] != 1 or value.shape[0] < 1:
                raise ValueError(f"{name} has shape {value.shape}; a column with at least one row is needed")
        foreign = sorted({str(s) for s in ca.symvar(residuals)} - {str(s) for s in ca.symvar(x)})
        if foreign:
            raise ValueError(f"residuals depend on {foreign}, which are not among the variables {x}")
        residuals = ca.densify(residuals)
        half = ca.sumsqr(residuals) / 2
        self._residuals = _Evaluator(ca.Function("residuals", [x], [residuals]))
        self._jacobian = _Evaluator(ca.Function("jacobian", [x], [ca.densify(ca.jacobian(residuals, x))]))
        self._hessian = _Evaluator(ca.Function("hessian", [x], [ca.densify(ca.hessian(half, x)[0])]))

    def residuals(self, x: Vector) -> Vector:
        """Residuals at ``x``, shape (m,)."""
        return self._residuals(x)[:, 0]

    def jacobian(self, x: Vector) -> Matrix:
        """Derivatives of the residuals, shape (m, n)."""
        return self._jacobian(x)

    def cost(self, x: Vector) -> float:
        """Half the sum of squares at ``x``."""
        r = self.residuals(x)
        return 0.5 * float(r @ r)

    def gauss_newton(self, x: Vector) -> tuple[float, Vector, Matrix]:
        """Cost, gradient Jᵀr and matrix JᵀJ at ``x``."""
        r = self.residuals(x)
        J = self.jacobian(x)
        return 0.5 * float(r @ r), r @ J, J.T @ J

    def hessian(self, x: Vector) -> Matrix:
        """Exact Hessian of half the sum of squares at ``x``, shape (n, n)."""
        return self._hessian(x)


class _Evaluator:
    """A CasADi function of one vector with one dense output, called without building CasADi matrices."""

    def __init__(self, function: Any) -> None:
        rows, columns = function.size_out(0)
        self._buffer, self._trigger = function.buffer()
        self._input = np.zeros(function.size1_in(0))
        self._output = np.zeros((columns, rows))  # CasADi stores columns first
        self._buffer.set_arg(0, self._input.data)
        self._buffer.set_res(0, self._output.data)
        self._lock = threading.Lock()

    def __call__(self, x: Vector) -> Matrix:
        with self._lock:
            self._input[:] = x
            self._trigger()
            return self._output.T.copy()
