"""Modes of a modal model: which poles are stable as their number rises, and what the modes look like."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.array_types import Float
from rotorfit.base.significance import CHANCE_ERRORS
from rotorfit.estimators.starting.modal_start import stabilisation
from rotorfit.identify.fitting.result import FitResult
from rotorfit.models import Modal
from rotorfit.show.plots import style
from rotorfit.show.plots.journal import rig_of


def _modal(fit: FitResult) -> Modal:
    if not isinstance(fit.model, Modal):
        raise ValueError(f"modes alone are drawn of rf.models.Modal, this fit is of {fit.model.name}; use fit.modes()")
    return fit.model


@style.on_sheet
def plot_stabilisation(fit: FitResult, most: int | None = None, *, sheet: style.Sheet) -> Figure:
    """Natural frequencies of poles against how many pairs are looked for, over the size of all responses."""
    model = _modal(fit)
    blocks = fit.problem.responses
    figure, axes = sheet.grid(1, 1, f"{rig_of(fit)}: stabilisation", size=(6.5, 3.6))
    axis, scale = axes[0, 0], sheet.per_rad_s
    w, size = _responses(blocks)
    back = axis.twinx()
    back.semilogy(w * scale, size * sheet.length[0], color=style.AXES, lw=1)
    style.decade_ticks(back.yaxis)
    back.set_ylabel(f"rms response per unit force, {sheet.length[1]}/N", color=style.GREY)
    back.tick_params(labelsize=7, colors=style.GREY)
    axis.set_zorder(back.get_zorder() + 1)
    axis.patch.set_visible(False)
    top = float(w.max())
    for found in stabilisation(model, blocks, most or model.modes + 5):
        for some, marker, colour in (
            (found.stable, "o", style.colour_of(0, 2)),
            (~found.stable, "x", style.colour_of(1, 2)),
        ):
            at = found.frequency[some & (found.frequency <= top)]
            axis.plot(at * scale, np.full(at.size, found.order), marker, ms=4, color=colour)
    for number in range(1, model.modes + 1):
        for name, parameter in fit.params.items():
            if name.startswith(f"wn{number if model.modes > 1 else ''}") and parameter.value <= top:
                axis.axvline(parameter.value * scale, color=style.INK, lw=0.8, ls="--")
    axis.set_xlabel(f"frequency, {sheet.rate_unit}")
    axis.set_ylabel("pairs of poles")
    entries = {
        "stable within 1 % and 5 % of damping": {"marker": "o", "color": style.colour_of(0, 2), "ls": "none"},
        "not stable": {"marker": "x", "color": style.colour_of(1, 2), "ls": "none"},
        "fitted modes": {"color": style.INK, "ls": "--"},
    }
    style.legend_below(figure, entries)
    return figure


def _responses(blocks: list) -> tuple[Float, Float]:  # type: ignore[type-arg]
    """Frequencies, rad/s, and the root mean square of all responses per unit force there."""
    parts = [(np.abs(b.frequency[b.line]), b.measured / np.abs(b.force).max(axis=1)[b.line]) for b in blocks]
    w, value = (np.concatenate(column) for column in zip(*parts, strict=True))
    lines, number = np.unique(np.round(w, 6), return_inverse=True)
    power = np.bincount(number.reshape(-1), np.abs(value) ** 2) / np.bincount(number.reshape(-1))
    return lines, np.sqrt(power)


@style.on_sheet
def plot_mode_shapes(fit: FitResult, *, sheet: style.Sheet) -> Figure:
    """Gains of the probes in each mode, that at which all are normalised being one: real and imaginary part with 95 %
    errors, probes in the order of the data."""
    model = _modal(fit)
    read = [p for p in dict.fromkeys(p for test in fit.experiments for p in test.planes) if p in model.read_planes]
    axes_of = ("x", "y") if model.frame == "xy" else ("",)
    figure, axes = sheet.grid(
        model.modes, len(axes_of), f"{rig_of(fit)}: mode shapes", size=(6.5 / len(axes_of), 1.9), one_abscissa=True
    )
    handles = []
    for row in range(model.modes):
        tag = str(row + 1) if model.modes > 1 else ""
        for column, end in enumerate(axes_of):
            axis = axes[row, column]
            planes = [plane for plane in read if model.is_read(plane, end or "z")]
            places = np.arange(len(planes))
            for k, part in enumerate(("", "_im")):
                names = ["_".join(n for n in (f"g{tag}", plane, end) if n) + part for plane in planes]
                known = 1.0 - k  # gain of the first probe
                value = np.array([fit.params[n].value if n in fit.params else known for n in names])
                error = np.array([fit.params[n].stderr if n in fit.params else 0.0 for n in names])
                reach = CHANCE_ERRORS * np.where(np.isfinite(error), error, 0.0)
                look = {"fmt": "o-" if not k else "s--", "ms": 3, "lw": 1 - 0.3 * k, "capsize": 2}
                handles.append(axis.errorbar(places, value, reach, color=style.colour_of(k, 2), **look))
            axis.axhline(0.0, color=style.AXES, lw=0.7)
            axis.set_xticks(places, planes)
            own = [fit.params[n] for n in (f"wn{tag}_{end}", f"wn{tag}") if n in fit.params]
            axis.set_ylabel(f"mode {row + 1}{f' {end}' if end else ''}, {sheet.rate_words(own[0].value)}")
    style.legend_below(figure, dict(zip(("real part", "imaginary part"), handles, strict=False)))
    return figure
