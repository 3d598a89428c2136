"""One block of a problem: its whitened residuals, and what they add to cost, gradient and Gauss-Newton matrix.

Everything takes fitted vectors of shape ``(..., p)`` and, in place of the readings of the block, others of shape
``(..., R)``. Derivatives of linear responses are few products along the readings times real numbers that belong to the
vector alone (:class:`~rotorfit.estimators.blocks.response.Sensitivities`): sums over readings are of products.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotorfit.estimators.blocks.correlated import whiten
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.blocks.response import Sensitivities, by_condition, response_sensitivities
from rotorfit.estimators.misfit.losses import Loss, robust_weights
from rotorfit.estimators.misfit.parameter_space import ParameterSpace
from rotorfit.models.array_types import ComplexArray, Float

Normal = tuple[Float, Float, Float]
"""Cost, gradient and Gauss-Newton matrix, shapes ``(...)``, ``(..., p)`` and ``(..., p, p)``."""


def is_linear_response(block: Block) -> bool:
    """True if a block holds responses to forces of a linear model that its coefficients describe."""
    if not isinstance(block, Responses) or block.imposed or block.beside is not None:
        return False
    return block.model.shaft is None and not block.model.eccentricity_dependent


@dataclass(frozen=True, eq=False, kw_only=True)
class BlockTerm:
    """The part of a cost that one block has."""

    space: ParameterSpace  # the fitted vector
    block: Block  # the observations
    loss: Loss  # of the modulus of each whitened residual
    factors: ComplexArray | None  # sensitivities of the logarithm of the predictions to the nuisance entries
    readings: slice  # its readings among those of the problem

    # ---- values ------------------------------------------------------------------------------------------------------

    def _gain(self, x: Float, factors: ComplexArray) -> ComplexArray:
        """Factors of predictions by nuisance entries, shape ``(..., R)``."""
        return np.asarray(np.exp(x[..., len(self.space.names) :] @ factors.T))

    def predict(self, x: Float) -> ComplexArray:
        """Predicted observations, shape ``(..., R)``."""
        predicted = self.block.predict(self.space.theta(x))
        return predicted if self.factors is None else predicted * self._gain(x, self.factors)

    def residuals(self, x: Float) -> ComplexArray:
        """Whitened residuals, shape ``(..., R)``."""
        return self._misses(self.predict(x), None)

    def losses(self, x: Float) -> Float:
        """Twice what each reading adds to the cost, shape ``(..., R)``."""
        r = self.residuals(x)
        return robust_weights(self.loss, r.real**2 + r.imag**2)[0]

    def _misses(self, predicted: ComplexArray, measured: ComplexArray | None) -> ComplexArray:
        return whiten(
            self.block, predicted - (self.block.measured if measured is None else measured[..., self.readings])
        )

    # ---- derivatives -------------------------------------------------------------------------------------------------

    def linearised(self, x: Float) -> tuple[ComplexArray, ComplexArray]:
        """Whitened residuals, shape ``(..., R)``, and their derivatives by the fitted vector, shape ``(..., p, R)``."""
        if self._responses is None:
            predicted, rows = self._derivatives(x)
        else:
            predicted, found = self._products(x, self._responses)
            rows = found.derivatives(self._responses)
        return self._misses(predicted, None), rows

    def normal(self, x: Float, measured: ComplexArray | None = None, *, matrix: bool = True) -> Normal:
        """Contribution of the block to cost, gradient and Gauss-Newton matrix; zero where it is not wanted."""
        if self._responses is None:
            predicted, rows = self._derivatives(x)
        else:
            predicted, found = self._products(x, self._responses)
            rows = found.products
        r = np.ascontiguousarray(self._misses(predicted, measured))
        if self.loss == "linear":
            squares = r.view(float)
            cost = 0.5 * np.einsum("...r,...r->...", squares, squares)
        else:
            rho, weight = robust_weights(self.loss, r.real**2 + r.imag**2)
            cost, root = 0.5 * rho.sum(axis=-1), np.sqrt(weight)
            r, rows = r * root, rows * root[..., None, :]
        gradient, total = np.zeros(x.shape), np.zeros((*x.shape, x.shape[-1]))
        if self._responses is None:
            real = rows.view(float)
            gradient += (real @ r.view(float)[..., None])[..., 0]
            if matrix:
                total += real @ real.swapaxes(-1, -2)
            return cost, gradient, total
        misses = by_condition(self._responses, r[..., None, :])
        for (some, _, part), (_, _, miss) in zip(by_condition(self._responses, rows), misses, strict=True):
            own = found.numbers[..., some, :, :]
            gradient += (own @ (part @ miss.swapaxes(-1, -2)))[..., 0].sum(axis=-2)
            if matrix:
                total += (own @ (part @ part.swapaxes(-1, -2)) @ own.swapaxes(-1, -2)).sum(axis=-3)
        return cost, gradient, total

    @cached_property
    def _responses(self) -> Responses | None:
        """The block where its derivatives are products times numbers."""
        block = self.block
        if not isinstance(block, Responses) or not is_linear_response(block) or block.model.functions.has_probe_factors:
            return None
        return block

    def _products(self, x: Float, block: Responses) -> tuple[ComplexArray, Sensitivities]:
        """Predictions, and their whitened derivatives by the fitted vector as products times numbers."""
        space, factors, scale = self.space, self.factors, 1 / block.sigma
        gain = 1.0 if factors is None else self._gain(x, factors)
        predicted, found = response_sensitivities(block, space.theta(x), gain * scale)
        shape, count = found.numbers.shape[:-2], found.numbers.shape[-1]
        extra = 0 if factors is None else factors.shape[1]
        numbers = np.zeros((*shape, space.size, count + extra))
        for group, (places, entries) in enumerate(space.fitted):
            if len(space.fitted) == 1:
                numbers[..., entries, :count] = found.numbers[..., places, :]
            else:
                mine = np.flatnonzero(block.condition[1] == group)[:, None]
                numbers[..., mine, entries, :count] = found.numbers[..., mine, places, :]
        if factors is None:
            return predicted, Sensitivities(found.products, numbers)
        predicted = predicted * gain
        numbers[..., len(space.names) + np.arange(extra), count + np.arange(extra)] = 1.0
        moved = (predicted * scale)[..., None, :] * factors.T
        return predicted, Sensitivities(np.concatenate([found.products, moved], axis=-2), numbers)

    def _derivatives(self, x: Float) -> tuple[ComplexArray, ComplexArray]:
        """Predictions, and their whitened derivatives by the fitted vector, shape ``(..., p, R)``."""
        block, space, factors = self.block, self.space, self.factors
        predicted, by_theta = block.predict_jacobian(space.theta(x))
        along = np.swapaxes(by_theta, -1, -2)
        rows = np.zeros((*x.shape, along.shape[-1]), dtype=complex)  # entry by entry: contiguous along readings
        for group, (places, entries) in enumerate(space.fitted):
            if len(space.fitted) == 1:
                rows[..., entries, :] = along[..., places, :]
            else:
                mine = np.flatnonzero(block.reading_group == group)
                rows[..., entries[:, None], mine] = along[..., places[:, None], mine]
        if factors is not None:
            gain = self._gain(x, factors)
            predicted = predicted * gain
            rows *= gain[..., None, :]
            rows[..., len(space.names) :, :] = factors.T * predicted[..., None, :]
        return predicted, whiten(block, rows)
