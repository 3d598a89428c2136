"""Figures of a fit to zoom into and to point at: Bode, polar, residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.app.frames import framed
from rotorfit.plots.bode import broken_phase, panel_name
from rotorfit.plots.sweeps import SweepCurve, curves, joined
from rotorfit.units import RPM_PER_RAD_S

if TYPE_CHECKING:
    from rotorfit.fitting.result import FitResult

Draw = Callable[[Sequence[SweepCurve], str, str], Any]


def fit_figures(fit: FitResult, draw: Draw) -> list[Any]:
    """A figure of one kind for each pair of probe and force; none of a fit without turning forces."""
    try:
        _, found = curves(fit)
    except ValueError:  # of other tests there is nothing over frequency
        return []
    pairs = dict.fromkeys((curve.coordinate, curve.force_plane) for curve in joined(found))
    figures = []
    for probe, force in sorted(pairs):
        own = [curve for curve in joined(found) if (curve.coordinate, curve.force_plane) == (probe, force)]
        unit = "µrad/N" if fit.model.coordinates[probe].axis == "r" else "µm/N"
        figures.append(draw(own, panel_name(fit, probe, force), unit))
    return figures


def colours_of_conditions(fit: FitResult) -> dict[str, str]:
    """Colour of each condition of the rotor that the figures tell apart."""
    try:
        return {condition.name: condition.colour for condition in curves(fit)[0]}
    except ValueError:  # as above
        return {}


def bode(found: Sequence[SweepCurve], title: str, unit: str) -> Any:
    """Amplitude and phase of a response to a unit force: points measured, lines fitted, with their 95 % bands."""
    from bokeh.layouts import column

    top = framed(title, 260, "", unit, y_axis_type="log")
    bottom = framed("", 200, _FREQUENCY, "phase lead, °", x_range=top.x_range)
    bottom.y_range.start, bottom.y_range.end = -190, 190
    for curve in found:
        x, fine = curve.frequency * RPM_PER_RAD_S, curve.fine * RPM_PER_RAD_S
        size, (relative, turn) = 1e6 * np.abs(curve.fitted), curve.band
        reach, angle = np.exp(np.minimum(relative, 5.0)), broken_phase(curve.fitted)
        _band(top, fine, size / reach, size * reach, curve.condition.colour)
        _band(bottom, fine, angle - np.degrees(turn), angle + np.degrees(turn), curve.condition.colour)
        points = _measured(curve, x)
        for plot, name, fitted in ((top, "amplitude", size), (bottom, "phase", angle)):
            plot.line(fine, fitted, color=curve.condition.colour, line_width=1.4)
            drawn = plot.scatter("rpm", name, source=points, color=curve.condition.colour, size=3.5, alpha=0.6)
            _point_at(plot, drawn, unit)
    bottom.toolbar_location = None
    return column(top, bottom, sizing_mode="stretch_width")


def polar(found: Sequence[SweepCurve], title: str, unit: str) -> Any:
    """Response to a unit force in the complex plane."""
    plot = framed(title, 380, f"in phase, {unit}", f"quadrature, {unit}", match_aspect=True)
    for curve in found:
        fitted = 1e6 * curve.fitted
        plot.line(fitted.real, fitted.imag, color=curve.condition.colour, line_width=1.4)
        points = _measured(curve, curve.frequency * RPM_PER_RAD_S)
        drawn = plot.scatter("real", "imag", source=points, color=curve.condition.colour, size=3.5, alpha=0.6)
        _point_at(plot, drawn, unit)
    return plot


def residuals(found: Sequence[SweepCurve], title: str, unit: str) -> Any:
    """Residuals over their noise: dots real, crosses imaginary; noise alone leaves 95 % in the band."""
    from bokeh.models import BoxAnnotation

    plot = framed(title, 240, _FREQUENCY, "residual / noise")
    plot.add_layout(BoxAnnotation(bottom=-2, top=2, fill_color="#d5dbe1", fill_alpha=0.5, level="underlay"))
    for curve in found:
        points = _measured(curve, curve.frequency * RPM_PER_RAD_S)
        look = {"source": points, "color": curve.condition.colour, "alpha": 0.7}
        drawn = plot.scatter("rpm", "missed_real", size=3.5, **look)
        plot.scatter("rpm", "missed_imag", marker="x", size=5, **look)
        _point_at(plot, drawn, unit)
    return plot


_FREQUENCY = "frequency, rpm (backward < 0 < forward)"


def _measured(curve: SweepCurve, rpm: Any) -> Any:
    from bokeh.models import ColumnDataSource

    value = 1e6 * curve.measured
    return ColumnDataSource(
        {
            "rpm": rpm,
            "amplitude": np.abs(value),
            "phase": np.degrees(np.angle(value)),
            "real": value.real,
            "imag": value.imag,
            "missed_real": curve.whitened.real,
            "missed_imag": curve.whitened.imag,
            "condition": [curve.condition.name] * rpm.size,
        }
    )


def _point_at(plot: Any, drawn: Any, unit: str) -> None:
    """Text of a point under the mouse."""
    from bokeh.models import HoverTool

    tips = [("", "@condition"), ("frequency", "@rpm{0.0} rpm"), ("amplitude", f"@amplitude{{0.0000}} {unit}"),
            ("phase lead", "@phase{0.0}°"), ("residual / noise", "@missed_real{0.0} @missed_imag{+0.0}j")]  # fmt: skip
    plot.add_tools(HoverTool(tooltips=tips, renderers=[drawn], visible=False))


def _band(plot: Any, x: Any, low: Any, high: Any, colour: str) -> None:
    plot.varea(x, low, high, color=colour, alpha=0.2)
