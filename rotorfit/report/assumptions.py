"""Section of the report on what its numbers rest on: terms left out of the model and values taken as known."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rotorfit.report.html import Html, table
from rotorfit.report.parts import note, section

if TYPE_CHECKING:
    from rotorfit.report.material import ReportInput


def assumptions_section(material: ReportInput) -> Html:
    """Score tests of what the model leaves out, and the shift of each result."""
    found = material.fit.assumed
    if not found.entries:
        return Html("")
    head, *rows = found.rows()
    return section(
        "What these numbers rest on",
        table(head, rows, numeric=range(1, len(head))),
        *map(note, found.words),
        folded=True,
    )
