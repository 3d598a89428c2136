"""A recording as its file holds it: channels of samples that are read piece by piece, and attributes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, eq=False)
class RawChannel:
    """One channel of a file.

    Attributes:
        name: as the file has it.
        size: samples.
        samples: reads samples ``start`` to ``stop`` as the file stores them (counts or volts).
        volts_per_count: factor to volts that the file gives; None: not given.
        offset: volts at count zero.
        full_count: largest count the file's type can hold, for integers; None: the file holds volts.
        sample_rate: Hz; None: not given.
        start: time of the first sample after that of the record, s.
    """

    name: str
    size: int
    samples: Callable[[int, int], NDArray[Any]]
    volts_per_count: float | None = None
    offset: float = 0.0
    full_count: float | None = None
    sample_rate: float | None = None
    start: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class RawFile:
    """A file of raw signals.

    Attributes:
        name: of the file, without its folder.
        channels: by name.
        attributes: what the file says of itself: numbers and text by name.
        sample_rate: Hz; None: not given.
        remarks: what was odd about the file and how it was read.
    """

    name: str
    channels: Mapping[str, RawChannel]
    attributes: Mapping[str, float | str] = field(default_factory=dict)
    sample_rate: float | None = None
    remarks: tuple[str, ...] = ()


def full_count(kind: np.dtype[Any]) -> float | None:
    """Largest count that an integer type holds; None for floating-point samples, which are volts.

    Args:
        kind: of the samples in the file.
    """
    return float(np.iinfo(kind).max) if kind.kind in "iu" else None


def plain(values: Mapping[str, Any]) -> dict[str, float | str]:
    """Attributes as plain numbers and text; what is neither, an array for instance, is left out.

    Args:
        values: attributes as the file's reader gives them.
    """
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
