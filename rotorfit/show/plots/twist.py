"""The paper's Fig. 38: overall torsional amplitude and spectra of the twist against the perturbation frequency."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from matplotlib.figure import Figure

from rotorfit.lab.recordings.views import Cascade
from rotorfit.show.plots import style
from rotorfit.show.plots.recordings import draw_order_line

_ORDERS = {"w − Ω": (1, -1), "w − 2Ω": (1, -2), "2(w − Ω)": (2, -2), "1x": (0, 1), "2x": (0, 2)}
"""Combination lines of the twist: multiples of w and of Ω, the rotative speed."""


@style.on_sheet
def plot_twist(
    view: Cascade,
    name: str,
    limit: float | None = None,
    marks: Mapping[str, float] = MappingProxyType({}),
    *,
    sheet: style.Sheet,
) -> Figure:
    """Overall amplitude of the twist above, its spectra with order lines below.

    ``marks``: frequencies to mark, rad/s, by name, as the torsional natural frequency and its half (Fig. 38).
    """
    scale, label = sheet.positions(view.over)
    position = view.position * scale
    lines = {key: np.abs(m * view.perturbation + n * view.shaft) / (2 * np.pi) for key, (m, n) in _ORDERS.items()}
    highest = max((float(np.nanmax(at)) for at in lines.values() if np.isfinite(at).any()), default=np.inf)
    edge = min(1.15 * highest, float(view.frequency[-1])) if limit is None else limit
    figure, axes = sheet.grid(2, 1, style.literal(f"{name}: twist"), size=(style.PAGE[0], 3.8))
    overall, cascade = axes[:, 0]
    size = np.asarray(view.overall)
    factor, unit = style.prefix(size, "rad")
    order = np.argsort(position)
    overall.plot(position[order], size[order] * factor, color=style.COLOURS[0], lw=1.2)
    overall.set_ylabel(f"overall amplitude, {unit} 0-pk")
    overall.set_ylim(bottom=0)
    overall.set_xlabel(label)
    # The square root of each spectrum is shifted up: combination lines differ by powers of ten.
    inside = view.frequency <= edge
    root = np.sqrt(view.amplitude[:, inside])
    spacing = float(np.ptp(position)) / max(position.size - 1, 1) or 1.0
    spacings = 6.0  # spacings that the largest line of the cascade reaches up
    height = spacings * spacing / float(root.max(initial=1e-12))
    style.draw_cascade(cascade, view.frequency[inside], root * height, position)
    cascade.set(xlim=(0, edge), ylim=(position.min() - spacing, position.max() + (spacings + 1) * spacing))
    cascade.set_title("height: square root of the amplitude", fontsize=style.SMALL_TYPE, loc="right")
    for key, at in lines.items():
        draw_order_line(cascade, key, np.where(at <= edge, at, np.nan), position, edge)
    for key, mark in marks.items():
        cascade.axvline(mark / (2 * np.pi), color=style.INK, lw=0.9, ls=":", zorder=998)
        look = {"fontsize": 8, "ha": "center", "va": "bottom", "xycoords": cascade.get_xaxis_transform()}
        cascade.annotate(style.literal(key), (mark / (2 * np.pi), 1.0), **look)
    cascade.set_xlabel("frequency, Hz")
    cascade.set_ylabel(label)
    return figure
