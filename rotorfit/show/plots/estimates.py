"""Figures of what the data leave open: estimates side by side, a prediction with its bands, a profile.

Their records draw themselves by these functions, and are not imported here.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rotorfit.base.digits import significant
from rotorfit.show.plots import style


@style.on_sheet
def plot_comparison(comparison: Any, *, sheet: style.Sheet) -> Figure:
    """Each parameter's estimates side by side with their 95 % intervals, a panel a parameter.

    ``ax`` and ``unit`` are as for :meth:`rotorfit.FitResult.plot.bode`.

    Raises:
        ValueError: fits with no parameter in common.

    Example:
        >>> figure = rf.compare([fit]).plot()
    """
    fits = comparison.fits
    names = [n for n in comparison.parameters if sum(n in fit.params for fit in fits.values()) > 1 or len(fits) == 1]
    if not names:
        raise ValueError(f"{' and '.join(fits)} have no parameter in common: there is nothing to draw side by side")
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    figure, axes = sheet.grid(rows, columns, "Estimates with 95 % intervals", size=(2.6, 0.6 + 0.3 * len(fits)))
    for axis, name in zip(axes.flat, names, strict=False):
        found = [(i, fit.params[name]) for i, fit in enumerate(fits.values()) if name in fit.params]
        unit = found[0][1].unit
        scale, unit = style.prefix(np.array([p.value for _, p in found]), unit) if unit.startswith("N") else (1.0, unit)
        for i, p in found:
            low, high = p.interval(0.95)
            if np.isfinite([low, high]).all():
                axis.plot(scale * np.array([low, high]), [i, i], color=style.colour_of(i), lw=2)
            axis.plot(scale * p.value, i, "o" if p.vary else "|", color=style.colour_of(i), ms=5)
        axis.set_yticks(range(len(fits)), [style.literal(label) for label in fits], fontsize=7)
        style.few_ticks(axis.xaxis, intervals=3)
        axis.set_ylim(len(fits) - 0.5, -0.5)
        axis.set_xlabel(style.labelled(name, unit))
    for axis in axes.flat[len(names) :]:
        axis.set_visible(False)
    return figure


@style.on_sheet
def plot_prediction(prediction: Any, *, sheet: style.Sheet) -> Figure:
    """Amplitude and phase lead against frequency, or speed where the force is once per turn, with both bands.

    ``ax`` and ``unit`` are as for :meth:`rotorfit.FitResult.plot.bode`.

    Example:
        >>> figure = fit.predict([280.0, 300.0], 200.0, force_plane="disk", plane="journal").plot()
    """
    synchronous = np.array_equal(prediction.frequency, prediction.speed)
    speeds = np.unique(prediction.speed)
    at = "" if synchronous or speeds.size > 1 else f", {sheet.rate_words(speeds[0])}"
    title = style.literal(f"Predicted response at {prediction.plane}, force at {prediction.force_plane}{at}")
    figure, axes = sheet.grid(2, 1, title, size=(6.2, 2.4), one_abscissa=True)
    amplitude, phase = axes[:, 0]
    order = np.argsort(prediction.frequency, kind="stable")
    x = prediction.frequency[order] * sheet.per_rad_s
    seen = prediction.seen[order]
    scale, unit = (1e6, "µrad") if prediction.direction.startswith("r") else sheet.length
    size, angle = np.abs(seen) * scale, np.unwrap(np.angle(seen))
    what = "of the whole curve" if prediction.whole else "at each frequency"
    floor = size.min() / 2  # of the panel, to which a band reaches that holds zero
    for band, label, shade in ((prediction.band_new, "a new reading", 0.15), (prediction.band, "the mean", 0.4)):
        if not np.isfinite(band.amplitude).all():
            continue
        words = f"{significant(100 * prediction.level, 4)} % band of {label}, {what}"
        low, high = band.amplitude[order].T * scale
        amplitude.fill_between(x, np.maximum(low, floor), high, color=style.COLOURS[0], alpha=shade, lw=0, label=words)
        half = np.diff(band.phase[order], axis=1)[:, 0] / 2
        phase.fill_between(
            x, np.rad2deg(angle - half), np.rad2deg(angle + half), color=style.COLOURS[0], alpha=shade, lw=0
        )
    amplitude.plot(x, size, "-", lw=1.2, color=style.COLOURS[0], label="predicted")
    phase.plot(x, np.rad2deg(angle), "-", lw=1.2, color=style.COLOURS[0])
    amplitude.set_yscale("log")
    amplitude.set_ylim(bottom=floor)
    style.decade_ticks(amplitude.yaxis)
    amplitude.set_ylabel(f"amplitude, {sheet.amplitude_unit(unit)}")
    phase.set_ylabel(style.PHASE_LABEL)
    phase.set_ylim(max(phase.get_ylim()[0], -540), min(phase.get_ylim()[1], 540))
    phase.set_xlabel(f"{'speed' if synchronous else 'frequency of the force'}, {sheet.rate_unit}")
    style.legend_below(figure)
    return figure


@style.on_sheet
def plot_profile(profile: Any, *, sheet: style.Sheet) -> Figure:
    """Rise of chi-squared when a parameter is held at other values, beside the parabola of its standard error.

    ``ax`` and ``unit`` are as for :meth:`rotorfit.FitResult.plot.bode`.
    """
    figure, axes = sheet.grid(1, 1, "", size=(3.45, 2.5))  # two of them side by side in a report
    axis, rise, error = axes[0, 0], profile.rise, profile.stderr
    factor, unit = (sheet.per_rad_s, sheet.rate_unit) if profile.unit == "rad/s" else (1.0, profile.unit)
    values = profile.values * factor
    axis.plot(values, rise, color=style.COLOURS[0], marker=".", ms=4, lw=1.3, label="profile")
    if np.isfinite(error) and error > 0:
        x = np.linspace(values[0], values[-1], 200)
        parabola = ((x / factor - profile.value) / error) ** 2
        axis.plot(x, parabola, color=style.GREY, ls="--", lw=1.0, label="standard error")
    axis.axhline(profile.goal, color=style.CRITICAL, lw=0.9, label="level of the interval")
    for end in profile.interval:
        if np.isfinite(end):
            axis.axvline(end * factor, color=style.CRITICAL, lw=0.9, ls=":")
    axis.set_ylim(0, 1.15 * max(profile.goal, float(rise[np.isfinite(rise)].max(initial=0.0))))
    axis.set(xlabel=style.labelled(profile.name.replace("_", " "), unit), ylabel="rise of chi-squared")
    axis.legend(loc="upper center")
    return figure
