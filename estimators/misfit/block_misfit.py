"""The misfit of many parameter vectors for blocks that have no kernel: all at once where a block takes many vectors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotorfit.estimators.blocks.correlated import whiten
from rotorfit.estimators.blocks.nonlinear import OrbitResponses
from rotorfit.estimators.blocks.observations import Block
from rotorfit.estimators.blocks.small_motion import FreeVibrations, OffCentreResponses
from rotorfit.estimators.misfit.losses import robust_weights
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models.array_types import ComplexArray, Float, Index

_TOGETHER = 8000  # readings that NumPy holds at once, so that arrays stay in cache


def takes_many(block: Block) -> bool:
    """Whether a block predicts from parameter vectors of shape ``(W, G, P)`` as well as ``(G, P)``."""
    if isinstance(block, FreeVibrations):
        return block.model.shaft is None
    return isinstance(block, OrbitResponses | OffCentreResponses)


@dataclass(frozen=True, eq=False, kw_only=True)
class BlockMisfit:
    """One block of a problem as a misfit of many vectors."""

    problem: Problem  # the block alone, as a problem of its own without priors
    readings: slice  # its readings among those of the whole problem
    channel: Index  # noise channel of each of them among those of the whole problem, shape ``(R,)``

    @property
    def block(self) -> Block:
        """The observations."""
        return self.problem.blocks[0]

    def add_sums(self, x: Float, out: Float) -> None:
        """Add the robust sums of squared whitened residuals to those by channel."""
        to_channel = np.zeros((self.channel.size, out.shape[1]))
        to_channel[np.arange(self.channel.size), self.channel] = 1.0
        for part in self._parts(x.shape[0]):
            residual = whiten(self.block, self._predict(x[part]) - self.block.measured)
            rho, _ = robust_weights(self.problem.loss, residual.real**2 + residual.imag**2)
            out[part] += rho @ to_channel

    def add_slopes(self, x: Float, measured: ComplexArray | None, cost: Float, gradient: Float) -> None:
        """Add cost and gradient."""
        if not takes_many(self.block):
            self._add_slopes_one_by_one(x, measured, cost, gradient)
            return
        block, space, factors = self.block, self.problem.space, self._factors
        for part in self._parts(x.shape[0]):
            predicted, by_theta = block.predict_jacobian(space.theta(x[part]))
            gain = self._gain(x[part])
            target = block.measured if measured is None else measured[part, self.readings]
            residual = (predicted * gain - target) / block.sigma
            rho, weight = robust_weights(self.problem.loss, residual.real**2 + residual.imag**2)
            cost[part] += rho.sum(axis=1) / 2
            pull = (weight * residual / block.sigma).conj() * gain
            for group in range(len(space.index)):
                rows = block.reading_group == group
                slope = np.einsum("wr,wrp->wp", pull[:, rows], by_theta[:, rows]).real
                gradient[part] += space.pull_back(slope, group)
            if factors is not None:
                gradient[part, len(space.names) :] += ((pull * predicted) @ factors).real

    def _add_slopes_one_by_one(self, x: Float, measured: ComplexArray | None, cost: Float, gradient: Float) -> None:
        for m in range(x.shape[0]):
            residual, jacobian = self.problem.jacobian(x[m])
            if measured is not None:
                residual = residual + whiten(self.block, self.block.measured - measured[m, self.readings])
            rho, weight = robust_weights(self.problem.loss, np.abs(residual) ** 2)
            cost[m] += rho.sum() / 2
            gradient[m] += ((weight * residual).conj() @ jacobian).real

    def _parts(self, members: int) -> Iterator[slice]:
        together = max(1, _TOGETHER // self.channel.size) if takes_many(self.block) else 1
        return (slice(first, first + together) for first in range(0, members, together))

    def _predict(self, x: Float) -> ComplexArray:
        """Predictions of vectors ``(W, p)``, shape ``(W, R)``."""
        if not takes_many(self.block):
            return self.problem.predict(x[0])[0][None]
        return self.block.predict(self.problem.space.theta(x)) * self._gain(x)

    def _gain(self, x: Float) -> ComplexArray | float:
        """What nuisance entries multiply predictions by."""
        factors = self._factors
        return 1.0 if factors is None else np.asarray(np.exp(x[:, len(self.problem.space.names) :] @ factors.T))

    @cached_property
    def _factors(self) -> ComplexArray | None:
        return self.problem.factors[0] if self.problem.factors else None


def alone(problem: Problem, number: int) -> Problem:
    """One block of a problem as a problem of its own, without priors."""
    return Problem(
        space=problem.space,
        blocks=(problem.blocks[number],),
        loss=problem.loss,
        priors=(),
        factors=problem.factors[number : number + 1],
    )


def costs(problem: Problem, x: Float) -> Float:
    """Costs of many vectors, shape ``(W,)``, infinite where undefined."""
    total = np.zeros((len(x), 1))
    with np.errstate(all="ignore"):  # a start may well be absurd
        for number, block in enumerate(problem.blocks):
            channel = np.zeros(block.measured.size, dtype=np.intp)
            part = BlockMisfit(problem=alone(problem, number), readings=slice(0, None), channel=channel)
            part.add_sums(x, total)
    cost = total[:, 0] / 2
    for prior in problem.priors:
        cost += [prior.terms(float(value))[0] for value in x[:, prior.entry]]
    return np.where(np.isfinite(cost), cost, np.inf)


def normal_equations(problem: Problem, x: Float) -> tuple[Float, Float, Float]:
    """Cost, gradient and Gauss-Newton matrix of many vectors.

    Returns:
        shapes ``(W,)``, ``(W, p)`` and ``(W, p, p)``.
    """
    block, space = problem.blocks[0], problem.space
    if not takes_many(block):
        cost, slope, matrix = zip(*(problem.gauss_newton(row) for row in x), strict=True)
        return np.array(cost), np.array(slope), np.array(matrix)
    predicted, by_theta = block.predict_jacobian(space.theta(x))
    along = np.swapaxes(by_theta, 1, 2)  # readings last, as they are stored
    rows = np.zeros((len(x), space.size, block.measured.size), dtype=complex)
    for group, index in enumerate(space.index):
        free = np.flatnonzero(index >= 0)
        mine = slice(None) if len(space.index) == 1 else np.flatnonzero(block.reading_group == group)
        for place in free.tolist():
            rows[:, index[place], mine] += along[:, place, mine]
    factors = problem.factors[0] if problem.factors else None
    if factors is not None:
        gain = np.exp(x[:, len(space.names) :] @ factors.T)
        predicted = predicted * gain
        rows *= gain[:, None]
        rows[:, len(space.names) :] = factors.T * predicted[:, None]
    scale = 1 / block.sigma
    miss = (predicted - block.measured) * scale
    rho, weight = robust_weights(problem.loss, miss.real**2 + miss.imag**2)
    if problem.loss != "linear":
        root = np.sqrt(weight)
        rows, miss = rows * root[:, None], miss * root
    real = rows.view(float)
    real *= np.repeat(scale, 2)
    slope = real @ np.ascontiguousarray(miss).view(float)[:, :, None]
    return rho.sum(axis=1) / 2, slope[..., 0], real @ np.swapaxes(real, 1, 2)
