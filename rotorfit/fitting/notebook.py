"""A result in a notebook: tables, made of escaped text."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from rotorfit.fitting.digits import with_error
from rotorfit.fitting.summary import in_order

if TYPE_CHECKING:
    from rotorfit.fitting.quantities import FittedParameter
    from rotorfit.fitting.result import FitResult

_HEAD = ("parameter", "value", "standard error", "unit", "meaning")


def fit_html(fit: FitResult) -> str:
    """Parameters as a table, the rest of the summary below it."""
    rows = "".join(_row(p) for p in in_order(fit.params.values()))
    head = "".join(f"<th>{name}</th>" for name in _HEAD)
    text = fit.summary().split("\n\n")
    first, last = text[0], "\n".join(text[2:])
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
    return f"<p>{escape(first).replace(chr(10), '<br>')}</p>{table}{text_html(last)}"


def _row(p: FittedParameter) -> str:
    if not p.vary:
        value, error = f"{p.value:.7g}", "known"
    elif not p.resolved:
        value, error = "not determined", ""
    else:
        value, error = with_error(p.value, p.stderr)
    unit = "" if p.unit == "1" else p.unit
    return "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in (p.name, value, error, unit, p.meaning)) + "</tr>"


def text_html(text: str) -> str:
    """Text whose columns stand under one another."""
    return f"<pre>{escape(text)}</pre>"
