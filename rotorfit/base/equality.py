"""Records that are equal if they hold the same values, whoever made or unpickled them."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


class ByValue:
    """A record that equals another of its class whose fields hold the same values; NaN is the same as NaN.

    Fields that follow from others, or lead back to what holds the record, are ``field(compare=False)``. Of a class that
    says what its copies need, that is compared.
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return self is other or same(_held(self), _held(other))

    def __hash__(self) -> int:
        return hash((type(self), _mark(_held(self))))


def same(one: Any, other: Any) -> bool:
    """True if two values are of one kind and hold the same, arrays entry by entry.

    Example:
        >>> import numpy as np
        >>> from rotorfit.base.equality import same
        >>> same({"K": np.array([1.0, np.nan])}, {"K": np.array([1.0, np.nan])})
        True
    """
    if one is other:
        return True
    for numbers in (np.ndarray, _SCALARS):
        if isinstance(one, numbers) and isinstance(other, numbers):
            return _same_arrays(np.asarray(one), np.asarray(other))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if type(one) is not type(other):
        return False
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    plain = is_dataclass(one) and not isinstance(one, ByValue)
    return same(_held(one), _held(other)) if plain else bool(one == other)


_SCALARS = (np.generic, int, float, complex)


def _same_arrays(one: NDArray[Any], other: NDArray[Any]) -> bool:
    if one.dtype.kind == other.dtype.kind == "O":
        return one.shape == other.shape and all(map(same, one.ravel().tolist(), other.ravel().tolist()))
    return np.array_equal(one, other, equal_nan={one.dtype.kind, other.dtype.kind} <= set("fcmM"))


def _held(record: Any) -> Any:
    said: object = type(record).__getstate__
    if said is not object.__getstate__:
        return record.__getstate__()
    return {one.name: getattr(record, one.name) for one in fields(record) if one.compare}


def _mark(value: Any) -> Hashable:
    """What values that are the same have in common and others mostly not: names, numbers and sizes."""
    if isinstance(value, Mapping):
        return frozenset((key, _mark(one)) for key, one in value.items())
    if isinstance(value, list | tuple):
        return tuple(map(_mark, value))
    if isinstance(value, np.ndarray):
        return hash(value.shape)
    return hash(value) if isinstance(value, str | int | ByValue) else None
