"""Small parts of the page: markup, buttons, lists and messages of one look."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from time import sleep
from typing import Any

import panel as pn
from bokeh.plotting import figure

from rotorfit.apps.app.words import on_the_page
from rotorfit.lab.data.findings import Finding
from rotorfit.show.report.html import Html, element, join

STYLE = files("rotorfit.apps.app").joinpath("page.css").read_text(encoding="utf-8")
"""Look of all markup."""
LONG_LABEL = "label { white-space: normal; } :host { align-self: end !important; }"
"""Style of fields beside each other: a label may take two lines, the boxes stand in one."""
WIDE = {"sizing_mode": "stretch_width"}
"""A part that takes the width of the page."""


def markup(*content: str, **look: Any) -> Any:
    """Text and markup as a part of the page."""
    return pn.pane.HTML(join(content), stylesheets=[STYLE], margin=(0, 10), **{**WIDE, **look})


def heading(text: str) -> Any:
    """Heading of a section."""
    return markup(element("h2", text))


def colour_key(words: str, colours: Mapping[str, str]) -> Any:
    """What the colours of figures mean, by name; of many, pointing at a reading says whose it is."""
    most_colours = 16  # names that a line explains. Chosen
    shown = colours if 1 < len(colours) <= most_colours else {}
    dots = [join([element("span", "●", style=f"color: {colour}"), f" {name}"]) for name, colour in shown.items()]
    said = join(filter(None, [words, *dots]), "  ")
    return markup(element("p", said, class_="faint")) if said else pn.Column()


def message(text: str, kind: str = "") -> Any:
    """A sentence that stands out: ``error``, ``warning``, ``good`` or neither."""
    return markup(element("div", on_the_page(text), class_=f"said {kind}".strip()))


def finding_words(finding: Finding) -> Html:
    """A finding with its severity in front; a button beside it stands for the words of the command line."""
    _, _, words = str(replace(finding, correction=None)).partition("] ")
    said = join([element("span", finding.severity, class_="kind"), ": ", on_the_page(words)])
    return element("div", said, class_=f"said {finding.severity}")


def button(label: str, act: Callable[[], object], *, main: bool = False, **options: Any) -> Any:
    """A button and what a click on it does."""

    def clicked(_: Any) -> None:
        # Seconds that a click waits for what was entered just before it: Panel takes entries in 0.05 s late
        entry_s = 0.3
        sleep(entry_s)
        act()

    made = pn.widgets.Button(name=label, button_type="primary" if main else "default", **options)
    made.on_click(clicked)
    return made


def shown_in(field: Any) -> str:
    """Text of a field on the page, which Panel may not have received yet."""
    models = [model for model, _ in field._models.values()]
    return str(models[0].value if models else field.value).strip()


def document(path: Path) -> Any:
    """A page of the folder within this one, where nothing in it can do anything."""
    text = path.read_text(encoding="utf-8", errors="replace")
    return markup(element("iframe", srcdoc=text, sandbox="", title=path.name))


def download(name: str, text: Callable[[], str]) -> Any:
    """A button that downloads a file, which is made when it is clicked."""

    def content() -> BytesIO:
        return BytesIO(text().encode())

    return pn.widgets.FileDownload(callback=content, filename=name, label=f"Download {name}", width=200)


def side_by_side(parts: Sequence[Any], least: int) -> Any:
    """Parts of equal width in as many columns as there is room for, each at least so many pixels wide."""
    columns = f"repeat(auto-fit, minmax(min(100%, {least}px), 1fr))"
    return pn.Column(*parts, styles={"display": "grid", "grid-template-columns": columns, "align-items": "end"}, **WIDE)


def figures_beside(figures: Sequence[Any]) -> Any:
    """Figures of Bokeh, two beside each other where there is room."""
    return side_by_side([pn.pane.Bokeh(figure, **WIDE) for figure in figures], least=480)


def folded(title: str, *parts: Any, shown: bool) -> Any:
    """Parts below a title that shows and hides them; in a column, as what has a display of its own would stay shown."""
    head = markup(element("h3", title))  # a title given as such is taken for markup
    return pn.Card(pn.Column(*parts, **WIDE), header=head, collapsed=not shown, **WIDE)


def bar(*parts: Any) -> Any:
    """Parts above the rest of the page, which scrolls below them and is not covered."""
    look = {"border-bottom": "1px solid #d5dbe1", "padding": f"4px {_MARGIN}", "flex": "none"}
    return pn.Column(*parts, styles=look, **WIDE)


def scrolled(*parts: Any) -> Any:
    """The rest of the page, one part below the other."""
    look = {"padding": f"0 {_MARGIN} 40px", "flex": "1 1 0", "min-height": "0"}
    return pn.Column(*parts, scroll="y-auto", styles=look, **WIDE)


def window(*parts: Any) -> Any:
    """Parts that share the height of the window."""
    return pn.Column(*parts, styles={"height": "100dvh", "display": "flex", "flex-direction": "column"}, **WIDE)


_MARGIN = "max(0px, calc(50% - 590px))"
"""Beside lines that are no longer than can be read."""


def in_a_row(*parts: Any) -> Any:
    """Parts side by side as far as the width allows; in a column, as a row is at least as wide as all of them."""
    look = {"display": "flex", "flex-flow": "row wrap", "align-items": "end", "gap": "4px"}
    return pn.Column(*parts, styles=look, **WIDE)


TOOLS = "pan,box_zoom,wheel_zoom,reset,save"
"""Tools of a figure that has no others."""


def framed(title: str, height: int, across: str, up: str, **options: Any) -> Any:
    """An empty figure as wide as its place, with labels of its axes."""
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
