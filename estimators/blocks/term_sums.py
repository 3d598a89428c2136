"""Readings that are sums of functions of the line with numbers of each probe's own (:mod:`rotorfit.models.line_terms`).

Derivatives of a probe's readings are then few: by the parameters that all probes share, and by its own numbers. All of
them are given channel by channel, a channel being the readings of one coordinate in one parameter group, so that no
array has the size of all readings times all parameters.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.models.line_terms import LineTerms, Weights

if TYPE_CHECKING:
    from rotorfit.estimators.blocks.observations import Responses


@dataclass(frozen=True, eq=False, kw_only=True)
class Channel:
    """Predictions of one coordinate in one parameter group, and their derivatives."""

    coordinate: int
    group: int
    readings: Index  # shape ``(m,)``
    lines: Index  # line of each, shape ``(m,)``
    predicted: ComplexArray  # shape ``(..., m)``
    places: Index  # parameters with derivatives that are not zero, shape ``(k,)``
    base: ComplexArray  # what all channels' derivatives are multiples of, at all lines, shape ``(..., b, L)``
    columns: Index  # of which each derivative is a multiple, shape ``(k,)``
    factors: ComplexArray  # by which, shape ``(..., k)``

    @property
    def rows(self) -> ComplexArray:
        """The derivatives, shape ``(..., k, m)``."""
        return np.asarray(self.factors[..., None] * self.base[..., self.columns[:, None], self.lines])


def sums_terms(block: Responses) -> bool:
    """True if the readings of a block are such sums."""
    return block.model.weights is not None and not block.imposed and block.beside is None


def _weights(block: Responses) -> Weights:
    weights = block.model.weights
    if weights is None:
        raise TypeError(f"the response of {block.model.name} is no sum of terms that all probes share")
    return weights


def _terms(block: Responses, theta: Float) -> LineTerms:
    """Terms at the lines of a block, of parameter vectors of its groups, shape ``(..., G, P)``."""
    at = theta if theta.shape[-2] == 1 else theta[..., block.group, :]
    return block.model.line_terms(at, block.s, block.force)


def sum_of_terms(block: Responses, theta: Float) -> ComplexArray:
    """Predicted readings, shape ``(..., R)``."""
    values, weights = _terms(block, theta).values, _weights(block)
    predicted = np.empty((*theta.shape[:-2], block.measured.size), dtype=complex)
    for coordinate, group, readings in block.channels:
        own = weights.of(theta[..., group, :], coordinate)
        some = values[..., weights.seen(coordinate)[:, None], block.line[readings]]
        predicted[..., readings] = (own[..., None, :] @ some)[..., 0, :]
    return predicted


def channels(block: Responses, theta: Float, *, shared: bool = True) -> Iterator[Channel]:
    """Predictions with their derivatives channel by channel; ``shared``: by parameters that all share too."""
    terms, weights = _terms(block, theta), _weights(block)
    base = np.concatenate([terms.values, terms.slopes], axis=-2) if shared else terms.values
    count = weights.real.shape[1]
    for coordinate, group, readings in block.channels:
        seen, lines = weights.seen(coordinate), block.line[readings]
        own = weights.of(theta[..., group, :], coordinate)
        real, imaginary = weights.real[coordinate, seen], weights.imaginary[coordinate, seen]
        places = [real[real >= 0], imaginary[imaginary >= 0]]
        columns = [seen[real >= 0], seen[imaginary >= 0]]
        ones = np.ones((*own.shape[:-1], places[0].size), dtype=complex)
        factors = [ones, np.full((*own.shape[:-1], places[1].size), 1j)]
        if shared:
            number = np.full(count, -1)
            number[seen] = np.arange(seen.size)
            mine = np.flatnonzero(number[terms.terms] >= 0)
            places.append(terms.inputs[mine])
            columns.append(count + mine)
            factors.append(own[..., number[terms.terms[mine]]])
        yield Channel(
            coordinate=coordinate,
            group=group,
            readings=readings,
            lines=lines,
            predicted=(own[..., None, :] @ terms.values[..., seen[:, None], lines])[..., 0, :],
            places=np.concatenate(places),
            base=base,
            columns=np.concatenate(columns),
            factors=np.concatenate(factors, axis=-1),
        )


def sum_of_terms_jacobian(block: Responses, theta: Float) -> tuple[ComplexArray, ComplexArray]:
    """Predicted readings, shape ``(..., R)``, and derivatives by the group's parameters, shape ``(..., P, R)``."""
    predicted = np.empty((*theta.shape[:-2], block.measured.size), dtype=complex)
    rows = np.zeros((*theta.shape[:-2], theta.shape[-1], block.measured.size), dtype=complex)
    for channel in channels(block, theta):
        predicted[..., channel.readings] = channel.predicted
        rows[..., channel.places[:, None], channel.readings] = channel.rows
    return predicted, rows
