"""What the errors of a fit are made of: a bar of a hundred per cent of the variance for each result."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.digits import significant, with_error
from rotorfit.identify.fitting.causes.table import noun_of
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.summary import correction_names
from rotorfit.identify.uncertainty.budget import BudgetRow
from rotorfit.models.parameters import bare_name
from rotorfit.show.plots import style
from rotorfit.show.plots.journal import rig_of

_READS = (
    "Noise: scatter of the readings. Bounded: causes that these data limit. On trust: assumed sizes that these data",
    "cannot check. Shares are of the variance, so that they add up.",
)
_MOST = 14  # results of a figure


@style.on_sheet
def plot_budget(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """Value, error and relative error of each result, the shares of its variance, and the largest cause on trust.

    ``ax`` and ``unit`` are as for :meth:`rotorfit.FitResult.plot.bode`.

    Raises:
        ValueError: a fit without causes, whose errors are all noise.
    """
    if not fit.causes.rows:
        raise ValueError("this fit has no causes beside its model (causes=None): its errors are all noise")
    corrections = correction_names(fit.model)
    every = [row for row in fit.budget().rows if row.stderr > 0 and bare_name(row.name) not in corrections]
    rows = every[-1:] + every[:-1] if every and every[-1].name == "threshold speed" else every
    rows = rows[:_MOST]
    height = 0.85 + 0.2 * len(rows)
    title = f"{rig_of(fit)}: what the errors are made of"
    figure, ((axis,),) = sheet.grid(1, 1, title, size=(style.PAGE[0], height), reads=_READS)
    axis.set_xlim(0, 1)
    axis.set_ylim(len(rows) - 0.4, -1.15)
    names = [style.literal(row.name) for row in rows]
    axis.set_yticks(np.arange(len(rows)), [f"{name}   {_words(row)}" for name, row in zip(names, rows, strict=True)])
    axis.tick_params(axis="y", length=0, labelsize=style.TYPE)
    axis.set_xticks([0, 0.5, 1], ["0", "50", "100 %"])
    axis.set_xlabel("share of the variance of the total error")
    axis.spines[:].set_visible(False)
    axis.grid(visible=False)
    for place, row in enumerate(rows):
        _bar(axis, fit, place, row)
    heads = (0.0, "noise", style.GREY), (0.3, "bounded by the data", style.BOUNDED), (0.78, "on trust", style.SHARES[2])
    for at, words, colour in heads:
        axis.text(at, -0.75, words, color=colour, fontsize=style.TYPE, fontweight="bold", va="center")
    axis.annotate(
        "largest on trust", (1, -0.75), (5, 0), xycoords="data", textcoords="offset points", va="center",
        fontsize=style.SMALL_TYPE, color=style.GREY, annotation_clip=False,
    )  # fmt: skip
    return figure


def _words(row: BudgetRow) -> str:
    """Value, error and relative error."""
    unit = "" if row.unit == "1" else f" {row.unit}"
    share = f"   {significant(100 * row.stderr / abs(row.value), 2)} %" if row.value else ""
    return f"{' ± '.join(with_error(row.value, row.stderr))}{unit}{share}".replace("-", "−")


def _bar(axis: Any, fit: FitResult, place: int, row: BudgetRow) -> None:
    begin = 0.0
    least = 0.07  # share from which its number fits into it
    for share, colour, ink in zip(
        (row.noise, row.bounded, row.trust), style.SHARES, (style.INK, style.INK, "white"), strict=True
    ):
        width = (share / row.stderr) ** 2
        axis.barh(place, width, left=begin, height=0.56, color=colour, edgecolor="white", linewidth=0.8)
        if width >= least:
            axis.text(
                begin + width / 2, place, f"{100 * width:.0f}", ha="center", va="center", color=ink,
                fontsize=style.SMALL_TYPE, fontweight="bold",
            )  # fmt: skip
        begin += width
    shares = {name: abs(share) for name, share in row.on_trust.items()}
    if shares and max(shares.values()) > 0:
        cause = noun_of(fit.causes[max(shares, key=lambda name: shares[name])])
        axis.annotate(
            style.literal(cause), (1, place), (5, 0), textcoords="offset points", va="center",
            fontsize=style.SMALL_TYPE, annotation_clip=False,
        )  # fmt: skip
