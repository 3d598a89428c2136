"""A fit as a plain optimisation problem: which parameters are free, and how well vectors of them fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.blocks.nonlinear import responses_of
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.misfit.block_term import BlockTerm, Normal
from rotorfit.estimators.misfit.losses import Loss
from rotorfit.estimators.misfit.parameter_space import ParameterSpace
from rotorfit.estimators.misfit.priors import Prior
from rotorfit.models.array_types import ComplexArray, Float, Index

_Number = TypeVar("_Number", bound=np.generic)
READINGS_OF_A_PIECE = 8192  # readings evaluated together: derivatives of millions fit no memory


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """Weighted least squares on complex observations, an
    :class:`~rotorfit.estimators.minimisation.least_squares.Objective`; of many vectors too: ``x`` of shape ``(...,
    p)``, readings in place of the measured ones ``(..., R)``."""

    space: ParameterSpace  # the fitted vector
    blocks: tuple[Block, ...]  # the observations
    loss: Loss = "linear"  # "linear" or a robust one, applied to the modulus of each whitened complex residual
    priors: tuple[Prior, ...] = ()  # priors on entries of the fitted vector
    factors: tuple[ComplexArray | None, ...] = field(default=())

    @property
    def n_data(self) -> int:
        """Number of real data: two for each complex observation."""
        return 2 * sum(block.measured.size for block in self.blocks)

    @property
    def responses(self) -> list[Responses]:
        """Responses to circular forces or constant loads, of the blocks that hold some."""
        return [found for found in map(responses_of, self.blocks) if found is not None]

    @cached_property
    def _terms(self) -> tuple[BlockTerm, ...]:
        stops = np.cumsum([0] + [block.measured.size for block in self.blocks]).tolist()
        factors = self.factors or (None,) * len(self.blocks)
        return tuple(
            self._term(block, factor, start)
            for block, factor, start in zip(self.blocks, factors, stops[:-1], strict=True)
        )

    def _term(self, block: Block, factors: ComplexArray | None, start: int) -> BlockTerm:
        readings = slice(start, start + block.measured.size)
        return BlockTerm(space=self.space, block=block, loss=self.loss, factors=factors, readings=readings)

    @cached_property
    def _pieces(self) -> tuple[BlockTerm, ...]:
        """The terms in pieces of few enough readings."""
        if self.n_data <= 2 * READINGS_OF_A_PIECE:
            return self._terms
        pieces: list[BlockTerm] = []
        for term in self._terms:
            start = term.readings.start
            for block in term.block.split(READINGS_OF_A_PIECE) if isinstance(term.block, Responses) else [term.block]:
                rows = slice(start - term.readings.start, start - term.readings.start + block.measured.size)
                pieces.append(self._term(block, None if term.factors is None else term.factors[rows], start))
                start += block.measured.size
        return tuple(pieces)

    def by_block(self, values: NDArray[_Number]) -> list[NDArray[_Number]]:
        """Values of all readings block by block."""
        return [values[term.readings] for term in self._terms]

    def predict(self, x: Float) -> list[ComplexArray]:
        """Predicted observations of each block, shape ``(..., R)``."""
        return [term.predict(x) for term in self._terms]

    def residuals(self, x: Float) -> ComplexArray:
        """Whitened complex residuals of all blocks, predicted minus measured over sigma, shape ``(..., R)``."""
        return np.concatenate([term.residuals(x) for term in self._terms], axis=-1)

    def jacobian(self, x: Float) -> tuple[ComplexArray, ComplexArray]:
        """Whitened residuals and their derivatives, shapes ``(..., R)`` and ``(..., R, p)``."""
        parts = [term.linearised(x) for term in self._terms]
        residuals, rows = (np.concatenate(some, axis=-1) for some in zip(*parts, strict=True))
        return residuals, np.swapaxes(rows, -1, -2)

    # ---- sums over readings ------------------------------------------------------------------------------------------

    @cached_property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the noise channels: one for each response of each block."""
        return tuple(name for block in self.blocks for name in block.labels)

    @cached_property
    def channel(self) -> Index:
        """Noise channel of each reading, shape ``(R,)``."""
        first = np.cumsum([0] + [len(block.labels) for block in self.blocks])
        return np.concatenate([block.label + before for block, before in zip(self.blocks, first[:-1], strict=True)])

    @cached_property
    def channel_counts(self) -> Index:
        """Number of real data in each noise channel."""
        return np.asarray(2 * np.bincount(self.channel, minlength=len(self.channel_names)), dtype=np.intp)

    def channel_sums(self, x: Float) -> Float:
        """Robust sums of squared whitened residuals of each channel of vectors ``(W, p)``, shape ``(W, channels)``."""
        total = np.zeros((len(x), len(self.channel_names)))
        for piece in self._pieces:
            to_channel = np.eye(len(self.channel_names))[self.channel[piece.readings]]
            for some in self._chunks(x):
                total[some] += piece.losses(x[some]) @ to_channel
        return total

    def _chunks(self, x: Float) -> Sequence[slice | int]:
        """Vectors that are evaluated together; a single one by its number, as graphs are quicker with scalars."""
        step = 8 * READINGS_OF_A_PIECE // max(self.n_data, 1)  # measured fastest: more leave the cache
        if step < 2 or len(x) == 1:
            return range(len(x))
        return [slice(first, first + step) for first in range(0, len(x), step)]

    def costs(self, x: Float) -> Float:
        """Costs of vectors ``(W, p)``: half the (robust) sum of squares plus minus the log prior, shape ``(W,)``."""
        total = np.zeros(len(x))
        for some in self._chunks(x):
            for piece in self._pieces:
                total[some] += 0.5 * piece.losses(x[some]).sum(axis=-1)
        for prior in self.priors:
            total += prior.terms(x[:, prior.entry])[0]
        return total

    def evaluate(self, x: Float, measured: ComplexArray | None = None, *, matrix: bool = True) -> Normal:
        """Costs, gradients and Gauss-Newton matrices of vectors ``(W, p)``; matrices of zeros where none are wanted."""
        cost, gradient, total = np.zeros(len(x)), np.zeros(x.shape), np.zeros((*x.shape, x.shape[1]))
        for some in self._chunks(x):
            data = None if measured is None else measured[some]
            for piece in self._pieces:
                more = piece.normal(x[some], data, matrix=matrix)
                for sums, part in zip((cost, gradient, total), more, strict=True):
                    sums[some] += part
        for prior in self.priors:
            value, slope, curvature = prior.terms(x[:, prior.entry])
            cost += value
            gradient[:, prior.entry] += slope
            total[:, prior.entry, prior.entry] += curvature
        return cost, gradient, total

    # ---- the optimiser's view of one vector --------------------------------------------------------------------------

    def cost(self, x: Float) -> float:
        """Cost of one vector."""
        return float(self.costs(x[None])[0])

    def gauss_newton(self, x: Float) -> tuple[float, Float, Float]:
        """Cost, gradient and Gauss-Newton matrix of one vector."""
        cost, gradient, matrix = self.evaluate(x[None])
        return float(cost[0]), gradient[0], matrix[0]

    def hessian(self, x: Float) -> Float:
        """Second derivatives of the cost by differences of the exact gradient, to 1e-8, where Gauss-Newton stalls."""
        step = np.sqrt(np.finfo(float).eps) * np.maximum(np.abs(x), 1e-8)
        beyond = x + np.diag(step)
        gradient = self.evaluate(np.concatenate([x[None], beyond]), matrix=False)[1]
        matrix = (gradient[1:] - gradient[0]) / (np.diagonal(beyond) - x)[:, None]
        return np.asarray((matrix + matrix.T) / 2)
