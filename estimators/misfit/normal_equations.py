"""Cost, gradient and Gauss-Newton matrix of many parameter vectors at once.

The derivatives of all readings are a few products ``left_row s^power right_column`` times real numbers that belong to
the vector alone (:func:`rotorfit.estimators.blocks.response.respond`). Sums over readings are therefore taken of those
products, and the derivatives themselves are never formed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TypeGuard

import numpy as np

from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.misfit.kernel_layout import is_plain
from rotorfit.estimators.misfit.losses import robust_weights
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models.array_types import ComplexArray, Float, Index
from rotorfit.models.model import CompiledModel

Normal = tuple[Float, Float, Float]

_AT_ONCE = 8192  # readings whose products are held at once, so that they stay in cache


class NormalEquations:
    """What :meth:`Problem.gauss_newton` answers, for many vectors."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._sums = [_Sums(problem, i, b) for i, b in enumerate(problem.blocks) if _is_summed(b)]

    def __call__(self, x: Float) -> Normal:
        """Cost, gradient and matrix, shapes ``(W,)``, ``(W, p)`` and ``(W, p, p)``, at vectors of shape ``(W, p)``."""
        problem = self._problem
        if len(self._sums) < len(problem.blocks):
            found = [problem.gauss_newton(row) for row in x]
            cost, gradient, matrix = (np.array(parts) for parts in zip(*found, strict=True))
            return cost, gradient, matrix
        cost, gradient = np.zeros(len(x)), np.zeros_like(x)
        matrix = np.zeros((*x.shape, x.shape[1]))
        for sums in self._sums:
            sums.add(x, cost, gradient, matrix)
        for prior in problem.priors:
            terms = np.array([prior.terms(float(value)) for value in x[:, prior.entry]])
            cost += terms[:, 0]
            gradient[:, prior.entry] += terms[:, 1]
            matrix[:, prior.entry, prior.entry] += terms[:, 2]
        return cost, gradient, matrix


def _is_summed(block: Block) -> TypeGuard[Responses]:
    """Whether the sums of a block are taken here: plain responses, few enough that many vectors at once save much."""
    if not isinstance(block, Responses) or block.measured.size > _AT_ONCE:
        return False
    return is_plain(block) and not block.model.functions.has_probe_factors


@dataclass(frozen=True, eq=False)
class _Products:
    """Distinct products that the derivatives of a model's responses are made of, times real numbers."""

    factors: tuple[tuple[int, int, int, int], ...]  # row, column, power of s, and whether times j, of each product
    entries: tuple[Index, Index]  # for the real and for the imaginary parts of the coefficients' Jacobian
    places: tuple[Index, Index]  # for the real and for the imaginary parts of the coefficients' Jacobian


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


