"""What was worked out of an experiment, kept as long as the experiment lives and its columns stay as they are.

Every fit of the same data asks for the same check and the same layout again. Arrays can be written to, so that each is
compared by a checksum with what it was.
"""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary
from zlib import crc32

import numpy as np

from rotorfit.data.experiments import Experiment


def kept(experiment: Experiment) -> dict[Any, Any]:
    """Notes on an experiment, empty where there are none yet or where its columns changed.

    Args:
        experiment: the data.
    """
    now = _checksum(experiment)
    before, notes = _KEPT.get(experiment, (now, None))
    if notes is None or before != now:
        notes = {}
        _KEPT[experiment] = now, notes
    return notes


_KEPT: WeakKeyDictionary[Experiment, tuple[int, dict[Any, Any]]] = WeakKeyDictionary()


def _checksum(experiment: Experiment) -> int:
    columns = [getattr(experiment, name) for name in experiment._columns()]
    found = 0
    for values in map(np.asarray, [*columns, *experiment.attributes.values()]):
        told = np.array(values.tolist(), dtype=str) if values.dtype.kind == "O" else values
        found = crc32(np.ascontiguousarray(told).data, found)
    return found
