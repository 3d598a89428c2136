"""Vectorised responses and exact sensitivities of a model along many lines.

With ``kappa A = F`` and ``H = inv(kappa)``, ``dA = -H dkappa A``. CasADi gives kappa's coefficients and their
derivatives once for each (parameter group, speed); all that depends on the frequency is array arithmetic here, so that
the cost grows with the lines and not with the size of a symbolic inverse. Parameter vectors have the shape
``(..., G, P)``: several of them are evaluated as one is, their axes in front of that of the lines or readings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Protocol

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.estimators.blocks.term_sums import sum_of_terms, sum_of_terms_jacobian, sums_terms
from rotorfit.models.coefficients import CompiledModel
from rotorfit.models.model import RotorModel
from rotorfit.models.motion.journal import known_structure
from rotorfit.models.shafts.shaft import KnownStiffness

if TYPE_CHECKING:
    from rotorfit.estimators.blocks.observations import Responses


def inverse(kappa: ComplexArray) -> ComplexArray:
    """Inverse of many small matrices, shape ``(..., n, n)``."""
    return np.moveaxis(_inverse(np.moveaxis(kappa, (-2, -1), (0, 1))), (0, 1), (-1, -2))


def inverse_of_lines(kappa: ComplexArray) -> ComplexArray:
    """The same with lines along the last axis, shape ``(n, n, ...)``."""
    return np.swapaxes(_inverse(kappa), 0, 1)


def _inverse(kappa: ComplexArray) -> ComplexArray:
    """Inverse of matrices ``(row, column, ..., line)``, as ``(column, row, ..., line)``: rows are read one by one."""
    n = len(kappa)
    result = np.empty(kappa.shape, dtype=complex)
    if n == 1:
        np.divide(1.0, kappa, out=result)
    elif n == 2:
        (a, b), (c, d) = kappa
        over = 1.0 / (a * d - b * c)
        np.multiply(d, over, out=result[0, 0])
        np.multiply(a, over, out=result[1, 1])
        np.negative(over, out=over)
        np.multiply(c, over, out=result[0, 1])
        np.multiply(b, over, out=result[1, 0])
    else:
        result[:] = np.moveaxis(np.linalg.inv(np.moveaxis(kappa, (0, 1), (-2, -1))), (-1, -2), (0, 1))
    return result


def dynamic_stiffness(block: Responses, theta: Float) -> ComplexArray:
    """Dynamic stiffness of every line, shape ``(..., L, n, n)``."""
    return np.moveaxis(_stiffness(block, theta), (0, 1), (-2, -1))


def _coefficients(block: Responses, theta: Float) -> ComplexArray:
    """Coefficients of powers of s, shape ``(power, row, column, ..., line)``, one line where all are alike."""
    (index, group, speed), functions = block.condition, block.model.functions
    if speed.size == 1:
        coefficients = functions.values(theta[..., group[0], :], speed[0], 0.0)[..., None, :, :, :]
    else:
        coefficients = functions.values(theta[..., group, :], speed, 0.0)
    axes = coefficients.ndim - 3
    coefficients = coefficients.transpose(axes, axes + 1, axes + 2, *range(axes))
    return coefficients[..., index] if speed.size > 1 else coefficients


def _stiffness(block: Responses, theta: Float) -> ComplexArray:
    """Dynamic stiffness, shape ``(row, column, ..., line)``: what runs along the lines is contiguous."""
    coefficients = _coefficients(block, theta)
    kappa = np.empty((*coefficients.shape[1:-1], block.s.size), dtype=complex)
    kappa[:] = coefficients[-1]
    for power in range(len(coefficients) - 2, -1, -1):
        kappa *= block.s
        kappa += coefficients[power]
    known = known_lines(block, theta)
    if known is not None:
        kappa += known.values
    return kappa


def known_lines(block: Responses, theta: Float) -> KnownStiffness | None:
    """Contribution of a known structure, and of what acts beside the model, lines along the last axis; None without."""
    shaft = None
    if block.model.shaft is not None:
        shaft = known_structure(block.model, theta[..., block.group, :], block.s, block.speed)
    if block.beside is None:
        return shaft
    beside = np.moveaxis(block.beside, 0, -1)
    beside = beside.reshape(*beside.shape[:2], *(1,) * (theta.ndim - 2), -1)
    if shaft is None:  # nothing with scale factors
        return KnownStiffness(beside, np.zeros(0, dtype=np.intp), np.zeros((0, *beside.shape), dtype=complex))
    return replace(shaft, values=shaft.values + beside)


@dataclass(frozen=True, eq=False)
class _Products:
    """Distinct products ``left_row s^power right_column``, or j times one, that a model's sensitivities consist of."""

    factors: tuple[tuple[int, int, int, int], ...]  # row, column, power of s, and whether times j, of each product
    entries: tuple[Index, Index]  # of the coefficients' Jacobian by parameters, those with a real and an imaginary part
    places: tuple[Index, Index]  # product of each of these entries


