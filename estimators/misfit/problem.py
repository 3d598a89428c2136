"""A fit as a plain optimisation problem: which parameters are free, and how well vectors of them fit.

Everything takes fitted vectors of shape ``(..., p)`` and, in place of the readings, others of shape ``(..., R)``.
Derivatives of linear responses are few products along the readings times real numbers that belong to the vector alone
(:class:`~rotorfit.estimators.blocks.response.Sensitivities`): sums over readings are of products.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float, Index, Text
from rotorfit.estimators.blocks.correlated import whiten
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.blocks.response import Sensitivities, by_condition, response_sensitivities
from rotorfit.estimators.blocks.term_sums import channels, sums_terms
from rotorfit.estimators.misfit.parameter_space import ParameterSpace
from rotorfit.estimators.misfit.priors import Prior

Loss = Literal["linear", "soft_l1", "huber", "cauchy"]

LOSSES: tuple[Loss, ...] = ("linear", "soft_l1", "huber", "cauchy")
LOSS_SCALE = 2.0
"""Whitened residual modulus beyond which a robust loss discounts; the noise's own rms modulus is sqrt(2)."""


def robust_weights(loss: Loss, size2: Float) -> tuple[Float, Float]:
    """Cost ``rho`` (that of the fit is sum(rho)/2) of squared residual moduli, and ``d rho / d size2``."""
    if loss == "linear":
        return size2, np.ones_like(size2)
    c2 = LOSS_SCALE**2
    z = size2 / c2
    if loss == "soft_l1":
        root = np.sqrt(1 + z)
        return 2 * c2 * (root - 1), 1 / root
    if loss == "huber":
        root = np.sqrt(np.maximum(z, 1))
        return np.where(z <= 1, size2, c2 * (2 * root - 1)), 1 / root
    return c2 * np.log1p(z), 1 / (1 + z)


Normal = tuple[Float, Float, Float]
"""Cost, gradient and Gauss-Newton matrix, shapes ``(...)``, ``(..., p)`` and ``(..., p, p)``."""


def linear_response(block: Block) -> Responses | None:
    """The block where it is responses to forces of a linear model that its coefficients describe."""
    found = block.linear
    if found is None or found is not block or found.imposed or found.beside is not None:
        return None
    return None if found.model.shaft is not None or found.model.eccentricity_dependent else found


