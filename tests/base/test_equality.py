"""Records of arrays are equal if they hold the same values."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rotorfit.base.equality import ByValue


@dataclass(frozen=True, eq=False)
class Record(ByValue):
    name: str
    values: Any
    more: Any = ()
    holder: Any = field(default=None, compare=False)


RECORD = Record(
    "run",
    np.array([1.0, np.nan]),
    {"a": [Record("inner", np.array([{"x": float("nan")}, (1, 2)], dtype=object))], "b": float("nan")},
)


def test_copies_are_equal_and_have_one_hash():
    """NaN, objects in arrays, records in lists in mappings."""
    for copy in (pickle.loads(pickle.dumps(RECORD)), replace(RECORD, holder=1), replace(RECORD)):
        assert copy == RECORD
        assert hash(copy) == hash(RECORD)
    assert replace(RECORD, more=dict(reversed(RECORD.more.items()))) == RECORD
    assert replace(RECORD, values=np.array([1, 2])) == replace(RECORD, values=np.array([1.0, 2.0]))
    assert replace(RECORD, values=0.0) == replace(RECORD, values=np.float64(-0.0))


def test_any_value_that_differs_tells_records_apart():
    """Neighbours: a value, a size, a shape, a kind, a name, an inner record, a class."""
    values = (
        np.array([1.0, 2.0]),
        np.array([1.0]),
        np.array([[1.0, np.nan]]),
        None,
        [1.0, np.nan],
        np.array(["a", "b"]),
    )
    others = [replace(RECORD, values=one) for one in values]
    others += [replace(RECORD, name="runs"), replace(RECORD, more={**RECORD.more, "b": 0.0})]
    inner = replace(RECORD.more["a"][0], values=np.array([{"x": 0.0}, (1, 2)], dtype=object))
    others += [replace(RECORD, more={**RECORD.more, "a": [inner]}), replace(RECORD, more=()), "run", None]
    assert RECORD not in others

    class Own(Record):
        pass

    assert Own("a", 1) != Record("a", 1)
