"""Figures that results return, such as ``fit.plot.bode()``, shown by the gallery where they end a block of code."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

LAST_VALUE = "___"
"""Where sphinx-gallery keeps the value of a block's last expression."""


def scrape(block: object, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save the figure that is the value of a block, pyplot's own are not meant; see sphinx-gallery's scrapers."""
    names = block_vars["example_globals"]
    figure = names.get(LAST_VALUE)
    if not isinstance(figure, Figure):
        return ""
    names[LAST_VALUE] = None  # shown once
    path = next(block_vars["image_path_iterator"])
    figure.savefig(path, dpi=110)
    title = figure.get_suptitle() or ", ".join(axis.get_title() for axis in figure.axes if axis.get_title())
    return str(figure_rst([path], gallery_conf["src_dir"], fig_titles=title or "figure of the result"))


def _get_sg_image_scraper() -> Callable[..., str]:
    return scrape
