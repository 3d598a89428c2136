"""Vectorised responses and exact sensitivities of a model along many lines.

With ``kappa A = F`` and ``H = inv(kappa)``, ``dA = -H dkappa A``. CasADi gives kappa's coefficients and their derivatives
once for each (parameter group, speed); all that depends on the frequency is array arithmetic here, so that the cost
grows with the lines and not with the size of a symbolic inverse.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from rotorfit.estimators.observations import Responses

Float = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_CHUNK = 200_000  # entries of the sensitivity product held at once, 16 bytes each


def inverse(kappa: ComplexArray) -> ComplexArray:
    """Inverse of many small matrices, shape ``(L, n, n)``; one and two rows in closed form."""
    if kappa.shape[-1] == 1:
        return np.asarray(1.0 / kappa)
    if kappa.shape[-1] > 2:
        return np.asarray(np.linalg.inv(kappa))
    a, b, c, d = kappa[:, 0, 0], kappa[:, 0, 1], kappa[:, 1, 0], kappa[:, 1, 1]
    determinant = a * d - b * c
    result = np.empty_like(kappa)
    result[:, 0, 0], result[:, 0, 1], result[:, 1, 0], result[:, 1, 1] = d, -b, -c, a
    result /= determinant[:, None, None]
    return result


def dynamic_stiffness(block: Responses, theta: Float) -> ComplexArray:
    """Dynamic stiffness of every line, shape ``(L, n, n)``."""
    index, group, speed = block.condition
    coefficients = block.model.coefficients(theta[group], speed)
    s = block.s[:, None, None]
    kappa = coefficients[index, -1]
    for power in range(coefficients.shape[1] - 2, -1, -1):
        kappa = kappa * s + coefficients[index, power]
    return kappa


def _sensitivities(
    block: Responses, theta: Float, left: ComplexArray, right: ComplexArray, lines: NDArray[np.intp]
) -> ComplexArray:
    """``-left dkappa right`` for each reading and parameter, shape ``(R, P)``.

    Args:
        left: row vector of each reading, shape ``(R, n)``.
        right: column vector of each reading, shape ``(R, n)``.
        lines: line of each reading, shape ``(R,)``.
    """
    index, group, speed = block.condition
    jacobian = block.model.functions.jacobian(theta[group], speed)
    n_parameters = theta.shape[1]
    used = np.flatnonzero(jacobian.inputs < n_parameters)
    inputs, powers = jacobian.inputs[used], jacobian.powers[used]
    scatter = np.zeros((used.size, n_parameters))
    scatter[np.arange(used.size), inputs] = -1.0
    result = np.empty((lines.size, n_parameters), dtype=complex)
    step = max(1, _CHUNK // max(used.size, 1))
    for start in range(0, lines.size, step):
        part = slice(start, start + step)
        line = lines[part]
        s_powers = block.s[line, None] ** np.arange(block.model.order + 1)
        entries = s_powers[:, powers] * jacobian.values[index[line]][:, used]
        entries *= left[part][:, jacobian.rows[used]]
        entries *= right[part][:, jacobian.columns[used]]
        # Real times real: BLAS has no product of complex with real.
        result[part].real = entries.real @ scatter
        result[part].imag = entries.imag @ scatter
    return result


def respond(block: Responses, theta: Float, jacobian: bool = False) -> tuple[ComplexArray, ComplexArray | None]:
    """Predicted readings, and on request their derivatives.

    Args:
        block: the readings.
        theta: parameter vectors of the groups, shape ``(G, P)``.
        jacobian: whether to differentiate.

    Returns:
        readings, shape ``(R,)``, and derivatives by the group's parameters, shape ``(R, P)``.
    """
    line, coordinate = block.line, block.coordinate
    functions = block.model.functions
    H = inverse(dynamic_stiffness(block, theta))
    amplitude = np.einsum("lij,lj->li", H, block.force)
    predicted = amplitude[line, coordinate]
    derivative = _sensitivities(block, theta, H[line, coordinate], amplitude[line], line) if jacobian else None
    if functions.has_probe_factors:
        group = block.reading_group
        factor = functions.factors(theta)[group, coordinate]
        if derivative is not None:
            slope = functions.factor_jacobian(theta)[group, coordinate]
            derivative = derivative * factor[:, None] + slope * predicted[:, None]
        predicted = predicted * factor
    return predicted, derivative


def displacement_to_force(
    block: Responses, theta: Float, jacobian: bool = False
) -> tuple[ComplexArray, ComplexArray | None]:
    """Force at the plane of an imposed orbit while the other planes are free (eqs 14 to 17).

    The force is the displacement over the drive-point receptance; with one plane, ``kappa A``.
    Arguments and results as for :func:`respond`.
    """
    line, coordinate = block.line, block.coordinate
    H = inverse(dynamic_stiffness(block, theta))
    drive = H[line, coordinate, coordinate]
    predicted = block.force[line, coordinate] / drive
    if not jacobian:
        return predicted, None
    by_drive = _sensitivities(block, theta, H[line, coordinate], H[line, :, coordinate], line)
    return predicted, by_drive * (-predicted / drive)[:, None]
