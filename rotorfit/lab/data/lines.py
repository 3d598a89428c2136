"""Rows of a test put together by lines: what one run at one frequency under one force is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Index
from rotorfit.estimators.blocks.row_keys import combined, in_order, numbers, occurrence, words

_TEXT = ("run", "force_plane", "force_direction", "plane", "direction")
_LINE = ("run", "speed", "frequency", "force_plane", "force", "force_direction", "further_forces")


@dataclass(frozen=True, eq=False, kw_only=True)
class Lines:
    """Rows of a test distinguished by numbers, and put together by lines."""

    names: Mapping[str, list[str]]  # distinct entries of each column of text, in the order of the rows
    number: Mapping[str, Index]  # number of each row's entry by column, of text among ``names``, shape ``(N,)`` each
    line: Index  # line of each row, in the order of the rows, shape ``(N,)``
    first: Index  # first row of each line, shape ``(L,)``

    def apart(self) -> tuple[Index, Index]:
        """Line of each row and first row of each line, repeats of a reading being put on lines of their own."""
        reading = combined(self.line, self.number["plane"], self.number["direction"])
        if not reading.size or np.bincount(reading).max() == 1:
            return self.line, self.first
        first, line = in_order(combined(occurrence(reading), self.line))
        return line, first


def lines_of(columns: Mapping[str, NDArray[Any]]) -> Lines:
    """Lines of the columns of a test, the speed being the one that was set: probes may log it a moment apart."""
    text = {name: words(columns[name]) for name in _TEXT}
    number = {name: own for name, (_, own) in text.items()}
    number |= {name: numbers(columns[name]) for name in ("speed", "frequency", "force", "further_forces")}
    first, line = in_order(combined(*[number[name] for name in _LINE]))
    names = {name: found for name, (found, _) in text.items()}
    return Lines(names=names, number=number, line=line, first=first)
