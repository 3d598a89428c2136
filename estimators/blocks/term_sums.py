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
    predicted: ComplexArray  # shape ``(..., m)``
    places: Index  # parameters with derivatives that are not zero, shape ``(k,)``
    rows: ComplexArray  # the derivatives, shape ``(..., k, m)``


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
    for coordinate, group, readings in block.channels:
        seen, lines = weights.seen(coordinate), block.line[readings]
        own = weights.of(theta[..., group, :], coordinate)
        values = terms.values[..., seen[:, None], lines]
        real, imaginary = weights.real[coordinate, seen], weights.imaginary[coordinate, seen]
        places = [real[real >= 0], imaginary[imaginary >= 0]]
        rows = [values[..., real >= 0, :], 1j * values[..., imaginary >= 0, :]]
        if shared:
            number = np.full(weights.real.shape[1], -1)
            number[seen] = np.arange(seen.size)
            mine = np.flatnonzero(number[terms.terms] >= 0)
            factor = own[..., number[terms.terms[mine]]]
            places.append(terms.inputs[mine])
            rows.append(factor[..., None] * terms.slopes[..., mine[:, None], lines])
        yield Channel(
            coordinate=coordinate,
            group=group,
            readings=readings,
            predicted=(own[..., None, :] @ values)[..., 0, :],
            places=np.concatenate(places),
            rows=np.concatenate(rows, axis=-2),
        )


def sum_of_terms_jacobian(block: Responses, theta: Float) -> tuple[ComplexArray, ComplexArray]:
    """Predicted readings, shape ``(..., R)``, and derivatives by the group's parameters, shape ``(..., P, R)``."""
    predicted = np.empty((*theta.shape[:-2], block.measured.size), dtype=complex)
    rows = np.zeros((*theta.shape[:-2], theta.shape[-1], block.measured.size), dtype=complex)
    for channel in channels(block, theta):
        predicted[..., channel.readings] = channel.predicted
        rows[..., channel.places[:, None], channel.readings] = channel.rows
    return predicted, rows
