"""HTML written so that text cannot become markup: every string is escaped unless it was made here."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape

from rotorfit.base.file_reading import shown_lines

_VOID = ("img", "meta", "br", "wbr")


class Html(str):
    """Finished markup. Plain strings are text and get escaped."""

    __slots__ = ()


def element(tag: str, /, *children: str, **attributes: str) -> Html:
    """An element of a page."""
    written = "".join(f' {key.rstrip("_").replace("_", "-")}="{_text(value)}"' for key, value in attributes.items())
    if tag in _VOID:
        return Html(f"<{tag}{written}>")
    return Html(f"<{tag}{written}>{join(children)}</{tag}>")


def join(children: Iterable[str], separator: str = "") -> Html:
    """Text and markup in a row."""
    return Html(separator.join(child if isinstance(child, Html) else _text(child) for child in children))


def _text(text: str) -> str:
    return escape(shown_lines(text))


def paragraph(*children: str) -> Html:
    """A paragraph."""
    return element("p", *children)


def bullets(items: Iterable[str], **attributes: str) -> Html:
    """An unordered list."""
    return element("ul", *(element("li", item) for item in items), **attributes)


def table(
    head: Sequence[str], rows: Iterable[Sequence[str]], numeric: Sequence[int] = (), whole: Sequence[int] = ()
) -> Html:
    """A table; empty columns are left out."""
    body = [list(row) for row in rows]
    kept = [i for i in range(len(head)) if i == 0 or any(row[i] for row in body)]

    def cell(kind: str, row: Sequence[str], i: int) -> Html:
        style = "number" if i in numeric else "whole" if i in whole else ""
        return element(kind, row[i], class_=style) if style else element(kind, row[i])

    short_rows = 8  # rows of a table that is not broken between pages
    return element(
        "div",
        element(
            "table",
            element("thead", element("tr", *(cell("th", head, i) for i in kept))),
            element("tbody", *(element("tr", *(cell("td", row, i) for i in kept)) for row in body)),
        ),
        class_="table short" if len(body) <= short_rows else "table",
    )


def picture(png: bytes, words: str, inches: float, caption: str = "") -> Html:
    """A PNG file with a caption, embedded, so large that its type of 8 points has 14 pixels."""
    page = 14 / 8 * 72  # pixels of an inch
    data = base64.b64encode(png).decode("ascii")
    image = element("img", src=f"data:image/png;base64,{data}", alt=words, width=f"{page * inches:.0f}")
    return element("figure", image, *([element("figcaption", caption)] if caption else []))
