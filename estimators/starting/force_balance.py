"""The balance of forces at every line, linear in a model's lumped coefficients, and the measured dynamic stiffness."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import reduce

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.blocks.response import inverse, known_lines
from rotorfit.estimators.starting.lumped import Lumped


class ForceBalance:
    """Equations of motion ``kappa A = F`` of one block, linear in the independent lumped coefficients."""

    def __init__(self, lumped: Lumped, number: int, block: Responses, typical: Float) -> None:
        self.block = block
        # A known structure goes to the side of the forces; its scale factors, not linear here, stay typical.
        known = known_lines(block, typical)
        self._known = None if known is None else np.moveaxis(known.values, -1, 0)
        if block.imposed:
            self.amplitude, self.force, self.sigma = block.force, block.measured[:, None], block.sigma[:, None]
        else:
            self.amplitude, self.sigma = block.amplitudes()
            self.force = block.force
        place, combine = lumped.place, np.column_stack([lumped.spread, lumped.offset])
        condition, group, speed = block.condition
        self._columns = combine.shape[1]
        # Dynamic stiffness by a unit of each unknown, and last what none of them changes: of row, column and unknown.
        self._terms: dict[tuple[int, int, int], ComplexArray] = {}
        for e in np.flatnonzero(place.block == number).tolist():
            here = (place.group[e] == group) & (np.isnan(place.speed[e]) | (place.speed[e] == speed))
            factor = (place.unit[e] * here * speed ** place.speed_power[e])[condition] * block.s ** place.power[e]
            for unknown in np.flatnonzero(combine[e]).tolist():
                key = int(place.row[e]), int(place.column[e]), unknown
                self._terms[key] = self._terms.get(key, 0) + combine[e, unknown] * factor

    def receptance(self, solution: Float) -> ComplexArray:
        """Receptance of each line from the independent lumped coefficients, shape ``(L, n, n)``."""
        count, n = self.amplitude.shape
        kappa = np.zeros((n, n, count), dtype=complex)
        for (row, column, unknown), factor in self._terms.items():
            kappa[row, column] += factor * (solution[unknown] if unknown < solution.size else 1.0)
        return inverse(np.moveaxis(kappa, -1, 0) + (0.0 if self._known is None else self._known))

    def predicted(self, H: ComplexArray) -> ComplexArray:
        """Amplitudes with a receptance, shape ``(L, n)``; imposed ones are what they are."""
        return self.block.force if self.block.imposed else np.asarray(np.einsum("lij,lj->li", H, self.block.force))

    def force_weight(self) -> Float:
        """Weight of each line that brings it to a force of one, shape ``(L,)``."""
        return np.asarray(1 / np.abs(self.force.T).max(axis=0))

    def response_weight(self, H: ComplexArray) -> ComplexArray:
        """Weights that turn the force error into the response error over its noise, independent between readings."""
        # Stored as H is: what runs along the lines is contiguous.
        return np.asarray((np.ones((1, 1, 1)) + 0j if self.block.imposed else H.T) / self.sigma.T.copy()).T

    def sides(self) -> ComplexArray:
        """Both sides of ``kappa A = F`` with the measured amplitudes, shape ``(n, B + 1, L)``."""
        return self._sides(self.amplitude, self.force)

    def sensitivities(self, amplitude: ComplexArray, weight: ComplexArray) -> Float:
        """The left sides alone, weighed, with other amplitudes than those measured, shape ``(n, B, 2 L)``."""
        return weigh(self._sides(amplitude, self.force)[:, :-1], weight)

    def _sides(self, amplitude: ComplexArray, force: ComplexArray) -> ComplexArray:
        """Both sides of kappa A = F, shape ``(n, B + 1, L)``."""
        count, n = amplitude.shape
        result = np.zeros((n, self._columns, count), dtype=complex)
        columns = np.ascontiguousarray(amplitude.T)
        for (row, column, unknown), factor in self._terms.items():
            result[row, unknown] += factor * columns[column]
        result[:, -1] = force.T - result[:, -1]
        if self._known is not None:
            result[:, -1] -= np.einsum("lij,lj->il", self._known, amplitude)
        return result

    def stiffness_balance(self) -> Float:
        """Entries of the inverted dynamic stiffness (eq. 7), equally weighted; force balance where there are none."""
        if self.block.imposed:
            return weigh(self.sides(), self.force_weight())
        stiffness = stiffness_matrices(self.block)
        if stiffness.kappa.size == 0:
            return weigh(self.sides(), np.ones(len(self.force)))
        systems = []
        for column in range(stiffness.kappa.shape[-1]):
            unit = np.zeros_like(self.amplitude)
            unit[:, column] = 1.0
            sides = self._sides(unit, np.zeros_like(unit))[:, :, stiffness.first_line]
            sides[:, -1] += stiffness.kappa[:, :, column].T
            systems.append(np.ascontiguousarray(sides).view(float))
        return np.concatenate(systems, axis=-1)


def weigh(sides: ComplexArray, weight: ComplexArray | Float) -> Float:
    """Sides ``(n, C, L)`` mixed by weights ``(L, n, n)``, or scaled by ``(L,)``, as real numbers ``(n, C, 2 L)``."""
    if weight.ndim == 1:
        return (sides * weight).view(float)
    mixed, product = np.empty_like(sides), np.empty_like(sides[0])
    for i, part in enumerate(mixed):
        np.multiply(sides[0], weight[:, i, 0], out=part)
        for j in range(1, len(sides)):
            np.multiply(sides[j], weight[:, i, j], out=product)
            np.add(part, product, out=part)
    return mixed.view(float)


def one_by_one(system: Float) -> Float:
    """Equations after one another, shape ``(C, 2 L n)``."""
    return np.swapaxes(system, 0, 1).reshape(system.shape[1], -1)


def products(left: Float, right: Float) -> Float:
    """Sums over all equations of the products of columns, shape ``(C, D)``."""
    return np.asarray((left @ np.swapaxes(right, 1, 2)).sum(axis=0))


def solve(systems: Callable[[], Iterable[Float]]) -> tuple[Float, Float]:
    """Least squares of systems that are made one after the other, and the products of the left sides. By normal
    equations, a tenth of the work of a triangle; that is made where digits of theirs would be lost."""
    projected = reduce(np.add, (products(system[:, :-1], system) for system in systems()))
    information = projected[:, :-1]
    unit, right, norm = _of_unit_length(projected, information)
    found = solve_definite(unit, right)
    if found is None:
        scale = np.append(norm, 1.0)[:, None]
        rows = [_triangle(one_by_one(system / scale).T) for system in systems()]
        triangle = _triangle(np.concatenate(rows))
        found = np.asarray(np.linalg.lstsq(triangle[:, :-1], triangle[:, -1], rcond=1e-13)[0], dtype=float)
    return found / norm, information


def solve_projected(projected: Float, information: Float) -> Float:
    """Solve equations projected on instruments, whose own products are the information."""
    unit, right, norm = _of_unit_length(projected, information)
    return np.asarray(np.linalg.solve(unit, right) / norm)


def solve_definite(unit: Float, right: Float) -> Float | None:
    """Solution of a symmetric system of unit diagonal, shape ``(p,)``; None where it is nearly singular."""
    try:
        pivots = np.linalg.cholesky(unit).diagonal()
    except np.linalg.LinAlgError:
        return None
    # Square of what is left of a column of unit length by those before it, down to which normal equations do
    smallest_pivot = 1e-8
    if pivots.min() ** 2 <= smallest_pivot:
        return None
    return np.asarray(np.linalg.solve(unit, right))


def _triangle(rows: Float) -> Float:
    """As few equations as unknowns with the same least-squares solution, shape ``(C, C)``."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _of_unit_length(projected: Float, information: Float) -> tuple[Float, Float, Float]:
    """Left and right side for columns of length one, shapes ``(B, B)`` and ``(B,)``, and the lengths."""
    norm = np.sqrt(information.diagonal())
    norm = np.where(norm > 0, norm, 1.0)
    scaled = projected / norm[:, None]
    return scaled[:, :-1] / norm, scaled[:, -1], norm


