"""Keywords that every figure takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypedDict


class PlotKeywords(TypedDict, total=False):
    """Keywords of every figure: where it is drawn, and its units; see :meth:`rotorfit.FitResult.plot.bode`."""

    ax: Any
    unit: str | Sequence[str] | None
