"""Motion in time of a rotor whose fluid changes with its eccentricity, in equal steps of Runge and Kutta."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.models.complexes import Complex
from rotorfit.models.model import RotorModel
from rotorfit.models.motion.journal import journal

_FOLLOWED = 1000.0  # rate at which a coordinate without mass returns to what its row demands, 1/s


class RowsInTime:
    """Rows of the equation of motion that have no inertia, as those of a probe between planes or of a film that
    remembers, multiplied by ``1 + s / r`` until they have: any motion that fulfils a row goes on fulfilling it."""

    def __init__(self, coefficients: ComplexArray) -> None:
        """By coefficients of s^0, s^1, s^2, shape ``(..., 3, n, n)``."""
        there = np.asarray(coefficients.reshape(-1, *coefficients.shape[-3:]).any(axis=(0, 3)))
        lacking = np.where(there[2], 0, np.where(there[1], 1, 2))
        self.massless = np.flatnonzero(lacking)
        self._once, self._twice = np.diag(1.0 * (lacking == 1)), np.diag(1.0 * (lacking == 2))

    def of(self, coefficients: ComplexArray) -> ComplexArray:
        """The coefficients with rows that tell the acceleration, same shape."""
        stiffness, damping, mass = np.moveaxis(coefficients, -3, 0)
        return np.stack(self.parts(stiffness, damping, mass, self._once, self._twice), axis=-3)

    def real_parts(self, stiffness: ca.SX, damping: ca.SX, mass: ca.SX) -> list[ca.SX]:
        """The same of matrices that act on real parts, then imaginary ones."""
        once, twice = (ca.DM(np.kron(np.eye(2), rows)) for rows in (self._once, self._twice))
        return self.parts(stiffness, damping, mass, once, twice)

    @staticmethod
    def parts(stiffness: Any, damping: Any, mass: Any, once: Any, twice: Any) -> list[Any]:
        """Matrices whose rows are multiplied, once or twice."""
        slower = damping + (once + 2 * twice) @ stiffness / _FOLLOWED
        return [stiffness, slower, mass + once @ damping / _FOLLOWED + twice @ stiffness / _FOLLOWED**2]


class TimeSteps:
    """Equal steps of ``C0(eps) z + C1(eps) z' + C2(eps) z'' = f``, the speed and the eccentricity those of the moment:
    the classical method of fourth order, all steps of a block by one compiled graph."""

    def __init__(self, model: RotorModel, theta: Float, step: float, count: int) -> None:
        self._size = size = len(model.coordinates)
        parameters, speed, eccentricity, matrices, _ = model.symbolic
        seat, given = journal(model), ca.SX.sym("given", 2 * size + 1)
        z, v = ca.SX.sym("z", 2 * size), ca.SX.sym("v", 2 * size)
        rows = RowsInTime(model.coefficients(theta, 0.0))
        stiffness, damping, mass = rows.real_parts(*(_real(matrix) for matrix in matrices))
        orbit = ca.hypot(z[seat.at], z[size + seat.at]) / seat.clearance
        pull = ca.solve(mass, given[1:] - stiffness @ z - damping @ v)
        pull = ca.substitute(pull, ca.vertcat(parameters, speed), ca.vertcat(*theta.tolist(), given[0]))
        slope = ca.Function(
            "slope", [ca.vertcat(z, v), given], [ca.vertcat(v, ca.substitute(pull, eccentricity, orbit))]
        )
        state, three = ca.SX.sym("state", 4 * size), ca.SX.sym("three", 3 * (2 * size + 1))
        begin, middle, end = ca.vertsplit(three, 2 * size + 1)
        first = slope(state, begin)
        second = slope(state + step / 2 * first, middle)
        third = slope(state + step / 2 * second, middle)
        fourth = slope(state + step * third, end)
        after = state + step / 6 * (first + 2 * second + 2 * third + fourth)
        self._path = ca.Function("step", [state, three], [ca.cse(after)]).mapaccum(count)

    def path(self, state: ComplexArray, speed: Float, force: ComplexArray) -> ComplexArray:
        """Displacements and velocities after every step.

        Args:
            state: displacements and velocities before the first, shape ``(2, n)``.
            speed: rotative speed at the begin, in the middle and at the end of every step, shape ``(2 count + 1,)``.
            force: force at these instants, shape ``(2 count + 1, n)``.

        Returns:
            shape ``(count, 2, n)``; what leaves the clearance by far is not a number.
        """
        given = np.column_stack([speed, force.real, force.imag])
        acting = np.hstack([given[:-2:2], given[1:-1:2], given[2::2]])
        begin = np.stack([state.real, state.imag], axis=1).ravel()
        found = np.asarray(self._path(begin, acting.T)).T.reshape(-1, 2, 2, self._size)
        return np.asarray(found[:, :, 0] + 1j * found[:, :, 1])


def _real(matrix: Complex) -> ca.SX:
    """A complex matrix as it acts on real parts, then imaginary ones."""
    return ca.vertcat(ca.horzcat(matrix.re, -matrix.im), ca.horzcat(matrix.im, matrix.re))
