"""Vectorised responses and exact sensitivities of a model along many lines.

With ``kappa A = F`` and ``H = inv(kappa)``, ``dA = -H dkappa A``. CasADi gives kappa's coefficients and their
derivatives once for each (parameter group, speed); all that depends on the frequency is array arithmetic here, so that
the cost grows with the lines and not with the size of a symbolic inverse.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float, Index
from rotorfit.models.model import CompiledModel

if TYPE_CHECKING:
    from rotorfit.estimators.blocks.observations import Responses


def inverse(kappa: ComplexArray) -> ComplexArray:
    """Inverse of many small matrices; one and two rows in closed form.

    The result is stored as ``[column, row, line]``: what runs along the lines is contiguous.
    """
    n = kappa.shape[-1]
    result = np.empty((n, n, kappa.shape[0]), dtype=complex)
    if n == 1:
        np.divide(1.0, kappa[:, 0, 0], out=result[0, 0])
    elif n == 2:
        a, b, c, d = kappa[:, 0, 0], kappa[:, 0, 1], kappa[:, 1, 0], kappa[:, 1, 1]
        over = 1.0 / (a * d - b * c)
        np.multiply(d, over, out=result[0, 0])
        np.multiply(a, over, out=result[1, 1])
        np.negative(over, out=over)
        np.multiply(c, over, out=result[0, 1])
        np.multiply(b, over, out=result[1, 0])
    else:
        result[:] = np.linalg.inv(kappa).transpose(2, 1, 0)
    return result.transpose(2, 1, 0)


def dynamic_stiffness(block: Responses, theta: Float) -> ComplexArray:
    """Dynamic stiffness of every line, shape ``(L, n, n)``, stored as ``[row, column, line]``."""
    index, group, speed = block.condition
    if speed.size == 1:
        coefficients = block.model.coefficients(theta[group[0]], speed[0])[..., None]
    else:
        coefficients = np.moveaxis(block.model.coefficients(theta[group], speed), 0, -1)[..., index]
    kappa = np.empty((*coefficients.shape[1:3], block.s.size), dtype=complex)
    kappa[:] = coefficients[-1]
    for power in range(coefficients.shape[0] - 2, -1, -1):
        kappa *= block.s
        kappa += coefficients[power]
    known = block.known_stiffness(theta)
    if known is not None:
        kappa += np.moveaxis(known.values, 0, -1)
    return kappa.transpose(2, 0, 1)


@dataclass(frozen=True, eq=False)
class _Products:
    """Distinct products ``left_row s^power right_column`` that the sensitivities of a model consist of."""

    used: Index  # entries of the coefficients' Jacobian by parameters
    place: Index  # product of each of these entries
    factors: tuple[tuple[int, int, int], ...]  # row, column and power of each product


@lru_cache(maxsize=32)
def _products(functions: CompiledModel) -> _Products:
    used = np.flatnonzero(functions.inputs < functions.n_parameters)
    triples = np.column_stack([functions.rows[used], functions.columns[used], functions.powers[used]])
    distinct, place = np.unique(triples, axis=0, return_inverse=True)
    return _Products(used, place.reshape(-1), tuple((row, column, power) for row, column, power in distinct.tolist()))


def _sensitivities(block: Responses, theta: Float, left: ComplexArray, right: ComplexArray) -> ComplexArray:
    """``-left dkappa right`` for each parameter and reading, shape ``(P, R)``.

    Few products ``left_row s^power right_column`` are shared by all parameters, so that the work along the lines is to
    make those and to multiply them by a small matrix.
    """
    _, group, speed = block.condition
    products = _products(block.model.functions)
    alone = speed.size == 1
    jacobian = block.model.functions.jacobian(theta[group[0]] if alone else theta[group], speed[0] if alone else speed)
    weight = np.zeros((speed.size, theta.shape[1], len(products.factors)), dtype=complex)
    weight[:, jacobian.inputs[products.used], products.place] = -jacobian.values[..., products.used]
    basis = np.empty((len(products.factors), left.shape[1]), dtype=complex)
    s_powers = block.s_powers
    for number, (row, column, power) in enumerate(products.factors):
        np.multiply(left[row], right[column], out=basis[number])
        if power:
            basis[number] *= s_powers[power]
    if alone:
        result = np.asarray(weight[0] @ basis)
    elif block.stretch:
        parts = basis.reshape(len(basis), speed.size, block.stretch).swapaxes(0, 1)
        result = np.matmul(weight, parts).swapaxes(0, 1).reshape(theta.shape[1], -1)
    else:
        result = np.empty((theta.shape[1], left.shape[1]), dtype=complex)
        for number, readings in enumerate(block.condition_readings):
            result[:, readings] = weight[number] @ basis[:, readings]
    known = block.known_stiffness(theta)
    if known is not None:
        for place, slope in zip(known.inputs.tolist(), known.slopes, strict=True):
            result[place] -= np.einsum("ir,rij,jr->r", left, slope[block.line], right)
    return result


def respond(block: Responses, theta: Float, jacobian: bool = False) -> tuple[ComplexArray, ComplexArray | None]:
    """Predicted readings, and on request their derivatives.

    Returns:
        readings, shape ``(R,)``, and derivatives by the group's parameters, shape ``(R, P)``.
    """
    line, coordinate = block.line, block.coordinate
    functions = block.model.functions
    H = inverse(dynamic_stiffness(block, theta))
    count, n = block.force.shape
    amplitude = np.einsum("jil,lj->il", H.T, block.force)
    place = coordinate * count + line
    predicted = amplitude.reshape(-1).take(place)
    derivative = None
    if jacobian:
        left = H.T.reshape(n, -1).take(place, axis=1)
        derivative = _sensitivities(block, theta, left, amplitude.take(line, axis=1)).T
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
    by_drive = _sensitivities(block, theta, H[line, coordinate].T, H[line, :, coordinate].T).T
    return predicted, by_drive * (-predicted / drive)[:, None]
