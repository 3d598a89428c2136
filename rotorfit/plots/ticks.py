"""Ticks of an axis: no more than are read, none outside of it, and plain numbers on logarithmic axes.

Every tick is five objects to matplotlib, measured and drawn one by one: together they are a third of a figure's time.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from matplotlib.ticker import AutoLocator, Locator, LogFormatter, LogLocator, MaxNLocator

_MOST = 6
"""Intervals between labelled ticks, at most."""
_LABELLED = 1.5
"""Decades up to which ticks between powers are labelled too."""
_FEWEST = 2
"""Labelled ticks of a logarithmic axis, at least."""
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class _InView(Locator):
    """Leaves out the ticks beyond the ends of the axis, which matplotlib makes and does not draw."""

    def tick_values(self, vmin: float, vmax: float) -> list[float]:
        ticks = np.asarray(super().tick_values(vmin, vmax), dtype=float)
        low, high = min(vmin, vmax), max(vmin, vmax)
        slack = 1e-10 * (high - low)
        return [float(tick) for tick in ticks[(ticks >= low - slack) & (ticks <= high + slack)]]


class _Few(_InView, AutoLocator):
    """Matplotlib's own choice of ticks, of so many intervals at most."""

    def tick_values(self, vmin: float, vmax: float) -> list[float]:
        space = cast("Any", self.axis).get_tick_space()
        self.set_params(nbins=min(max(space, 1), _MOST))
        return super().tick_values(vmin, vmax)


class _AtMost(_InView, MaxNLocator):
    """So many intervals at most, whatever the size of the axis."""


class _Powers(_InView, LogLocator):
    """Ticks of a logarithmic axis."""


class _Between(_InView, LogLocator):
    """Twice and five times the powers, or a few round numbers where that and the powers leave less than two ticks.

    Matplotlib's own choice there is as many as a linear axis has, which in a low panel stand on one another.
    """

    def __init__(self) -> None:
        super().__init__(subs=(2.0, 5.0))

    def tick_values(self, vmin: float, vmax: float) -> list[float]:
        low, high = sorted((vmin, vmax))
        if not 0 < low < high < np.inf:
            return super().tick_values(vmin, vmax)
        decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
        ticks = np.outer(decades, [1.0, 2.0, 5.0]).ravel()
        if np.count_nonzero((ticks >= low) & (ticks <= high)) < _FEWEST:
            ticks = np.asarray(MaxNLocator(nbins=_FEWEST + 1, steps=[1, 2, 5, 10]).tick_values(low, high))
        return [float(tick) for tick in ticks if low <= tick <= high and not np.isclose(decades, tick).any()]


class _PlainPowers(LogFormatter):
    """Labels of a logarithmic axis without mathematical type, which takes ten times as long to set."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        if not super().__call__(x, pos):
            return ""
        mantissa, _, exponent = f"{x:.0e}".partition("e")
        if -4 < int(exponent) < 5:
            return f"{x:g}"
        power = f"10{str(int(exponent)).translate(_RAISED)}"
        return power if mantissa == "1" else f"{mantissa}·{power}"


def few_ticks(axis: Any) -> None:
    """Give a linear axis of x or y few ticks."""
    axis.set_major_locator(_Few())


def ticks_at_most(axis: Any, most: int) -> None:
    """Give a linear axis of x or y few ticks that stay the same when the layout changes its size."""
    axis.set_major_locator(_AtMost(nbins=most))


def plain_powers(axis: Any) -> None:
    """Write the labels of a logarithmic axis as 0.1, 1, 10, and powers only where that gets long."""
    axis.set_major_locator(_Powers())
    axis.set_minor_locator(_Between())
    axis.set_major_formatter(_PlainPowers())
    axis.set_minor_formatter(_PlainPowers(labelOnlyBase=False, minor_thresholds=(_LABELLED, _LABELLED)))
    axis.set_tick_params(which="minor", labelsize=axis.get_tick_params(which="major").get("labelsize"))