@dataclass(frozen=True, eq=False, kw_only=True)
class StiffnessMatrices:
    """Measured dynamic stiffness (eq. 7)."""

    frequency: Float  # rad/s, shape ``(N,)``; signed where forward and backward are apart
    speed: Float  # rad/s, shape ``(N,)``
    kappa: ComplexArray  # shape ``(N, n, n)``, N/m
    sigma: Float  # standard deviation of real and imaginary part of each entry, from the propagated noise, same shape
    first_line: Index  # line of the block that carries each frequency, shape ``(N,)``


def complete_lines(block: Responses) -> Responses:
    """The lines of a block that have a reading at every coordinate."""
    if block.imposed and len(block.model.coordinates) > 1:
        return block.lines(np.zeros(block.speed.size, dtype=bool))
    needed = 1 if block.imposed else len(block.model.coordinates)
    whole = np.bincount(block.line, minlength=block.speed.size) == needed
    return block if whole.all() else block.lines(whole)


def stiffness_matrices(block: Responses) -> StiffnessMatrices:
    """Invert the response matrix at every frequency at which all planes were forced (eqs 5 and 7). In models with x and
    y apart the forward and the backward run at ``|w|`` make the 2n columns of eq. (5). Runs at one set speed belong
    together, however it was logged. Frequencies whose forces or readings are incomplete, and singular response
    matrices, are left out."""
    block = complete_lines(block)
    n = len(block.model.coordinates)
    amplitude, sigma = block.amplitudes()
    w = block.frequency if block.model.frame == "z" else np.abs(block.frequency)
    keys = np.column_stack([block.group, _rounded(block.set_speed), _rounded(w)])
    _, index = np.unique(keys, axis=0, return_inverse=True)
    order = np.argsort(index.reshape(-1), kind="stable")
    size = np.bincount(index.reshape(-1))
    begin = np.cumsum(size) - size
    kappa, error = np.empty((0, n, n), dtype=complex), np.empty((0, n, n))
    parts = [(np.empty(0, dtype=np.intp), kappa, error)]
    for count in np.unique(size[size >= n]).tolist():
        lines = order[begin[size == count][:, None] + np.arange(count)]
        A, F = np.swapaxes(amplitude[lines], 1, 2), np.swapaxes(block.force[lines], 1, 2)
        good = (np.linalg.matrix_rank(F) == n) & (np.linalg.matrix_rank(A) == n)
        lines, A, F = lines[good], A[good], F[good]
        # More runs than coordinates (repeats): least squares, kappa A = F.
        back = np.linalg.pinv(A)
        k = F @ back
        # d kappa = -kappa dA A^+, readings independent.
        variance = np.abs(k) ** 2 @ np.swapaxes(sigma[lines] ** 2, 1, 2) @ np.abs(back) ** 2
        parts.append((lines[:, 0], k, np.sqrt(variance)))
    first, kappa, error = (np.concatenate(column) for column in zip(*parts, strict=True))
    sort = np.lexsort([w[first], block.speed[first], block.group[first]])
    first = first[sort]
    return StiffnessMatrices(
        frequency=w[first], speed=block.speed[first], kappa=kappa[sort], sigma=error[sort], first_line=first
    )


def _rounded(values: Float) -> Float:
    """Values rounded to nine digits, so that equal conditions compare equal after unit conversion."""
    size = np.abs(values).max(initial=0.0)
    return np.round(values / size, 9) if size else values
