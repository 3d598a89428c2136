"""Errors of a fit of very many unknowns, most of them linear in the readings of one coordinate each.

The covariance is that of what all readings share, with the linear entries eliminated, carried on to these, and of each
coordinate's own entries beside it: no matrix of all entries is decomposed, which takes their number to the third power.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorfit.base.array_types import Float, Index
from rotorfit.estimators.inference.identifiability import UNRESOLVED_ERROR, Identifiability, diagnose
from rotorfit.estimators.minimisation.projection import Projection

MOST_ENTRIES_TOGETHER = 1000
"""Entries of a fitted vector up to which all are judged together, in a few seconds."""


def projected_errors(projection: Projection, x: Float, scales: Float) -> tuple[Float, Identifiability]:
    """Covariance, shape ``(p, p)``, and verdict: combinations that are left open are those of what readings share, and
    of the own entries of each coordinate."""
    matrix, parts = projection.information(x)
    kept = projection.kept
    shared, verdict = _diagnosed(projection, x, scales, kept, matrix)
    reach = np.zeros((x.size, kept.size))
    reach[kept] = np.eye(kept.size)
    for coordinate, (_, follow) in parts.items():
        reach[projection.linear[coordinate]] = follow
    covar = reach @ shared @ reach.T
    verdicts, unseen = [verdict], [reach @ verdict.null_space]
    for coordinate, (own, _) in parts.items():
        entries = projection.linear[coordinate]
        if not entries.size:
            continue
        added, verdict = _diagnosed(projection, x, scales, entries, own)
        covar[np.ix_(entries, entries)] += added
        verdicts.append(verdict)
        there = np.zeros((x.size, verdict.null_space.shape[1]))
        there[entries] = verdict.null_space
        unseen.append(there)
    space = projection.problem.space
    wide = np.sqrt(np.maximum(covar.diagonal(), 0.0)) > UNRESOLVED_ERROR * scales
    none = np.abs(np.hstack(unseen)).max(axis=1, initial=0.0) > 0
    names = (*space.names, *space.nuisance)
    open_ = {name for one in verdicts for name in one.unresolved} | {names[i] for i in np.flatnonzero(wide | none)}
    return covar, Identifiability(
        rank=sum(one.rank for one in verdicts),
        size=x.size,
        condition=max(one.condition for one in verdicts),
        combinations=tuple(combination for one in verdicts for combination in one.combinations),
        unresolved=tuple(name for name in names if name in open_),
        null_space=np.hstack(unseen),
    )


def _diagnosed(
    projection: Projection, x: Float, scales: Float, entries: Index, matrix: Float
) -> tuple[Float, Identifiability]:
    """Covariance and verdict of some entries, the others known or eliminated."""
    space = projection.problem.space
    names, base = (_some((*own, *space.nuisance), entries) for own in (space.names, space.base))
    size = np.sqrt(np.maximum(matrix.diagonal(), 0.0))
    size = np.where(size > 0, size, 1.0)
    power, basis = np.linalg.eigh(matrix / np.outer(size, size))
    root = (basis * np.sqrt(np.maximum(power, 0.0))).T * size
    return diagnose(space.model, names, base, x[entries], root, scales[entries])


def _some(names: Sequence[str], entries: Index) -> tuple[str, ...]:
    return tuple(names[i] for i in entries.tolist())
