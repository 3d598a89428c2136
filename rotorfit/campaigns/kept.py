"""Fits of thousands of runs: in little memory, and as a store keeps them meanwhile, exact and without pickle."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from rotorfit.estimators.file_reading import decompressed, reading
from rotorfit.fitting.json_values import decode, encode
from rotorfit.fitting.quantities import FittedParameter, Source
from rotorfit.models import RotorModel
from rotorfit.version import __version__


def key_of(model: RotorModel, options: Mapping[str, Any]) -> str:
    """Key of a fit by its model, options and version; a run adds its readings: :func:`run_key`."""
    return json.dumps([__version__, encode(model), encode(dict(options))], sort_keys=True)


def run_key(common: str, content: str) -> str:
    """Hash by which the fit of a run with such readings is found again."""
    return hashlib.sha256(f"{common}{content}".encode()).hexdigest()


def to_bytes(fields: Mapping[str, Any]) -> bytes:
    """Fields of a record as compressed JSON."""
    return zlib.compress(json.dumps(encode(dict(fields)), allow_nan=False).encode("utf-8"))


def from_bytes(data: bytes) -> dict[str, Any]:
    """The fields of :func:`to_bytes`."""
    name = "a fit that the store keeps"
    with reading(name, "fit of a run"):
        found: dict[str, Any] = decode(json.loads(decompressed(name, data, len(data))))
    return found


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
