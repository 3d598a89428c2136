"""Responses with correlated errors: all readings of one mounting share what the mounting did to them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.estimators.blocks.observations import Block, OnResponses, Responses


@dataclass(frozen=True, eq=False, kw_only=True)
class CorrelatedResponses(OnResponses):
    """Responses to circular forces with correlated errors. The fit is weighted by ``correlation``, a structure simple
    enough to be estimated from few mountings; error bars come from ``covariance``, which assumes no structure but has
    too small a rank to weigh by."""

    correlation: ComplexArray  # what the fit is weighted by, unit diagonal, shape ``(R, R)``, Hermitian
    covariance: ComplexArray  # of the readings over sigma, shape ``(R, R)``, Hermitian
    degrees: float  # degrees of freedom behind ``covariance``
    weight_freedom: float  # those behind the weight of each channel
    notes: tuple[str, ...] = ()  # sentences on where the errors come from

    @property
    def linear(self) -> Responses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return self.base

    @property
    def uncorrelated(self) -> Responses:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return self.base

    @property
    def without_force_errors(self) -> Block:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return self if self.base.beside is None and self.base.force_noise is None else self.base

    def weighing_error(self, rows: ComplexArray, covar: Float) -> Float:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`: with ``d_c`` the error of the logarithm of a
        channel's variance the estimate moves by ``A sum_c d_c (s_c - I_c A s)``, ``s_c`` its score and ``I_c`` its
        information (Kenward and Roger 1997; Meier 1953); d correlate by the square of the channels' correlation
        (benchmarks/mounting_coverage.py)."""
        total = np.zeros_like(covar)
        if not math.isfinite(self.freedom):
            return total
        number = self.base.coordinate
        parts = [np.where((number == channel)[:, None], rows, 0.0) for channel in np.unique(number)]
        # s_c - I_c A s as a linear function of the errors
        ways = [part - rows @ (covar @ (part.conj().T @ part).real) for part in parts]
        together = self.channel_correlation**2
        for i, one in enumerate(ways):
            for k, other in enumerate(ways):
                total += 2 / self.weight_freedom * together[i, k] * (one.conj().T @ self.scatter @ other).real
        return total

    @property
    def freedom(self) -> float:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return self.degrees

    @property
    def remarks(self) -> tuple[str, ...]:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return self.notes

    @property
    def independent(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return False

    def unmixed(self, scaled: ComplexArray) -> ComplexArray:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return np.asarray(scaled @ self.mixing.T)

    def scattered(self, rows: ComplexArray) -> ComplexArray:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return np.asarray(self.scatter @ rows)

    def drawn(self, noise: ComplexArray) -> ComplexArray:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return np.asarray(noise @ self.spread.T)

    def predict(self, theta: Float) -> ComplexArray:
        """See :class:`~rotorfit.estimators.blocks.observations.Block`."""
        return self.base.predict(theta)

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :class:`~rotorfit.estimators.blocks.observations.Block`."""
        return self.base.predict_jacobian(theta)

    @cached_property
    def mixing(self) -> ComplexArray:
        """Symmetric inverse root of the correlation, ``(R, R)``: residuals stay as near to their readings as can be."""
        return _by_component(self.correlation, lambda values: 1 / np.sqrt(values))

    @cached_property
    def spread(self) -> ComplexArray:
        """Root of the covariance: noise over sigma as drawn from independent numbers, shape ``(R, R)``."""
        return _by_component(self.covariance, lambda values: np.sqrt(np.maximum(values, 0.0)))

    @cached_property
    def channel_correlation(self) -> Float:
        """Correlation in size of two channels' errors at one line, less what chance adds to its square, ``(C, C)``."""
        numbers = np.unique(self.base.coordinate)
        found = np.eye(numbers.size)
        chance = min(2.0 / self.degrees, 1.0)  # of |r|^2 between complex errors that have nothing in common
        for i, one in enumerate(numbers):
            for k, other in enumerate(numbers[:i]):
                a, b = (np.flatnonzero(self.base.coordinate == channel) for channel in (one, other))
                _, first, second = np.intersect1d(self.base.line[a], self.base.line[b], return_indices=True)
                a, b = a[first], b[second]
                size = np.trace(self.covariance[np.ix_(a, a)]).real * np.trace(self.covariance[np.ix_(b, b)]).real
                square = float(np.abs(np.trace(self.covariance[np.ix_(a, b)])) ** 2 / size) if size > 0 else 0.0
                found[i, k] = found[k, i] = np.sqrt(max(square - chance, 0.0) / max(1.0 - chance, 1e-9))
        return found

    @cached_property
    def scatter(self) -> ComplexArray:
        """Covariance of the whitened residuals, the unit matrix where the weights are right, shape ``(R, R)``."""
        return np.asarray(self.mixing @ self.covariance @ self.mixing.conj().T)


def _by_component(matrix: ComplexArray, function: Callable[[Float], Float]) -> ComplexArray:
    """A function of a Hermitian matrix, readings that have nothing in common being taken apart."""
    from scipy.sparse import csr_array  # late: loading it takes longer than a fit
    from scipy.sparse.csgraph import connected_components

    count, number = connected_components(csr_array(matrix != 0), directed=False)
    found = np.zeros_like(matrix)
    for component in range(count):
        at = np.flatnonzero(number == component)
        values, vectors = np.linalg.eigh(matrix[np.ix_(at, at)])
        found[np.ix_(at, at)] = (vectors * function(values)) @ vectors.conj().T
    return found


def whiten(block: Block, misses: ComplexArray) -> ComplexArray:
    """Residuals of a block, shape ``(..., R)``, over their noise and free of what they have in common."""
    return block.unmixed(misses / block.sigma)


def freedom_of(blocks: Iterable[Block]) -> float:
    """Degrees of freedom from which the noise of the readings is known; infinite where it was given or sampled well."""
    return min((block.freedom for block in blocks), default=math.inf)
