"""A fit as a plain optimisation problem: which parameters are free, and how well a vector of them fits."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from rotorfit.estimators.blocks.correlated import CorrelatedResponses, whiten
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.misfit.losses import Loss, robust_weights
from rotorfit.estimators.misfit.parameter_space import ParameterSpace
from rotorfit.estimators.misfit.priors import Prior
from rotorfit.models.array_types import ComplexArray, Float

_PIECE = 8192  # readings whose derivatives are held at once


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """Weighted least squares on complex observations.

    It is an :class:`~rotorfit.estimators.minimisation.least_squares.Objective`.
    """

    space: ParameterSpace  # the fitted vector
    blocks: tuple[Block, ...]  # the observations
    loss: Loss = "linear"  # "linear" or a robust one, applied to the modulus of each whitened complex residual
    priors: tuple[Prior, ...] = ()  # priors on entries of the fitted vector
    factors: tuple[ComplexArray | None, ...] = field(default=())

    @property
    def n_data(self) -> int:
        """Number of real data: two for each complex observation."""
        return 2 * sum(block.measured.size for block in self.blocks)

    def _nuisance_factor(self, number: int, x: Float) -> ComplexArray | float:
        if not self.factors or self.factors[number] is None:
            return 1.0
        return np.asarray(np.exp(np.asarray(self.factors[number]) @ x[len(self.space.names) :]))

    def predict(self, x: Float) -> list[ComplexArray]:
        """Predicted observations of each block; from the residuals where those are at hand and independent."""
        key = x.tobytes()
        if key in self._last and not any(isinstance(block, CorrelatedResponses) for block in self.blocks):
            stops = np.cumsum([block.measured.size for block in self.blocks])
            parts = np.split(self._last[key][-1], stops[:-1])
            return [block.measured + r * block.sigma for block, r in zip(self.blocks, parts, strict=True)]
        theta = self.space.theta(x)
        return [block.predict(theta) * self._nuisance_factor(i, x) for i, block in enumerate(self.blocks)]

    def residuals(self, x: Float) -> ComplexArray:
        """Whitened complex residuals of all blocks, predicted minus measured over sigma, shape ``(R,)``."""
        pairs = zip(self.predict(x), self.blocks, strict=True)
        return np.concatenate([whiten(block, predicted - block.measured) for predicted, block in pairs])

    def jacobian(self, x: Float) -> tuple[ComplexArray, ComplexArray]:
        """Whitened residuals and their derivatives, shapes ``(R,)`` and ``(R, p)``, not to be written to.

        What was asked for last is kept, unless it is large: the search ends where the residuals are then studied and
        the result is judged.
        """
        rows = self._linearised(x)
        return rows[-1], rows[:-1].T

    def _linearised(self, x: Float) -> ComplexArray:
        """Whitened derivatives and under them the residuals, shape ``(p + 1, R)``; what was asked for last is kept."""
        key = x.tobytes()
        if key not in self._last:
            found = self._linearise(x)
            if found.shape[1] > _PIECE:
                return found
            self._last.clear()
            self._last[key] = found
        return self._last[key]

    @cached_property
    def _last(self) -> dict[bytes, ComplexArray]:
        return {}

    def _linearise(self, x: Float) -> ComplexArray:
        theta = self.space.theta(x)
        count = self.n_data // 2
        whole = np.zeros((self.space.size + 1, count), dtype=complex)  # parameter by parameter: contiguous along lines
        rows, residuals = whole[:-1], whole[-1]
        stop = 0
        for number, block in enumerate(self.blocks):
            start, stop = stop, stop + block.measured.size
            predicted, by_theta = block.predict_jacobian(theta)
            part = rows[:, start:stop]
            self._scatter(block, by_theta.T, part)
            if self.factors and self.factors[number] is not None:
                factor = np.asarray(self._nuisance_factor(number, x))
                predicted = predicted * factor
                part *= factor
                part[len(self.space.names) :] = np.asarray(self.factors[number]).T * predicted
            residuals[start:stop] = whiten(block, predicted - block.measured)
            if isinstance(block, CorrelatedResponses):
                part[:] = whiten(block, part) * block.sigma
        rows.view(float)[:] *= self._weight
        whole.flags.writeable = False
        return whole

    @cached_property
    def _weight(self) -> Float:
        """One over sigma, twice in a row for the real and the imaginary part of each reading."""
        return np.repeat(np.concatenate([1 / block.sigma for block in self.blocks]), 2)

    def _scatter(self, block: Block, by_theta: ComplexArray, out: ComplexArray) -> None:
        """Write derivatives by the groups' parameters as derivatives by the fitted vector, readings along the rows."""
        if self.space.runs_through is not None:
            places, entries = self.space.runs_through
            np.take(by_theta, places, axis=0, out=out[entries], mode="clip")
            return
        group = block.reading_group
        for g, index in enumerate(self.space.index):
            places = np.flatnonzero(index >= 0)
            if len(self.space.index) == 1:
                out[index[places]] = by_theta[places]
            else:
                rows = np.flatnonzero(group == g)
                out[np.ix_(index[places], rows)] = by_theta[np.ix_(places, rows)]

    # ---- the optimiser's view -------------------------------------------------------------------------------------

    def cost(self, x: Float) -> float:
        """Half the (robust) sum of squares plus minus the log prior."""
        misfit = sum(piece._misfit(x) for piece in self._pieces)
        return misfit + sum(prior.terms(float(x[prior.entry]))[0] for prior in self.priors)

    @cached_property
    def _pieces(self) -> tuple[Problem, ...]:
        """The problem in pieces that fit the processor's cache; derivatives of millions of readings fit no memory."""
        if self.n_data <= 2 * _PIECE:
            return (self,)
        pieces: list[Problem] = []
        for number, block in enumerate(self.blocks):
            parts = block.split(_PIECE) if isinstance(block, Responses) else [block]
            factors = self.factors[number] if self.factors else None
            stops = np.cumsum([part.measured.size for part in parts])
            rows = [None] * len(parts) if factors is None else np.split(factors, stops[:-1])
            pieces += [
                Problem(
                    space=self.space, blocks=(part,), loss=self.loss, priors=(), factors=() if row is None else (row,)
                )
                for part, row in zip(parts, rows, strict=True)
            ]
        return tuple(pieces)

    def _misfit(self, x: Float) -> float:
        r = self.residuals(x)
        if self.loss == "linear":
            return 0.5 * float(np.vdot(r, r).real)
        return 0.5 * float(robust_weights(self.loss, np.abs(r) ** 2)[0].sum())

    def _misfit_derivatives(self, x: Float) -> tuple[float, Float, Float]:
        rows = self._linearised(x)
        if self.loss == "linear":
            misfit = 0.5 * float(np.vdot(rows[-1], rows[-1]).real)
        else:
            rho, weight = robust_weights(self.loss, np.abs(rows[-1]) ** 2)
            misfit = 0.5 * float(rho.sum())
            rows = rows * np.sqrt(weight)
        stacked = rows.view(float)
        products = stacked[:-1] @ stacked.T
        return misfit, products[:, -1], products[:, :-1]

    def gauss_newton(self, x: Float) -> tuple[float, Float, Float]:
        """Cost, gradient and Gauss-Newton matrix, not to be written to; what was asked for last is kept."""
        key = x.tobytes()
        if key not in self._last_normal:
            found = self._gauss_newton(x)
            found[1].flags.writeable = found[2].flags.writeable = False
            self._last_normal.clear()
            self._last_normal[key] = found
        return self._last_normal[key]

    @cached_property
    def _last_normal(self) -> dict[bytes, tuple[float, Float, Float]]:
        return {}

    def _gauss_newton(self, x: Float) -> tuple[float, Float, Float]:
        cost, gradient, matrix = self._pieces[0]._misfit_derivatives(x)
        for piece in self._pieces[1:]:
            more, slope, curvature = piece._misfit_derivatives(x)
            cost += more
            gradient += slope
            matrix += curvature
        for prior in self.priors:
            value, first, second = prior.terms(float(x[prior.entry]))
            cost += value
            gradient[prior.entry] += first
            matrix[prior.entry, prior.entry] += second
        return cost, gradient, matrix

    def hessian(self, x: Float) -> Float:
        """Second derivatives of the cost, by differences of the exact gradient.

        Needed only where Gauss-Newton stalls; a relative step of 1.5e-8 leaves errors near 1e-8 of its size.
        """
        step = np.sqrt(np.finfo(float).eps) * np.maximum(np.abs(x), 1e-8)
        here = self.gauss_newton(x)[1]
        columns = []
        for i in range(x.size):
            beyond = x.copy()
            beyond[i] += step[i]
            columns.append((self.gauss_newton(beyond)[1] - here) / (beyond[i] - x[i]))
        matrix = np.array(columns)
        return np.asarray((matrix + matrix.T) / 2)
