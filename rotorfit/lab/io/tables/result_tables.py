"""Tables of results as CSV, in which no name from a file becomes a formula of a spreadsheet."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rotorfit.lab.io.tables.cells import as_text

if TYPE_CHECKING:
    from pandas import DataFrame


def rows_csv(rows: Iterable[Iterable[Any]]) -> str:
    """Rows of cells, the header first; None is a blank cell."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(map(as_text, row) for row in rows)
    return text.getvalue()


def records_csv(records: Sequence[Mapping[str, Any]]) -> str:
    """Records of the same keys, which are the header; what is not finite is a blank cell."""
    rows = ([None if isinstance(v, float) and not math.isfinite(v) else v for v in r.values()] for r in records)
    return rows_csv([records[0].keys(), *rows])


def frame_csv(frame: DataFrame) -> str:
    """A DataFrame without its index, 15 significant digits; NaN is a blank cell."""
    told = frame.map(as_text).rename(columns=as_text)
    return str(told.to_csv(index=False, lineterminator="\n", float_format="%.15g"))
