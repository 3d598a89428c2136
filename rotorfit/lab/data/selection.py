"""Rows of an experiment by what is known of them: runs, conditions, nearness to the running speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Bool
from rotorfit.base.names import unknown_name
from rotorfit.base.units import UNITS
from rotorfit.lab.data.rows import Experiment

Wanted = str | float | tuple[float, float] | Sequence[str] | Sequence[float]
"""A value, several of them, or a range (low, high) as a tuple of two numbers."""
Test = TypeVar("Test", bound=Experiment)


def selected(
    test: Test,
    *,
    where: Mapping[str, Wanted] | None = None,
    exclude: Mapping[str, Wanted] | None = None,
    drop_near_1x: float = 0.0,
) -> Test:
    """Readings that fit, by run, speed, frequency (``frequency_hz``, ``frequency_rpm``), plane and attributes."""
    keep = np.ones(len(test), dtype=bool)
    for name, wanted in (where or {}).items():
        keep &= _matches(test, name, wanted)
    for name, unwanted in (exclude or {}).items():
        keep &= ~_matches(test, name, unwanted)
    if drop_near_1x:
        responses = test.perturbation
        if responses is None or test.synchronous:
            raise ValueError(
                f"{test.source or 'the test'}: readings near 1x can be dropped from nonsynchronous perturbation tests "
                "only"
            )
        if not 0 < drop_near_1x < 1:
            raise ValueError(f"drop_near_1x is a fraction of the speed, above 0 and below 1; got {drop_near_1x:g}")
        keep &= ~(np.abs(np.abs(responses.frequency) - test.speed) < drop_near_1x * test.speed)
    return _kept(test, keep, "the selection")


def _kept(test: Test, keep: Bool, after: str) -> Test:
    if not keep.any():
        raise ValueError(f"{test.source or 'the test'}: no reading is left after {after} (of {len(test)})")
    return test if keep.all() else test.select(keep)


def without(test: Test, numbers: Sequence[int]) -> Test:
    """The test without some readings, by number from 1."""
    wrong = [number for number in numbers if not 1 <= number <= len(test)]
    if wrong:
        raise ValueError(
            f"skip: there is no reading {wrong[0]} in {test.source or 'the test'}, of {len(test)} readings"
        )
    keep = np.ones(len(test), dtype=bool)
    keep[np.asarray(numbers, dtype=np.intp) - 1] = False
    return _kept(test, keep, "skip")


_FREQUENCIES = {"frequency_hz": "hz", "frequency_rpm": "rpm"}
"""Names of the size of a frequency, of forward and of backward readings alike, and its unit."""


def _values(test: Experiment, name: str) -> NDArray[Any]:
    """What is known of each row by a name."""
    own = [n for n in ("plane", "direction", "force_plane") if hasattr(test, n)]
    swept = list(_FREQUENCIES) if test.frequencies.size else []
    known = ["run", "speed_rpm", *swept, *own, *test.attributes]
    if name not in known:
        raise ValueError(f"{test.source or 'the test'}: {unknown_name('attribute', name, known)}")
    if name in swept and name not in test.attributes:
        return np.asarray(np.round(np.abs(test.frequencies) / UNITS["frequency"][_FREQUENCIES[name]], 6))
    return np.asarray(getattr(test, name) if name in own else test.attribute(name))


def _matches(test: Experiment, name: str, wanted: Wanted) -> Bool:
    values = _values(test, name)
    numeric = np.issubdtype(values.dtype, np.number)
    if isinstance(wanted, tuple) and len(wanted) == 2 and not any(isinstance(end, str) for end in wanted):
        if not numeric:
            raise ValueError(f"{name} holds text: give its values, not a range")
        low, high = (float(end) for end in wanted)
        if name in _FREQUENCIES and high < 0:
            raise ValueError(f"{name} is a size, forward and backward alike; choose one of the two by run")
        return np.asarray((values >= low) & (values <= high))
    several = [wanted] if isinstance(wanted, str | float | int) else list(wanted)
    found = np.zeros(len(test), dtype=bool)
    for one in several:
        if numeric:
            try:
                number = float(str(one))
            except ValueError:
                raise ValueError(f"{name} holds numbers, not {one!r}") from None
            hit = np.isclose(values.astype(float), number, rtol=1e-6)
        else:
            hit = np.asarray(values == str(one))
            if name == "force_plane":
                hit |= test.forced_at(str(one))
        if not hit.any():
            distinct = [str(v) for v in dict.fromkeys(values.tolist())]
            raise ValueError(f"{test.source or 'the test'}: {unknown_name(name, str(one), distinct[:40])}")
        found |= hit
    return found
