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
    if speed.size > 1:
        coefficients = coefficients[index]
    s = block.s[:, None, None]
    kappa = coefficients[:, -1] * s
    for power in range(coefficients.shape[1] - 2, 0, -1):
        kappa += coefficients[:, power]
        kappa *= s
    kappa += coefficients[:, 0]
    return np.asarray(kappa)


def _sensitivities(block: Responses, theta: Float, left: ComplexArray, right: ComplexArray) -> ComplexArray:
    """``-left dkappa right`` for each reading and parameter, shape ``(R, P)``.

    Few products ``left_row s^power right_column`` are shared by all parameters, so that the work along the lines is to
    make those and to multiply them by a small matrix.

    Args:
        left: row vector of each reading, shape ``(R, n)``.
        right: column vector of each reading, shape ``(R, n)``.
    """
    _, group, speed = block.condition
    jacobian = block.model.functions.jacobian(theta[group], speed)
    n_parameters = theta.shape[1]
    used = np.flatnonzero(jacobian.inputs < n_parameters)
    size, powers = block.model.order + 1, jacobian.powers[used]
    key = (jacobian.rows[used] * left.shape[1] + jacobian.columns[used]) * size + powers
    products, place = np.unique(key, return_inverse=True)
    weight = np.zeros((speed.size, products.size, n_parameters), dtype=complex)
    weight[:, place, jacobian.inputs[used]] = -jacobian.values[:, used]
    s_powers = block.s_powers
    basis = np.empty((products.size, left.shape[0]), dtype=complex)
    for number, (pair, power) in enumerate(zip(*(part.tolist() for part in np.divmod(products, size)), strict=True)):
        row, column = divmod(pair, left.shape[1])
        np.multiply(left[:, row], right[:, column], out=basis[number])
        if power:
            basis[number] *= s_powers[power]
    if speed.size == 1:
        return np.asarray((weight[0].T @ basis).T)
    result = np.empty((n_parameters, left.shape[0]), dtype=complex)
    for number, readings in enumerate(block.condition_readings):
        result[:, readings] = weight[number].T @ basis[:, readings]
    return result.T


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
    derivative = _sensitivities(block, theta, H[line, coordinate], amplitude[line]) if jacobian else None
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
    by_drive = _sensitivities(block, theta, H[line, coordinate], H[line, :, coordinate])
    return predicted, by_drive * (-predicted / drive)[:, None]
