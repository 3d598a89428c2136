"""Parameters of thousands of runs in little memory: numbers in an array, and once for all runs what they share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from rotorfit.fitting.arithmetic import Source
from rotorfit.fitting.quantities import FittedParameter

_NUMBERS = ("value", "stderr", "stderr_noise", "init_value", "freedom")
_COMMON = ("name", "unit", "meaning", "min", "max", "vary", "resolved", "at_bound")


class HeldParameters(Mapping[str, FittedParameter]):
    """Parameters of one result, each made when it is asked for."""

    __slots__ = ("_common", "_fit", "_numbers")

    def __init__(self, params: Mapping[str, FittedParameter], fit: Source) -> None:
        common = tuple(tuple(getattr(p, name) for name in _COMMON) for p in params.values())
        numbers = np.array([[getattr(p, name) for name in _NUMBERS] for p in params.values()])
        self.__setstate__((common, numbers, fit))

    def __getstate__(self) -> tuple[Any, ...]:
        return tuple(self._common.values()), self._numbers, self._fit

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        common, self._numbers, self._fit = state
        self._common = _by_name(common)

    def __getitem__(self, name: str) -> FittedParameter:
        common = self._common[name]
        numbers = self._numbers[list(self._common).index(name)].tolist()
        given = dict(zip((*_COMMON, *_NUMBERS), (*common, *numbers), strict=True))
        found = FittedParameter(**given)
        object.__setattr__(found, "fit", self._fit)
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self._common)

    def __len__(self) -> int:
        return len(self._common)

    def __repr__(self) -> str:
        return repr(dict(self))


@lru_cache(maxsize=256)
def _by_name(common: tuple[tuple[Any, ...], ...]) -> dict[str, tuple[Any, ...]]:
    """The shared entries of each parameter; the same object for all results that agree in them."""
    return {entries[0]: entries for entries in common}