@lru_cache(maxsize=32)
def _products(functions: CompiledModel) -> _Products:
    entries = [e[functions.inputs[e] < functions.n_parameters] for e in (functions.real_entry, functions.imag_entry)]
    keys = [
        np.column_stack([functions.rows[e], functions.columns[e], functions.powers[e], np.full(e.size, part)])
        for part, e in enumerate(entries)
    ]
    distinct, place = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    real, imag = np.split(place.reshape(-1), [entries[0].size])
    return _Products(tuple(tuple(row) for row in distinct.tolist()), (entries[0], entries[1]), (real, imag))


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Derivatives of readings: few products along the readings times real numbers of each (group, speed)."""

    products: ComplexArray  # shape ``(..., K, R)``
    numbers: Float  # shape ``(..., C, P, K)``

    def derivatives(self, block: Responses) -> ComplexArray:
        """Derivatives by the parameters, shape ``(..., P, R)``."""
        shape = *self.products.shape[:-2], self.numbers.shape[-2]
        result = np.empty((*shape, self.products.shape[-1]), dtype=complex)
        for some, readings, part in by_condition(block, self.products):
            found = np.swapaxes(self.numbers[..., some, :, :] @ part, -3, -2)
            result[..., readings] = np.ascontiguousarray(found).reshape(*shape, -1).view(complex)
        return result


def by_condition(block: Responses, values: ComplexArray) -> Iterator[tuple[slice | Index, slice | Index, Float]]:
    """Values ``(..., K, R)`` by (group, speed): some pairs, their readings, both parts there ``(..., C, K, 2 m)``."""
    if block.stretch:  # a view: nothing is copied
        real = values.view(float).reshape(*values.shape[:-1], -1, 2 * block.stretch)
        yield slice(None), slice(None), np.swapaxes(real, -3, -2)
        return
    for some, readings in block.conditions_alike:
        part = np.ascontiguousarray(values[..., readings]).view(float)
        yield some, readings.reshape(-1), np.swapaxes(part, -3, -2)


def _sensitivities(block: Responses, theta: Float, left: ComplexArray, right: ComplexArray) -> Sensitivities:
    """``-left dkappa right`` for each parameter and reading, of rows and columns of shape ``(n, ..., R)``."""
    _, group, speed = block.condition
    functions = block.model.functions
    plan = _products(functions)
    if speed.size == 1:
        values = functions.jacobian(theta[..., group[0], :], speed[0]).values[..., None, :]
    else:
        values = functions.jacobian(theta[..., group, :], speed).values
    numbers = np.zeros((*values.shape[:-1], theta.shape[-1], len(plan.factors)))
    for part, entries, places in zip((values.real, values.imag), plan.entries, plan.places, strict=True):
        numbers[..., functions.inputs[entries], places] = -part[..., entries]
    products = np.empty((*left.shape[1:-1], len(plan.factors), left.shape[-1]), dtype=complex)
    for number, (row, column, power, turned) in enumerate(plan.factors):
        one = products[..., number, :]
        np.multiply(left[row], right[column], out=one)
        if turned:
            one *= block.turned_powers[power]
        elif power:
            one *= block.s_powers[power]
    return Sensitivities(products, numbers)


def _read(block: Responses, values: ComplexArray, axis: int = 0) -> ComplexArray:
    """Readings, shape ``(..., R)``, of what every coordinate, along an axis, does in every line, ``(n, ..., L)``."""
    beside = values if values.ndim == axis + 2 else np.moveaxis(values, axis, -2)
    return beside.reshape(*beside.shape[:-2], -1).take(block.place, axis=-1)


def _rows(block: Responses, H: ComplexArray) -> ComplexArray:
    """The row of H that each reading is of, shape ``(n, ..., R)``."""
    return _read(block, H, axis=1)


def _receptance(block: Responses, theta: Float) -> ComplexArray:
    """Inverse of the dynamic stiffness, shape ``(column, row, ..., L)``; that of one vector is kept until the next."""
    if theta.ndim > 2:
        return _inverse(_stiffness(block, theta))
    key, kept = theta.tobytes(), block.receptances
    if (found := kept.get(key)) is None:
        found = _inverse(_stiffness(block, theta))
        kept.clear()
        kept[key] = found
    return found


def response_sensitivities(
    block: Responses, theta: Float, scale: ComplexArray | Float
) -> tuple[ComplexArray, Sensitivities]:
    """Readings of a rotor without known structure or probe factors; their derivatives times a scale ``(..., R)``."""
    H = _receptance(block, theta)
    amplitude = _amplitude(block, H)
    left = _rows(block, H)
    left *= scale
    return _read(block, amplitude), _sensitivities(block, theta, left, amplitude.take(block.line, axis=-1))


def respond(block: Responses, theta: Float) -> ComplexArray:
    """Predicted readings, shape ``(..., R)``."""
    if sums_terms(block):
        return sum_of_terms(block, theta)
    return read_by_probes(block, theta, _read(block, _amplitude(block, _receptance(block, theta))))


def respond_jacobian(block: Responses, theta: Float) -> tuple[ComplexArray, ComplexArray]:
    """Predicted readings, shape ``(..., R)``, and derivatives by the group's parameters, shape ``(..., P, R)``."""
    if sums_terms(block):
        return sum_of_terms_jacobian(block, theta)
    H = _receptance(block, theta)
    amplitude = _amplitude(block, H)
    derivative = _derivatives(block, theta, _rows(block, H), amplitude.take(block.line, axis=-1))
    predicted, by_theta = read_by_probes_jacobian(
        block, theta, _read(block, amplitude), np.swapaxes(derivative, -1, -2)
    )
    return predicted, np.swapaxes(by_theta, -1, -2)


