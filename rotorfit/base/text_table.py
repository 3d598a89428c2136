"""Tables of text whose columns stay aligned, however long a name is."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import NamedTuple


class Printed:
    """A result that is printed as text: a notebook shows that text, an interactive session its first line."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {' '.join(str(self).partition(chr(10))[0].split())}>"

    def _repr_html_(self) -> str:
        return text_html(str(self))


class Wide(NamedTuple):
    """A cell that reaches over several columns, aligned as the first of them; a remark begins at its left."""

    text: str  # what it says
    columns: int  # how many it reaches over
    remark: bool = False  # whether it begins at the left whatever the alignment, and makes no column wider


def text_table(rows: Iterable[Sequence[str | Wide]], columns: str) -> list[str]:
    """Rows, the head first, as lines; ``columns`` as in ``"<22 >14 <1"``: alignment and least width, grown by its
    longest cell."""
    specs = [(spec[0], int(spec[1:])) for spec in columns.split()]
    table = [[cell if isinstance(cell, Wide) else Wide(cell, 1) for cell in row] for row in rows]
    widths = [width for _, width in specs]
    for row in table:
        at = 0
        for cell in row:
            at += cell.columns
            if not cell.remark:
                before = sum(widths[at - cell.columns : at - 1])
                widths[at - 1] = max(widths[at - 1], len(cell.text) + (specs[at - cell.columns][0] == ">") - before)
    lines = []
    for row in table:
        line, at = "", 0
        for cell in row:
            align = "<" if cell.remark else specs[at][0]
            gap = "  " if at and align == "<" else ""
            line += f"{gap}{cell.text:{align}{sum(widths[at : at + cell.columns])}}"
            at += cell.columns
        lines.append(line.rstrip())
    return lines


def text_html(text: str) -> str:
    """Text for a notebook, its columns under one another."""
    return f"<pre>{escape(text)}</pre>"
