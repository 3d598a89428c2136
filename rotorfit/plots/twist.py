"""The paper's Fig. 38: overall torsional amplitude and spectra of the twist against the perturbation frequency."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from rotorfit.models.array_types import Float
from rotorfit.plots.style import COLOURS, PAGE, SMALL_TYPE, draw_cascade, grid, literal, looked, positions, prefix
from rotorfit.recordings.views import Cascade

_ORDERS = {"w − Ω": (1, -1), "w − 2Ω": (1, -2), "2(w − Ω)": (2, -2), "1x": (0, 1), "2x": (0, 2)}
"""Combination lines of the twist: multiples of w and of Ω, the rotative speed."""


@looked
def plot_twist(
    view: Cascade, name: str, limit: float | None = None, marks: Mapping[str, float] = MappingProxyType({})
) -> Figure:
    """Overall amplitude of the twist above, its spectra with order lines below.

    ``marks``: frequencies to mark, rad/s, by name, as the torsional natural frequency and its half (Fig. 38).
    """
    scale, label = positions(view.over)
    position = view.position * scale
    lines = {key: np.abs(m * view.perturbation + n * view.shaft) / (2 * np.pi) for key, (m, n) in _ORDERS.items()}
    highest = max((float(np.nanmax(at)) for at in lines.values() if np.isfinite(at).any()), default=np.inf)
    edge = min(1.15 * highest, float(view.frequency[-1])) if limit is None else limit
    figure, axes = grid(2, 1, literal(f"{name}: twist"), size=(PAGE[0], 3.8))
    overall, cascade = axes[:, 0]
    size = np.asarray(view.overall)
    factor, unit = prefix(size, "rad")
    order = np.argsort(position)
    overall.plot(position[order], size[order] * factor, color=COLOURS[0], lw=1.2)
    overall.set_ylabel(f"overall amplitude, {unit} 0-pk")
    overall.set_ylim(bottom=0)
    overall.set_xlabel(label)
    _cascade(cascade, view, position, edge)
    for key, at in lines.items():
        _order_line(cascade, key, np.where(at <= edge, at, np.nan)[order], position[order])
    for key, mark in marks.items():
        cascade.axvline(mark / (2 * np.pi), color="black", lw=0.9, ls=":", zorder=998)
        style = {"fontsize": 8, "ha": "center", "va": "bottom", "xycoords": cascade.get_xaxis_transform()}
        cascade.annotate(literal(key), (mark / (2 * np.pi), 1.0), **style)
    cascade.set_xlabel("frequency, Hz")
    cascade.set_ylabel(label)
    return figure


def _cascade(axis: Any, view: Cascade, position: Float, edge: float) -> None:
    """One spectrum a line, the square root of its amplitude shifted up: combination lines differ by powers of ten."""
    inside = view.frequency <= edge
    root = np.sqrt(view.amplitude[:, inside])
    spacing = float(np.ptp(position)) / max(position.size - 1, 1) or 1.0
    spacings = 6.0  # spacings that the largest line of the cascade reaches up
    height = spacings * spacing / float(root.max(initial=1e-12))
    draw_cascade(axis, view.frequency[inside], root * height, position)
    axis.set_xlim(0, edge)
    axis.set_ylim(position.min() - spacing, position.max() + (spacings + 1) * spacing)
    axis.set_title("height: square root of the amplitude", fontsize=SMALL_TYPE, loc="right")


def _order_line(axis: Any, label: str, at: Float, position: Float) -> None:
    shown = np.flatnonzero(np.isfinite(at))
    if not shown.size:
        return
    colour = COLOURS[1] if "w" in label else "0.35"
    axis.plot(at, position, color=colour, lw=0.8, ls="--", alpha=0.7, zorder=998)
    place = (float(at[shown[-1]]), float(position[shown[-1]]))
    style = {"fontsize": 8, "color": colour, "ha": "center", "zorder": 999}
    axis.annotate(label, place, (0, 4), textcoords="offset points", **style)