class Read(Protocol):
    """Readings, each of a coordinate in a group."""

    @property
    def model(self) -> RotorModel:
        """The rotor."""

    @property
    def reading_group(self) -> Index:
        """Group of each reading."""

    @property
    def coordinate(self) -> Index:
        """Coordinate of each."""


def read_by_probes(block: Read, theta: Float, motion: ComplexArray) -> ComplexArray:
    """Readings of motion ``(..., R)`` by probes with factors."""
    return motion * probe_factors(block, theta) if block.model.functions.has_probe_factors else motion


def probe_factors(block: Read, theta: Float) -> ComplexArray:
    """Factor of the probe of each reading, shape ``(..., R)``; one where the model has none."""
    functions = block.model.functions
    if not functions.has_probe_factors:
        return np.ones(block.coordinate.size, dtype=complex)
    return functions.factors(theta)[..., block.reading_group, block.coordinate]


def read_by_probes_jacobian(
    block: Read, theta: Float, motion: ComplexArray, by_theta: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """The same with derivatives by the group's parameters, shape ``(..., R, P)``."""
    functions, group, coordinate = block.model.functions, block.reading_group, block.coordinate
    if not functions.has_probe_factors:
        return motion, by_theta
    factor = functions.factors(theta)[..., group, coordinate]
    slope = functions.factor_jacobian(theta)[..., group, coordinate, :]
    return motion * factor, by_theta * factor[..., None] + slope * motion[..., None]


def displacement_to_force(block: Responses, theta: Float) -> ComplexArray:
    """Force at the plane of an imposed orbit while the other planes are free (eqs 14 to 17), shape ``(..., R)``."""
    return block.force[block.line, block.coordinate] / _drive_point(block, _receptance(block, theta))


def displacement_to_force_jacobian(block: Responses, theta: Float) -> tuple[ComplexArray, ComplexArray]:
    """Force for an imposed motion and its derivatives, as :func:`respond_jacobian`."""
    H = _receptance(block, theta)
    drive = _drive_point(block, H)
    predicted = block.force[block.line, block.coordinate] / drive
    by_drive = _derivatives(block, theta, _rows(block, H), _rows(block, np.swapaxes(H, 0, 1)))
    return predicted, by_drive * (-predicted / drive)[..., None, :]


def _drive_point(block: Responses, H: ComplexArray) -> ComplexArray:
    """Receptance of each reading's own coordinate, shape ``(..., R)``."""
    return _read(block, np.einsum("ii...->i...", H))


def _amplitude(block: Responses, H: ComplexArray) -> ComplexArray:
    """Response of every coordinate in every line, shape ``(n, ..., L)``."""
    return np.asarray(np.einsum("ji...l,lj->i...l", H, block.force))


def _derivatives(block: Responses, theta: Float, left: ComplexArray, right: ComplexArray) -> ComplexArray:
    """``-left dkappa right`` for each parameter, shape ``(..., P, R)``."""
    result = _sensitivities(block, theta, left, right).derivatives(block)
    known = known_lines(block, theta)
    if known is not None:
        for place, slope in zip(known.inputs.tolist(), known.slopes, strict=True):
            result[..., place, :] -= np.einsum("i...r,ij...r,j...r->...r", left, slope[..., block.line], right)
    return result