class _Sums:
    """Sums over the readings of one block of a problem."""

    def __init__(self, problem: Problem, number: int, block: Responses) -> None:
        self._block, self._space, self._loss = block, problem.space, problem.loss
        self._nuisance = problem.factors[number] if problem.factors else None
        count = 0 if self._nuisance is None else self._nuisance.shape[1]
        products = _products(block.model.functions)
        self._factors, self._width = products.factors, len(products.factors) + count
        self._turned = {power: 1j * block.s_powers[power] for _, _, power, turned in self._factors if turned}
        self._place = block.coordinate * block.speed.size + block.line
        self._parts = [self._scattered(group, products) for group in block.condition[1].tolist()]

    def _scattered(self, group: int, products: _Products) -> list[tuple[Index, Index]]:
        """Entries of the real and of the imaginary part of a Jacobian, and their places in a matrix ``(p, K)``."""
        found = []
        for entries, places in zip(products.entries, products.places, strict=True):
            fitted = self._space.index[group, self._block.model.functions.inputs[entries]]
            free = fitted >= 0
            found.append((entries[free], fitted[free] * self._width + places[free]))
        return found

    def add(self, x: Float, cost: Float, gradient: Float, matrix: Float) -> None:
        """Add what the block has for vectors of shape ``(W, p)``."""
        _, groups, speeds = self._block.condition
        theta = self._space.theta(x)[:, groups]
        coefficients = np.moveaxis(self._block.model.coefficients(theta, speeds), 1, -1)
        numbers = self._numbers(theta, speeds)
        step = max(1, _AT_ONCE // self._block.measured.size)
        for begin in range(0, len(x), step):
            some = slice(begin, begin + step)
            self._add(x[some], coefficients[some], numbers[some], cost[some], gradient[some], matrix[some])

    def _numbers(self, theta: Float, speeds: Float) -> Float:
        """Real numbers by which the products make derivatives by the fitted vector, shape ``(W, C, p, K)``."""
        jacobian = self._block.model.functions.jacobian(theta, speeds)
        numbers = np.zeros((*theta.shape[:2], self._space.size * self._width))
        for condition, parts in enumerate(self._parts):
            mine = numbers[:, condition]
            for values, (entries, places) in zip((jacobian.values.real, jacobian.values.imag), parts, strict=True):
                np.subtract.at(mine.T, places, values[:, condition, entries].T)
        numbers = numbers.reshape(*theta.shape[:2], self._space.size, self._width)
        first = len(self._space.names)
        for i in range(self._width - len(self._factors)):
            numbers[..., first + i, len(self._factors) + i] = 1.0
        return numbers

    def _add(
        self, x: Float, coefficients: ComplexArray, numbers: Float, cost: Float, gradient: Float, matrix: Float
    ) -> None:
        block = self._block
        predicted, left, right = self._responses(coefficients)
        if self._nuisance is not None:
            gain = np.exp(x[:, len(self._space.names) :] @ self._nuisance.T)
            predicted *= gain
            left *= gain
        left /= block.sigma
        rows = self._rows(predicted, left, right)
        predicted -= block.measured
        predicted /= block.sigma
        if self._loss == "linear":
            parts = predicted.view(float)
            cost += 0.5 * np.einsum("wr,wr->w", parts, parts)
        else:
            rho, weight = robust_weights(self._loss, np.abs(predicted) ** 2)
            cost += 0.5 * rho.sum(axis=1)
            root = np.sqrt(weight)
            predicted *= root
            rows *= root[:, None]
        alone = numbers.shape[1] == 1
        for condition in range(numbers.shape[1]):
            some = slice(None) if alone else block.condition_readings[condition]
            stacked, misses = (np.ascontiguousarray(a[..., some]).view(float) for a in (rows, predicted))
            own = numbers[:, condition]
            gradient += (own @ (stacked @ misses[..., None]))[..., 0]
            matrix += own @ (stacked @ stacked.swapaxes(-1, -2)) @ own.swapaxes(-1, -2)

    def _responses(self, coefficients: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Predictions, shape ``(W, R)``, and the row and the column of each reading, shape ``(n, W, R)``."""
        block, vectors = self._block, len(coefficients)
        count, n = block.force.shape
        if coefficients.shape[-1] > 1:
            coefficients = coefficients[..., block.condition[0]]
        kappa = np.empty((n, n, vectors, count), dtype=complex)
        for i in range(n):
            for j in range(n):
                entry = kappa[i, j]
                entry[:] = coefficients[:, -1, i, j]
                for power in range(coefficients.shape[1] - 2, -1, -1):
                    entry *= block.s
                    entry += coefficients[:, power, i, j]
        H = _inverse(kappa)  # [column, vector, row, line]
        amplitude = np.einsum("jwil,lj->iwl", H, block.force)
        left = H.reshape(n, vectors, n * count).take(self._place, axis=2)
        predicted = amplitude.swapaxes(0, 1).reshape(vectors, n * count).take(self._place, axis=1)
        return predicted, left, amplitude.take(block.line, axis=2)

    def _rows(self, predicted: ComplexArray, left: ComplexArray, right: ComplexArray) -> ComplexArray:
        """Products at every reading over its noise, shape ``(W, K, R)``."""
        powers = self._block.s_powers
        rows = np.empty((len(predicted), self._width, predicted.shape[1]), dtype=complex)
        for number, (row, column, power, turned) in enumerate(self._factors):
            one = rows[:, number]
            np.multiply(left[row], right[column], out=one)
            if turned:
                one *= self._turned[power]
            elif power:
                one *= powers[power]
        if self._nuisance is not None:
            moved = predicted / self._block.sigma
            np.multiply(moved[:, None], self._nuisance.T, out=rows[:, len(self._factors) :])
        return rows


def _inverse(kappa: ComplexArray) -> ComplexArray:
    """Inverse of matrices stored as ``[row, column, vector, line]``, stored as ``[column, vector, row, line]``."""
    n = kappa.shape[0]
    result = np.empty((n, kappa.shape[2], n, kappa.shape[3]), dtype=complex)
    if n == 1:
        np.divide(1.0, kappa[0, 0], out=result[0, :, 0])
    elif n == 2:
        (a, b), (c, d) = kappa
        over = 1.0 / (a * d - b * c)
        np.multiply(d, over, out=result[0, :, 0])
        np.multiply(a, over, out=result[1, :, 1])
        np.negative(over, out=over)
        np.multiply(c, over, out=result[0, :, 1])
        np.multiply(b, over, out=result[1, :, 0])
    else:
        result[:] = np.linalg.inv(kappa.transpose(2, 3, 0, 1)).transpose(3, 0, 2, 1)
    return result
