"""Cost, gradient and Gauss-Newton matrix of many parameter vectors at once.

The derivatives of all readings are a few products ``left_row s^power right_column`` times real numbers that belong to
the vector alone (:func:`rotorfit.estimators.blocks.response.respond`). Sums over readings are therefore taken of those
products, and the derivatives themselves are never formed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.misfit.kernel_layout import is_plain
from rotorfit.estimators.misfit.losses import robust_weights
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models.array_types import ComplexArray, Float, Index
from rotorfit.models.model import CompiledModel

Normal = tuple[Float, Float, Float]

_AT_ONCE = 8192  # readings whose products are held at once, so that they stay in cache


def normal_equations(problem: Problem, x: Float) -> Normal:
    """What :meth:`Problem.gauss_newton` answers, for many vectors.

    Args:
        problem: the problem.
        x: vectors, shape ``(W, p)``.

    Returns:
        cost, gradient and matrix, shapes ``(W,)``, ``(W, p)`` and ``(W, p, p)``.
    """
    if not all(_is_summed(block) for block in problem.blocks):
        found = [problem.gauss_newton(row) for row in x]
        cost, gradient, matrix = (np.array(parts) for parts in zip(*found, strict=True))
        return cost, gradient, matrix
    cost, gradient = np.zeros(len(x)), np.zeros_like(x)
    matrix = np.zeros((*x.shape, x.shape[1]))
    for number, block in enumerate(problem.blocks):
        sums = _Sums(problem, number)
        step = max(1, _AT_ONCE // block.measured.size)
        for begin in range(0, len(x), step):
            part = slice(begin, begin + step)
            sums.add(x[part], cost[part], gradient[part], matrix[part])
    for prior in problem.priors:
        terms = np.array([prior.terms(float(value)) for value in x[:, prior.entry]])
        cost += terms[:, 0]
        gradient[:, prior.entry] += terms[:, 1]
        matrix[:, prior.entry, prior.entry] += terms[:, 2]
    return cost, gradient, matrix


def _is_summed(block: Block) -> bool:
    """Whether the sums of a block are taken here: plain responses, few enough that many vectors at once save much."""
    if not is_plain(block) or block.measured.size > _AT_ONCE:
        return False
    return isinstance(block, Responses) and not block.model.functions.has_probe_factors


@dataclass(frozen=True, eq=False)
class _Products:
    """Distinct products that the derivatives of a model's responses are made of, times real numbers.

    Attributes:
        factors: row, column, power of s, and whether times j, of each product.
        entries, places: for the real and for the imaginary parts of the coefficients' Jacobian: entries of it that are
            derivatives by parameters, and the product of each.
    """

    factors: tuple[tuple[int, int, int, int], ...]
    entries: tuple[Index, Index]
    places: tuple[Index, Index]


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
class _Sums:
    """Sums over the readings of one block of a problem."""

    problem: Problem
    number: int

    @cached_property
    def _block(self) -> Responses:
        block = self.problem.blocks[self.number]
        if not isinstance(block, Responses):
            raise TypeError(f"{type(block).__name__} is not evaluated as products")
        return block

    @cached_property
    def _nuisance(self) -> ComplexArray | None:
        return self.problem.factors[self.number] if self.problem.factors else None

    def add(self, x: Float, cost: Float, gradient: Float, matrix: Float) -> None:
        """Add what the block has for vectors of shape ``(W, p)``."""
        block, theta = self._block, self.problem.space.theta(x)
        predicted, left, right = self._responses(theta)
        if self._nuisance is not None:
            gain = np.exp(x[:, len(self.problem.space.names) :] @ self._nuisance.T)
            predicted *= gain
            left *= gain
        miss = (predicted - block.measured) / block.sigma
        left /= block.sigma
        rows = self._rows(left, right)
        if self._nuisance is not None:
            moved = (predicted / block.sigma)[:, None] * self._nuisance.T
            rows = np.concatenate([rows, moved], axis=1)
        if self.problem.loss == "linear":
            parts = miss.view(float)
            cost += 0.5 * np.einsum("wr,wr->w", parts, parts)
        else:
            rho, weight = robust_weights(self.problem.loss, np.abs(miss) ** 2)
            cost += 0.5 * rho.sum(axis=1)
            root = np.sqrt(weight)
            miss = miss * root
            rows *= root[:, None]
        _, groups, speeds = block.condition
        numbers = self._numbers(theta[:, groups], groups, speeds)
        for condition in range(groups.size):
            some = slice(None) if groups.size == 1 else block.condition_readings[condition]
            stacked = np.ascontiguousarray(rows[..., some]).view(float)
            r = np.ascontiguousarray(miss[..., some]).view(float)
            weights = numbers[condition]
            gradient += (weights @ (stacked @ r[..., None]))[..., 0]
            matrix += weights @ (stacked @ stacked.swapaxes(-1, -2)) @ weights.swapaxes(-1, -2)

    def _responses(self, theta: Float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Predictions, shape ``(W, R)``, and the row and the column of each reading, shape ``(n, W, R)``."""
        block, W = self._block, len(theta)
        index, groups, speeds = block.condition
        count, n = block.force.shape
        coefficients = np.moveaxis(block.model.coefficients(theta[:, groups], speeds), 1, -1)
        if groups.size > 1:
            coefficients = coefficients[..., index]
        kappa = np.empty((n, n, W, count), dtype=complex)
        for i in range(n):
            for j in range(n):
                entry = kappa[i, j]
                entry[:] = coefficients[:, -1, i, j]
                for power in range(coefficients.shape[1] - 2, -1, -1):
                    entry *= block.s
                    entry += coefficients[:, power, i, j]
        H = _inverse(kappa)  # [column, vector, row, line]
        amplitude = np.einsum("jwil,lj->iwl", H, block.force)
        place = block.coordinate * count + block.line
        left = H.reshape(n, W, n * count).take(place, axis=2)
        predicted = amplitude.swapaxes(0, 1).reshape(W, n * count).take(place, axis=1)
        return predicted, left, amplitude.take(block.line, axis=2)

    def _rows(self, left: ComplexArray, right: ComplexArray) -> ComplexArray:
        """Products at every reading, shape ``(W, K, R)``."""
        factors, powers = _products(self._block.model.functions).factors, self._block.s_powers
        rows = np.empty((left.shape[1], len(factors), left.shape[2]), dtype=complex)
        for number, (row, column, power, turned) in enumerate(factors):
            np.multiply(left[row], right[column], out=rows[:, number])
            if power or turned:
                rows[:, number] *= powers[power] * (1j if turned else 1)
        return rows

    def _numbers(self, theta: Float, groups: Index, speeds: Float) -> list[Float]:
        """Real numbers by which the products make derivatives by the fitted vector, ``(W, p, K)`` a condition."""
        space, products = self.problem.space, _products(self._block.model.functions)
        jacobian = self._block.model.functions.jacobian(theta, speeds)
        found = []
        for condition, group in enumerate(groups.tolist()):
            nuisance = 0 if self._nuisance is None else self._nuisance.shape[1]
            numbers = np.zeros((len(theta), space.size, len(products.factors) + nuisance))
            parts = jacobian.values[:, condition]
            for values, entries, places in zip(
                (parts.real, parts.imag), products.entries, products.places, strict=True
            ):
                fitted = space.index[group, jacobian.inputs[entries]]
                free = fitted >= 0
                np.subtract.at(numbers.transpose(1, 2, 0), (fitted[free], places[free]), values[:, entries[free]].T)
            first = len(space.names)
            for i in range(nuisance):
                numbers[:, first + i, len(products.factors) + i] = 1.0
            found.append(numbers)
        return found


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
