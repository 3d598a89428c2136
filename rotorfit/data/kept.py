"""What was worked out of an experiment, kept as long as the experiment lives and its columns stay as they are.

Every fit of the same data asks for the same check and the same layout again. Arrays can be written to, so that each is
compared by a checksum with what it was.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from types import MappingProxyType
from typing import Any
from weakref import WeakKeyDictionary
from zlib import crc32

import numpy as np

from rotorfit.data.experiments import Experiment

MOST_KEPT = 100_000
"""Rows up to which what takes memory for each of them is kept."""


def kept(experiment: Experiment) -> dict[Any, Any]:
    """Notes on an experiment, empty where there are none yet or where its columns changed.

    Args:
        experiment: the data.
    """
    now = _UNCHANGED.get().get(experiment)
    if now is None:
        now = _checksum(experiment)
    before, notes = _KEPT.get(experiment, (now, None))
    if notes is None or before != now:
        notes = {}
        _KEPT[experiment] = now, notes
    return notes


@contextmanager
def unchanged(experiments: Sequence[Experiment]) -> Iterator[None]:
    """Meanwhile nobody writes to the columns of experiments: one checksum of each serves all who ask.

    Args:
        experiments: what somebody works on.
    """
    known = _UNCHANGED.get()
    before = _UNCHANGED.set({**known, **{one: _checksum(one) for one in experiments if one not in known}})
    try:
        yield
    finally:
        _UNCHANGED.reset(before)


_KEPT: WeakKeyDictionary[Experiment, tuple[int, dict[Any, Any]]] = WeakKeyDictionary()
_UNCHANGED: ContextVar[Mapping[Experiment, int]] = ContextVar("unchanged", default=MappingProxyType({}))


def _checksum(experiment: Experiment) -> int:
    columns = [getattr(experiment, name) for name in experiment._columns()]
    found = 0
    for values in map(np.asarray, [*columns, *experiment.attributes.values()]):
        told = np.array(values.tolist(), dtype=str) if values.dtype.kind == "O" else values
        found = crc32(np.ascontiguousarray(told).data, found)
    return found