@dataclass(frozen=True, eq=False, kw_only=True)
class LinearisedChannel:
    """Readings of one coordinate in one parameter group, which few entries of the fitted vector act on. Derivatives
    are multiples of functions that all channels share, and so are sums of their products over the readings."""

    coordinate: int
    readings: Index  # among those of the block, shape ``(m,)``
    entries: Index  # shape ``(k,)``
    residuals: ComplexArray  # whitened, shape ``(..., m)``
    base: ComplexArray  # the functions, shape ``(..., b, L)``
    lines: Index  # line of each reading, shape ``(m,)``
    columns: Index  # function of each derivative, shape ``(k,)``
    factors: ComplexArray  # its factor, shape ``(..., k)``
    scale: Float  # over which residuals were whitened, shape ``(m,)``
    kept: dict[bytes, ComplexArray]  # products of the functions over lines with these weights, those found last

    @property
    def rows(self) -> ComplexArray:
        """Derivatives of the residuals by the entries, shape ``(..., k, m)``."""
        own = self.factors[..., None] * self.base[..., self.columns[:, None], self.lines]
        return np.ascontiguousarray(own * self.scale)

    def products(self) -> tuple[Float, Float]:
        """Sums over readings of one vector: derivatives times residuals, ``(k,)``, and times each other, ``(k, k)``."""
        largest = float(self.scale.max())
        shape = self.scale / largest
        key = self.lines.tobytes() + shape.tobytes()
        if key not in self.kept:
            weighed = self.base[:, self.lines] * shape
            self.kept.clear()
            self.kept[key] = weighed.conj() @ weighed.T
            self.kept[b""] = weighed
        both, weighed = self.kept[key], self.kept[b""]
        along = (weighed.conj() @ self.residuals)[self.columns] * self.factors.conj() * largest
        factors = self.factors * largest
        squares = factors.conj()[:, None] * factors * both[np.ix_(self.columns, self.columns)]
        return along.real, squares.real


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
        return robust_weights(self.loss, self.block.losses(self.residuals(x)))[0]

    def _misses(self, predicted: ComplexArray, measured: ComplexArray | None) -> ComplexArray:
        given = self.block.measured if measured is None else measured[..., self.readings]
        return whiten(self.block.weighed(predicted), predicted - given)

    # ---- derivatives -------------------------------------------------------------------------------------------------

    @cached_property
    def sum(self) -> Responses | None:
        """The block where its readings are sums of terms that each probe weighs with numbers of its own."""
        block = self.block.linear
        return block if block is self.block and block is not None and sums_terms(block) else None

    def channels(
        self, x: Float, measured: ComplexArray | None = None, *, shared: bool = True
    ) -> Iterator[LinearisedChannel]:
        """Whitened residuals and derivatives of such a block, channel by channel; ``shared``: by what is not a probe's
        own number too."""
        if self.sum is None:
            return
        space, factors, count = self.space, self.factors, len(self.space.names)
        kept: dict[bytes, ComplexArray] = {}
        for channel in channels(self.sum, space.theta(x), shared=shared):
            entries = space.index[channel.group, channel.places]
            fitted, scale = entries >= 0, 1 / self.block.sigma[channel.readings]
            entries, predicted = entries[fitted], channel.predicted
            base, lines, columns, own = (
                channel.base,
                channel.lines,
                channel.columns[fitted],
                channel.factors[..., fitted],
            )
            if factors is not None:
                by_nuisance = factors[channel.readings]
                gain = self._gain(x, by_nuisance)
                base, predicted = channel.rows[..., fitted, :] * gain[..., None, :], predicted * gain
                if shared:
                    entries = np.concatenate([entries, count + np.arange(by_nuisance.shape[1])])
                    base = np.concatenate([base, by_nuisance.T * predicted[..., None, :]], axis=-2)
                lines, columns, kept = np.arange(channel.lines.size), np.arange(entries.size), {}
                own = np.ones((*base.shape[:-2], entries.size), dtype=complex)
            given = self.block.measured if measured is None else measured[..., self.readings]
            yield LinearisedChannel(
                coordinate=channel.coordinate,
                readings=channel.readings,
                entries=entries,
                residuals=np.ascontiguousarray((predicted - given[..., channel.readings]) * scale),
                base=base,
                lines=lines,
                columns=columns,
                factors=own,
                scale=scale,
                kept=kept,
            )

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
        if self.sum is not None:
            return self._normal_of_channels(x, measured, matrix=matrix)
        if self._responses is None:
            predicted, rows = self._derivatives(x)
        else:
            predicted, found = self._products(x, self._responses)
            rows = found.products
        cost, r, rows = self._weighed(np.ascontiguousarray(self._misses(predicted, measured)), rows)
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

    def _weighed(self, r: ComplexArray, rows: ComplexArray) -> tuple[Float, ComplexArray, ComplexArray]:
        """Cost of residuals, and these and their derivatives as a robust loss weighs them."""
        if self.loss == "linear":
            if not self.block.normal:
                return 0.5 * self.block.losses(r).sum(axis=-1), r, rows
            squares = r.view(float)
            return 0.5 * np.einsum("...r,...r->...", squares, squares), r, rows
        rho, weight = robust_weights(self.loss, r.real**2 + r.imag**2)
        root = np.sqrt(weight)
        return 0.5 * rho.sum(axis=-1), r * root, rows * root[..., None, :]

    def _normal_of_channels(self, x: Float, measured: ComplexArray | None, *, matrix: bool) -> Normal:
        """Sums of the channels, each of the entries that act on it."""
        cost: Float = np.zeros(x.shape[:-1])
        gradient, total = np.zeros(x.shape), np.zeros((*x.shape, x.shape[-1] if matrix else 0))
        for channel in self.channels(x, measured):
            entries = channel.entries
            if x.ndim == 1 and self.loss == "linear":
                slope, products = channel.products()
                cost = cost + 0.5 * float(np.vdot(channel.residuals, channel.residuals).real)
                gradient[entries] += slope
                if matrix:
                    total[entries[:, None], entries] += products
                continue
            own, r, rows = self._weighed(channel.residuals, channel.rows)
            real = rows.view(float)
            cost = cost + own
            gradient[..., entries] += (real @ r.view(float)[..., None])[..., 0]
            if matrix:
                total[..., entries[:, None], entries] += real @ real.swapaxes(-1, -2)
        return cost, gradient, total if matrix else np.zeros((*x.shape, x.shape[-1]))

    @cached_property
    def _responses(self) -> Responses | None:
        """The block where its derivatives are products times numbers."""
        block = linear_response(self.block)
        return None if block is None or self.sum is not None or block.model.functions.has_probe_factors else block

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
        return predicted, whiten(block.weighed(predicted), rows)


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
    def measured(self) -> ComplexArray:
        """All readings, shape ``(R,)``."""
        return np.concatenate([block.measured for block in self.blocks])

    @property
    def sigma(self) -> Float:
        """Their noise, shape ``(R,)``."""
        return np.concatenate([block.sigma for block in self.blocks])

    @property
    def run(self) -> Text:
        """The run of each, shape ``(R,)``."""
        return np.concatenate([block.run for block in self.blocks])

    def with_noise(self, factor: Float | float) -> Problem:
        """The problem with the noise of all readings times a factor, or each times its own, shape ``(R,)``."""
        own = self.by_block(np.broadcast_to(factor, self.sigma.shape))
        blocks = tuple(block.with_noise(part) for block, part in zip(self.blocks, own, strict=True))
        return replace(self, blocks=blocks)

    @property
    def responses(self) -> list[Responses]:
        """Responses to circular forces or constant loads, of the blocks that hold some."""
        return [found for block in self.blocks if (found := block.responses) is not None]

    @cached_property
    def terms(self) -> tuple[BlockTerm, ...]:
        """The part of the cost that each block has."""
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
            return self.terms
        pieces: list[BlockTerm] = []
        for term in self.terms:
            start = term.readings.start
            for block in term.block.split(READINGS_OF_A_PIECE):
                rows = slice(start - term.readings.start, start - term.readings.start + block.measured.size)
                pieces.append(self._term(block, None if term.factors is None else term.factors[rows], start))
                start += block.measured.size
        return tuple(pieces)

    def by_block(self, values: NDArray[_Number]) -> list[NDArray[_Number]]:
        """Values of all readings block by block."""
        return [values[term.readings] for term in self.terms]

    def predict(self, x: Float) -> list[ComplexArray]:
        """Predicted observations of each block, shape ``(..., R)``."""
        return [term.predict(x) for term in self.terms]

    def residuals(self, x: Float) -> ComplexArray:
        """Whitened complex residuals of all blocks, predicted minus measured over sigma, shape ``(..., R)``."""
        return np.concatenate([term.residuals(x) for term in self.terms], axis=-1)

    def jacobian(self, x: Float) -> tuple[ComplexArray, ComplexArray]:
        """Whitened residuals and their derivatives, shapes ``(..., R)`` and ``(..., R, p)``."""
        parts = [term.linearised(x) for term in self.terms]
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


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Derivatives of the whitened residuals of a problem at a fitted vector: worked out when they are asked for, whole
    or in pieces, which are small where channels have entries of their own."""

    problem: Problem
    x: Float

    @cached_property
    def _both(self) -> tuple[ComplexArray, ComplexArray]:
        return self.problem.jacobian(self.x)

    @property
    def whole(self) -> ComplexArray:
        """All of them, shape ``(R, p)``."""
        return self._both[1]

    @cached_property
    def residuals(self) -> ComplexArray:
        """The residuals, shape ``(R,)``."""
        return self.problem.residuals(self.x) if self.in_channels else self._both[0]

    @property
    def in_channels(self) -> bool:
        """True if the pieces are channels."""
        return all(term.sum is not None for term in self.problem.terms) and len(self.problem.space.index) == 1

    def pieces(self) -> Iterator[tuple[Index, Index, ComplexArray]]:
        """Readings, the entries that act on them, and the derivatives, shape ``(k, m)``."""
        if not self.in_channels:
            yield np.arange(self.problem.n_data // 2), np.arange(self.x.size), self.whole.T
            return
        for term in self.problem.terms:
            for channel in term.channels(self.x):
                yield term.readings.start + channel.readings, channel.entries, channel.rows
