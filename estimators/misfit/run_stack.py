"""Runs of one plan laid over one another: one least-squares problem each, all evaluated as arrays over runs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.misfit.parameter_space import ParameterSpace
from rotorfit.models.array_types import ComplexArray, Float, Index


@dataclass(frozen=True, eq=False, kw_only=True)
class RunStack:
    """Weighted least squares of many runs that share all but their speed, readings and noise."""

    space: ParameterSpace  # the fitted vector of each run
    layout: Responses  # observations of one of them
    speed: Float  # rad/s, shape ``(W,)``
    measured: ComplexArray  # readings and noise, shape ``(W, R)``
    sigma: Float  # readings and noise, shape ``(W, R)``

    def part(self, members: Index, x: Float) -> RunStack:
        """Some of the runs; what is known of them goes along."""
        found = replace(self, speed=self.speed[members], measured=self.measured[members], sigma=self.sigma[members])
        r, rows = self.jacobian(x)
        found._last[x[members].tobytes()] = r[members], rows[members]
        return found

    @property
    def n_data(self) -> int:
        """Number of real data of each run."""
        return 2 * int(self.measured.shape[1])

    @cached_property
    def block(self) -> Responses:
        """All runs one after the other, each a group of its own."""
        one, runs, lines = self.layout, self.speed.size, self.layout.speed.size
        number = np.arange(runs)
        return replace(
            one,
            speed=np.repeat(self.speed, lines),
            frequency=np.tile(one.frequency, runs),
            force=np.tile(one.force, (runs, 1)),
            group=np.repeat(number, lines),
            line=(one.line + lines * number[:, None]).ravel(),
            coordinate=np.tile(one.coordinate, runs),
            measured=self.measured.ravel(),
            sigma=self.sigma.ravel(),
            label=np.tile(one.label, runs),
            run=np.tile(one.run, runs),
        )

    @cached_property
    def in_one_group(self) -> Responses:
        """The same as lines of one group, for what does not depend on parameters."""
        return replace(self.block, group=np.zeros_like(self.block.group))

    def theta(self, x: Float) -> Float:
        """Parameter vectors of the model, shape ``(W, P)``."""
        return self.space.theta(x)[:, 0]

    def jacobian(self, x: Float) -> tuple[ComplexArray, ComplexArray]:
        """Whitened residuals and their derivatives, shapes ``(W, R)`` and ``(W, p, R)``.

        What was asked for last is kept: a search ends where its residuals are then studied.
        """
        key = x.tobytes()
        if key not in self._last:
            found = self._jacobian(x)
            self._last.clear()
            self._last[key] = found
        return self._last[key]

    @cached_property
    def _last(self) -> dict[bytes, tuple[ComplexArray, ComplexArray]]:
        return {}

    def _jacobian(self, x: Float) -> tuple[ComplexArray, ComplexArray]:
        predicted, by_theta = self.block.predict_jacobian(self.theta(x))
        index = self.space.index[0]
        places = np.flatnonzero(index >= 0)
        rows = np.empty((*x.shape, self.measured.shape[1]), dtype=complex)
        rows[:, index[places]] = by_theta.T[places].reshape(places.size, *self.measured.shape).swapaxes(0, 1)
        rows.view(float)[:] *= self._weight[:, None]
        return (predicted.reshape(self.measured.shape) - self.measured) / self.sigma, rows

    @cached_property
    def _weight(self) -> Float:
        """One over sigma, twice in a row for the real and the imaginary part of each reading."""
        return np.repeat(1 / self.sigma, 2, axis=1)

    def gauss_newton(self, x: Float) -> tuple[Float, Float, Float]:
        """Cost, gradient and Gauss-Newton matrix of each run, shapes ``(W,)``, ``(W, p)`` and ``(W, p, p)``."""
        r, rows = self.jacobian(x)
        parts, stacked = r.view(float), rows.view(float)
        cost = 0.5 * np.einsum("wr,wr->w", parts, parts)
        return cost, (stacked @ parts[..., None])[..., 0], stacked @ np.swapaxes(stacked, -1, -2)
