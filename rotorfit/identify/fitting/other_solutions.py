"""Solutions that the data hold as well as that of a fit: values with the other sign, or exchanged in two sets.

Candidates come from the equation of motion. The motion of a coordinate counted the other way changes the sign of all
that couples it with others; coordinates in another order, or the transposed matrices, exchange parameters. Which of
these the data cannot tell from the fit, their misfit says: readings, known values, bounds and priors all count.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.base.array_types import Float, Index
from rotorfit.base.digits import with_error
from rotorfit.models import RotorModel

if TYPE_CHECKING:
    from rotorfit.identify.fitting.result import FitResult

_ALIKE = 0.5  # difference of log densities up to which data hold two solutions alike
_APART = 3.0  # standard errors by which two solutions differ at least
_MOST = 200  # candidates that are tried


@dataclass(frozen=True, kw_only=True, eq=False)
class OtherSolution:
    """A solution that the data hold as well.

    Attributes:
        words: what makes it of the fit's values.
        values: of the fitted values by name, SI units.
        x: the same as a vector, nuisances included.
    """

    words: str
    values: Mapping[str, float]
    x: Float

    def __str__(self) -> str:
        return self.words


def other_solutions(fit: FitResult) -> tuple[OtherSolution, ...]:
    """See :attr:`rotorfit.FitResult.other_solutions`."""
    space, x = fit.problem.space, fit.x
    if fit.method != "least squares" or not fit.success:
        return ()
    error = np.array([fit.params[name].noise if fit.params[name].resolved else np.inf for name in space.names])
    vectors: list[Float] = []
    told: list[tuple[Index, Float]] = []
    for places, signs in _candidates(space.model):
        theta = signs * space.theta(x)[:, places]
        other = x.copy()
        free = space.index >= 0
        other[space.index[free]] = theta[free]
        moved = np.abs(other - x)[: error.size] > _APART * error
        inside = (other >= space.lower).all() and (other <= space.upper).all()
        same = np.allclose(space.theta(other), theta, rtol=1e-9, atol=0.0)  # what is known stays
        if moved.any() and inside and same and not any(np.array_equal(other, known) for known in vectors):
            vectors.append(other)
            told.append((places, signs))
    if not vectors:
        return ()
    gain = fit.problem.cost(x) - fit.problem.costs(np.array(vectors))
    names = space.model.parameter_names
    return tuple(
        OtherSolution(
            words=_words(fit, names, *how, vector),
            values=dict(zip(space.names, vector.tolist(), strict=False)),
            x=vector,
        )
        for vector, how, better in zip(vectors, told, gain.tolist(), strict=True)
        if abs(better) < _ALIKE
    )


def _candidates(model: RotorModel) -> Iterator[tuple[Index, Float]]:
    """Place from which each parameter takes its value, and its sign."""
    count, size = len(model.parameters), len(model.coordinates)
    still, plain = np.arange(count), np.ones(count)
    functions = model.functions
    patterns: list[set[tuple[int, int, int]]] = [set() for _ in range(count)]
    for place, *entry in zip(functions.inputs, functions.powers, functions.rows, functions.columns, strict=True):
        if place < count:
            patterns[place].add((int(entry[0]), int(entry[1]), int(entry[2])))
    for place in range(count):
        yield still, np.where(still == place, -1.0, 1.0)
    for turned in range(size):
        across = [bool(own) and all((i == turned) != (j == turned) for _, i, j in own) for own in patterns]
        if sum(across) > 1:
            yield still, np.where(across, -1.0, 1.0)
    orders = [list(range(size))]
    if size > 1:
        orders.append(orders[0][::-1])
    for i, j in list(combinations(range(size), 2))[:_MOST] if size > 2 else []:
        order = list(range(size))
        order[i], order[j] = j, i
        orders.append(order)
    for order in orders:
        for transposed in (False, True):
            places = _exchanged(patterns, order, transposed)
            if places is not None and (places != still).any():
                yield places, plain


def _exchanged(patterns: list[set[tuple[int, int, int]]], order: list[int], transposed: bool) -> Index | None:
    """Places by which entries of the equation come to stand in another order; None where parameters do not allow it."""
    places = np.arange(len(patterns))
    kinds: dict[frozenset[tuple[int, int, int]], list[int]] = {}
    for place, own in enumerate(patterns):
        kinds.setdefault(frozenset(own), []).append(place)
    for kind, members in kinds.items():
        there = frozenset((k, *((order[j], order[i]) if transposed else (order[i], order[j]))) for k, i, j in kind)
        others = kinds.get(there, [])
        if len(others) != len(members):
            return None
        places[others] = members
    return places


def _words(fit: FitResult, names: tuple[str, ...], places: Index, signs: Float, x: Float) -> str:
    space = fit.problem.space
    changed = [k for k, (one, other) in enumerate(zip(fit.x, x, strict=True)) if one != other and k < len(space.names)]
    bases = {space.base[k] for k in changed}
    turned = [names[k] for k in np.flatnonzero(signs < 0) if names[k] in bases]
    pairs = [f"{names[k]} and {names[j]}" for k, j in enumerate(places.tolist()) if k < j and names[k] in bases]
    what = f"{', '.join(turned)} of the other sign" if turned else f"{', '.join(pairs)} exchanged"
    values = ", ".join(f"{space.names[k]} {with_error(x[k], fit.params[space.names[k]].stderr)[0]}" for k in changed)
    return f"another solution explains the data as well, {what} ({values})"
