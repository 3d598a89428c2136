"""Frames of figures: the tools and the look that all of them share."""

from __future__ import annotations

from typing import Any

TOOLS = "pan,box_zoom,wheel_zoom,reset,save"
"""Tools of a figure that has no others."""


def framed(title: str, height: int, across: str, up: str, **options: Any) -> Any:
    """An empty figure as wide as its place, with labels of its axes."""
    from bokeh.plotting import figure

    if "tools" not in options:
        options |= {"tools": TOOLS, "active_drag": "box_zoom"}
    plot = figure(
        title=title or None, height=height, sizing_mode="stretch_width", x_axis_label=across or None,
        y_axis_label=up, **options,
    )  # fmt: skip
    plot.toolbar.logo = None
    return plot


def small_legend(plot: Any) -> None:
    """Make the legend of a figure small, and such that it does not hide the curves."""
    plot.legend.label_text_font_size = "8pt"
    plot.legend.background_fill_alpha = 0.6
    plot.legend.padding, plot.legend.spacing = 3, 0
