"""Log prior density of many vectors at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.problem import Prior

Float = NDArray[np.float64]
Index = NDArray[np.intp]


class LogPriors:
    """Sum of the log densities of priors.

    SciPy's checks cost a hundred times the arithmetic of a few vectors, so priors of one family, whose shapes, places
    and scales are just numbers, are evaluated in one call.

    Args:
        priors: of entries of the vector, any frozen scipy.stats distributions.
    """

    def __init__(self, priors: Sequence[Prior]) -> None:
        families: dict[Any, list[Prior]] = {}
        for number, prior in enumerate(priors):
            frozen = prior.distribution
            # A user's own distribution may hold more than its arguments: one by itself.
            plain = type(frozen.dist).__module__ == "scipy.stats._continuous_distns"
            key = (type(frozen.dist), len(frozen.args), *sorted(frozen.kwds)) if plain else number
            families.setdefault(key, []).append(prior)
        self._families: list[tuple[Index, Callable[[Float], Float]]] = []
        for members in families.values():
            entries = np.array([m.entry for m in members], dtype=np.intp)
            self._families.append((entries, _log_density([m.distribution for m in members])))

    def __call__(self, x: Float) -> Float:
        """Log density of vectors of shape ``(W, p)``, shape ``(W,)``."""
        total = np.zeros(x.shape[0])
        for entries, log_density in self._families:
            total += log_density(x[:, entries]).sum(axis=1)
        return total


def _log_density(members: Sequence[Any]) -> Callable[[Float], Float]:
    """Log density of each of several frozen distributions of a family, their values side by side."""
    first = members[0]
    if len(members) == 1:
        return lambda values: np.asarray(first.logpdf(values))
    arguments = np.array([m.args for m in members], dtype=float).T
    named = {key: np.array([m.kwds[key] for m in members], dtype=float) for key in first.kwds}
    return lambda values: np.asarray(first.dist.logpdf(values, *arguments, **named))
