"""Figure of a plan: shares of the time along the lines, and the gains by which they are judged."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from rotorfit.show.plots.style import GREY, MARKERS, Sheet, colour_of, legend_below, literal, on_sheet
from rotorfit.studies.planning.record import Plan


@on_sheet
def plot_plan(plan: Plan, *, sheet: Sheet) -> Figure:
    """Share of the averaging time, and the gain by which the equivalence theorem judges it, against frequency.

    ``ax`` and ``unit`` are as for :meth:`rotorfit.FitResult.plot.bode`.

    Example:
        >>> figure = rf.plan(fit.model, fit, rig, noise_um=0.2, quantity="lam").plot()
    """
    aim = " and ".join(plan.quantity).replace("_", " ") if plan.quantity else "all parameters together"
    figure, axes = sheet.grid(2, 1, literal(f"Plan for {aim}"), size=(6.2, 2.4), one_abscissa=True)
    top, below = axes[:, 0]
    runs = np.array(plan.lines.run)
    names = list(dict.fromkeys(plan.lines.run))
    for number, name in enumerate(names):
        own = np.flatnonzero(runs == name)
        own = own[np.argsort(plan.lines.frequency[own], kind="stable")]
        x = plan.lines.frequency[own] * sheet.per_rad_s
        look = {"marker": MARKERS[number % len(MARKERS)], "lw": 1.0, "ms": 3, "color": colour_of(number, len(names))}
        top.plot(x, plan.share[own] * 100, label=literal(name), **look)
        below.plot(x, plan.certificate.phi[own], **look)
    top.axhline(100 / plan.share.size, color=GREY, lw=0.8, ls="--", label="all lines alike")
    below.axhline(plan.certificate.phi.max(), color=GREY, lw=0.8, ls=":")
    top.set_ylabel("share of the averaging time, %")
    below.set_ylabel("gain of a line (mean: 1)")
    below.set_xlabel(f"frequency of the force, {sheet.rate_unit} (backward < 0)")
    few = 12  # runs that a legend names
    if len(names) <= few:
        legend_below(figure)
    return figure
