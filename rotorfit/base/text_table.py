"""Tables of text whose columns stay aligned, however long a name is."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from pandas import DataFrame


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


class Table(NamedTuple):
    """Rows of a result's print, the head first, and their columns as of :func:`text_table`."""

    rows: Sequence[Sequence[str | Wide]]
    columns: str

    def __str__(self) -> str:
        return "\n".join(text_table(self.rows, self.columns))

    @property
    def frame(self) -> DataFrame:
        """The cells as they are printed."""
        from pandas import DataFrame

        filled = [
            [
                text
                for cell in row
                for text in ((cell.text, *[""] * (cell.columns - 1)) if isinstance(cell, Wide) else (cell,))
            ]
            for row in self.rows
        ]
        width = max(map(len, filled))
        head, *body = ([*row, *[""] * (width - len(row))] for row in filled)
        return DataFrame(body, columns=head)


class Tabled(Printed):
    """A result whose print holds tables: a notebook shows them as such, and papers and web pages take them."""

    @abstractmethod
    def parts(self) -> Sequence[str | Table]:
        """What is printed: sentences and tables, one below the other."""

    def __str__(self) -> str:
        return "\n".join(map(str, self.parts()))

    def _repr_html_(self) -> str:
        from pandas import option_context

        with option_context("display.max_colwidth", None):
            parts = [
                part.frame.to_html(index=False, border=0) if isinstance(part, Table) else text_html(part)
                for part in self.parts()
            ]
        return "".join(parts)

    def to_latex(self) -> str:
        """The printed tables for LaTeX, as pandas writes them, which needs Jinja2 (``rotorfit[tables]``)."""
        tables = [p.frame.to_latex(index=False, escape=True) for p in self.parts() if isinstance(p, Table)]
        return "\n".join(tables).replace(" +- ", r" $\pm$ ")

    def to_markdown(self) -> str:
        """The same for Markdown, which needs tabulate (``rotorfit[tables]``)."""
        tables = [p.frame.to_markdown(index=False, disable_numparse=True) for p in self.parts() if isinstance(p, Table)]
        return "\n\n".join(tables)


def text_html(text: str) -> str:
    """Text for a notebook, its columns under one another."""
    return f"<pre>{escape(text)}</pre>"
