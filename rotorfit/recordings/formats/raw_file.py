"""A recording as its file holds it: channels of samples that are read piece by piece, and attributes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, eq=False)
class RawChannel:
    """One channel of a file."""

    name: str  # as the file has it
    size: int  # samples
    samples: Callable[[int, int], NDArray[Any]]
    volts_per_count: float | None = None  # factor to volts that the file gives; None: not given
    offset: float = 0.0  # volts at count zero
    full_count: float | None = None  # largest count the file's type can hold, for integers; None: the file holds volts
    sample_rate: float | None = None  # Hz; None: not given
    unit: str = ""  # as the file has it; empty: not given
    start: float = 0.0  # time of the first sample after that of the record, s


@dataclass(frozen=True, kw_only=True, eq=False)
class RawFile:
    """A file of raw signals."""

    name: str  # of the file, without its folder
    channels: Mapping[str, RawChannel]  # by name
    attributes: Mapping[str, float | str] = field(default_factory=dict)  # what the file says of itself
    sample_rate: float | None = None  # Hz; None: not given
    remarks: tuple[str, ...] = ()  # what was odd about the file and how it was read


def full_count(kind: np.dtype[Any]) -> float | None:
    """Largest count that an integer type holds; None for floating-point samples, which are volts."""
    return float(np.iinfo(kind).max) if kind.kind in "iu" else None


_UNIT_KEYS = {"unit", "units", "unitstring", "engineeringunit", "engineeringunits", "yunit", "yunits"}


def unit_said(said: Mapping[str, Any]) -> str:
    """Unit that attributes or fields give under one of its usual names; nothing without."""
    for name, value in said.items():
        if isinstance(value, str) and name.replace("_", "").replace(" ", "").lower() in _UNIT_KEYS:
            return value.strip()
    return ""


def plain(values: Mapping[str, Any]) -> dict[str, float | str]:
    """Attributes as plain numbers and text; what is neither, an array for instance, is left out."""
    found: dict[str, float | str] = {}
    for name, value in values.items():
        item = (
            value.item()
            if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.size == 1)
            else value
        )
        if isinstance(item, bytes):
            item = item.decode("utf-8", "replace")
        if isinstance(item, str) or (isinstance(item, int | float) and np.isfinite(item)):
            found[name] = item
    return found
