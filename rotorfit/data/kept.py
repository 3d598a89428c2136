"""What was worked out of an experiment, kept as long as the experiment lives and its columns stay as they are.

Every fit of the same data asks for the same check and the same layout again. Arrays can be written to, so that each is
compared by a checksum with what it was.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cached_property
from types import MappingProxyType
from typing import Any
from weakref import WeakKeyDictionary
from zlib import crc32

import numpy as np

from rotorfit.data.experiments import Experiment

MOST_KEPT = 100_000
"""Rows up to which what takes memory for each of them is kept."""


def kept(experiment: Experiment) -> dict[Any, Any]:
    """Notes on an experiment, empty where there are none yet or where its columns changed."""
    held = _UNCHANGED.get().get(experiment)
    now = (_Columns(experiment) if held is None else held[0]).checksum
    before, notes = _KEPT.get(experiment, (now, None))
    if notes is None or before != now:
        notes = {}
        _KEPT[experiment] = now, notes
    return notes


def kept_rows(experiment: Experiment) -> dict[Any, Any]:
    """Notes that take memory for each row, which last no longer than :func:`unchanged` where there are many."""
    if len(experiment) <= MOST_KEPT:
        return kept(experiment)
    held = _UNCHANGED.get().get(experiment)
    return {} if held is None else held[1]


@contextmanager
def unchanged(experiments: Sequence[Experiment]) -> Iterator[None]:
    """Meanwhile nobody writes to the columns of experiments: one checksum of each serves all who ask."""
    known = _UNCHANGED.get()
    own = {one: (known[one][0] if one in known else _Columns(one), dict[Any, Any]()) for one in experiments}
    before = _UNCHANGED.set({**known, **own})
    try:
        yield
    finally:
        _UNCHANGED.reset(before)


class _Columns:
    """Columns of an experiment at one moment."""

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment

    @cached_property
    def checksum(self) -> int:
        """Tells whether they were written to."""
        columns = [getattr(self._experiment, name) for name in self._experiment._columns()]
        found = 0
        for values in map(np.asarray, [*columns, *self._experiment.attributes.values()]):
            told = np.array(values.tolist(), dtype=str) if values.dtype.kind == "O" else values
            found = crc32(np.ascontiguousarray(told).data, found)
        return found


_KEPT: WeakKeyDictionary[Experiment, tuple[int, dict[Any, Any]]] = WeakKeyDictionary()
_UNCHANGED: ContextVar[Mapping[Experiment, tuple[_Columns, dict[Any, Any]]]] = ContextVar(
    "unchanged", default=MappingProxyType({})
)
