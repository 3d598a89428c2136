"""Which rows of the experiments share one parameter vector, where parameters are fitted per attribute."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorfit.data.experiments import Experiment
from rotorfit.models.array_types import Index


@dataclass(frozen=True)
class Grouping:
    """Which rows share one parameter vector."""

    suffixes: tuple[Mapping[str, str], ...]  # for each group the suffix of each ``per`` parameter, ``{"D"
    rows: tuple[Index, ...]  # for each experiment, the group of each of its rows


def group_rows(experiments: Sequence[Experiment], per: Mapping[str, str]) -> Grouping:
    """Group rows by the distinct values of attributes."""
    if not per:
        return Grouping(({},), tuple(np.zeros(len(experiment), dtype=np.intp) for experiment in experiments))
    seen: dict[tuple[str, ...], int] = {}
    rows = []
    for experiment in experiments:
        keys = [[_label(attribute, v) for v in experiment.attribute(attribute).tolist()] for attribute in per.values()]
        tuples = zip(*keys, strict=True)
        rows.append(np.array([seen.setdefault(key, len(seen)) for key in tuples], dtype=np.intp))
    suffixes = tuple(dict(zip(per, key, strict=True)) for key in seen)
    return Grouping(suffixes, tuple(rows))


def _label(attribute: str, value: Any) -> str:
    return f"{attribute}={value:.10g}" if isinstance(value, (int, float)) else f"{attribute}={value}"
