"""Where an eigenvalue meets the imaginary axis: the equation of motion with s = j w, solved for w and the speed.

Newton's method of CasADi on the graph of the model takes a tenth of the time of a search along growth rates, each of
which needs all eigenvalues.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.complexes import Complex

_STEPS = 20
_SETTLED = 1e-12  # residual, over the largest entry of the dynamic stiffness, of a root


class OnsetEquations:
    """Free motion ``kappa(j w, Om) v = 0`` of a model without eccentricity, and its solution near a given one."""

    def __init__(self, theta: ca.SX, speed: ca.SX, matrices: Sequence[Complex]) -> None:
        """Build the equations.

        Args:
            theta: symbols of the parameters.
            speed: symbol of the rotative speed.
            matrices: coefficients of s^0, s^1, ...
        """
        n = matrices[0].shape[0]
        unknown, shape, sizes = ca.SX.sym("unknown", 2), ca.SX.sym("shape", 2 * n), ca.SX.sym("sizes", 3)
        first = ca.SX.sym("first", 2 * n)
        w, at = unknown[0] * sizes[0], unknown[1] * sizes[1]
        kappa = Complex(ca.SX.zeros(n, n))
        for power, matrix in enumerate(matrices):
            kappa = kappa + matrix * Complex.of(1j**power) * w**power
        re, im = (ca.substitute(part, speed, at) / sizes[2] for part in (kappa.re, kappa.im))
        x, y = shape[:n], shape[n:]
        # One complex equation keeps the shape from vanishing and from turning.
        equations = ca.vertcat(
            re @ x - im @ y, re @ y + im @ x, ca.dot(first, shape) - 1, ca.dot(first, ca.vertcat(-y, x))
        )
        given = ca.vertcat(theta, first, sizes)
        graph = ca.Function("onset", [ca.vertcat(unknown, shape), given], [equations])
        options = {"abstol": _SETTLED, "max_iter": _STEPS, "error_on_fail": False}
        self._solver = ca.rootfinder("onset", "fast_newton", graph, options)

    def near(self, theta: Float, speed: float, s: complex, kappa: ComplexArray) -> float | None:
        """Speed at which an eigenvalue lies on the imaginary axis; ``None`` where Newton's method does not end.

        Args:
            theta: parameter vector, shape ``(P,)``.
            speed: a speed near it, rad/s.
            s: the eigenvalue there.
            kappa: dynamic stiffness at both, shape ``(n, n)``.
        """
        shape = np.linalg.svd(kappa)[2][-1].conj()
        first = np.concatenate([shape.real, shape.imag])
        sizes = [abs(s), speed, float(np.abs(kappa).max())]
        found = self._solver(np.concatenate([[s.imag / abs(s), 1.0], first]), np.concatenate([theta, first, sizes]))
        return float(found[1]) * speed if self._solver.stats()["success"] else None
