"""Rows of a test: what a block has of each, and those that cannot be observed, refused in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.digits import counted, significant
from rotorfit.estimators.blocks.row_keys import words
from rotorfit.lab.data.rows import Experiment
from rotorfit.models import RotorModel

LARGEST_MEASURED_ECCENTRICITY = 1.0 - 1e-6
"""Eccentricity above which a measured position is out of the clearance."""


def of_rows(model: RotorModel, test: Experiment, names: Iterable[str]) -> dict[str, Any]:
    """Columns that blocks with a reading a row share; readings of one name are one response."""
    labels, label = words(np.array(list(names)))
    return {"model": model, "speed": test.speed, "run": test.run, "label": label, "labels": tuple(labels)}


def check_clearance(eps: Float, clearance: float, what: str) -> None:
    """Refuse motion beyond the clearance."""
    largest = float(np.nanmax(eps, initial=0.0))
    if largest > LARGEST_MEASURED_ECCENTRICITY:
        raise ValueError(
            f"{what} reach {significant(largest * clearance * 1e6, 4)} um, the clearance is "
            f"{significant(clearance * 1e6, 4)} um; "
            "check the clearance (clearance_um=, --clearance-um) and the units of the data"
        )


def check_finite(test: Experiment, *columns: NDArray[np.generic]) -> None:
    """Refuse rows that are not finite."""
    bad = np.zeros(len(test), dtype=bool)
    for column in columns:
        bad |= ~np.isfinite(column)
    if bad.any():
        rows = ", ".join(str(row + 1) for row in np.flatnonzero(bad)[:8])
        raise ValueError(f"{test.source or test.title}: {counted(bad.sum(), 'row')} not finite ({rows}), to be removed")


def check_planes(
    model: RotorModel, test: Experiment, planes: Sequence[str], forced: Sequence[str], *, forces: str
) -> None:
    """Refuse planes that the model does not have."""
    if not (set(planes) <= set(model.read_planes) and set(forced) <= set(model.planes)):
        beside, chosen = (f" and {forces} {', '.join(forced)}", " --where force_plane=A") if forced else ("", "")
        fewer = f"; of so many planes it takes only those chosen (where=, --where plane=A{chosen})"
        fewer = fewer if len({*planes, *forced}) > len(model.planes) else ""
        raise ValueError(
            f"{test.source or test.title} has planes {', '.join(planes)}{beside}; the model "
            f"{model.name} has {', '.join(model.read_planes)}: map names (planes=, --planes){fewer}"
        )


def spread_of_repeats(values: ComplexArray, same: Index) -> float | None:
    """Standard deviation of each part from values measured several times, None where none was."""
    free, total = 0, 0.0
    for key in np.unique(same):
        part = values[same == key]
        free += part.size - 1
        total += float(np.sum(np.abs(part - part.mean()) ** 2))
    return float(np.sqrt(total / (2 * free))) if free and total > 0 else None
