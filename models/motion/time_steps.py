"""Motion in time of a rotor whose fluid changes with its eccentricity, in equal steps of Runge and Kutta."""

from __future__ import annotations

import casadi as ca
import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.models.complexes import Complex
from rotorfit.models.model import RotorModel
from rotorfit.models.motion.journal import journal


class TimeSteps:
    """Equal steps of ``C0(eps) z + C1(eps) z' + C2(eps) z'' = f``, the speed and the eccentricity those of the moment:
    the classical method of fourth order, all steps of a block by one compiled graph."""

    def __init__(self, model: RotorModel, theta: Float, step: float, count: int) -> None:
        self._size = size = len(model.coordinates)
        parameters, speed, eccentricity, matrices, _ = model.symbolic
        seat, given = journal(model), ca.SX.sym("given", 2 * size + 1)
        z, v = ca.SX.sym("z", 2 * size), ca.SX.sym("v", 2 * size)
        stiffness, damping, mass = (_real(matrix) for matrix in matrices)
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
