"""Section of the report on what its numbers rest on: terms left out of the model and values taken as known."""

from __future__ import annotations

from rotorfit.report.html import Html, table
from rotorfit.report.material import ReportInput
from rotorfit.report.parts import note, section


def assumptions_section(material: ReportInput) -> Html:
    """Score tests of what the model leaves out, and the shift of each result."""
    found = material.fit.assumed
    if not found.entries:
        return Html("")
    least = 0.1  # of a standard error: less is seen in no digit that is printed
    head, *rows = found.rows(least)
    lighter = len(found.entries) - len(rows)
    rest = f"{lighter} more of less than a tenth of a standard error: see fit.assumptions()."
    return section(
        "What these numbers rest on",
        table(head, rows, numeric=range(1, len(head))),
        *map(note, (*([rest] if lighter else []), *found.words)),
        folded=True,
    )
