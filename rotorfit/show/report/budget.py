"""Sections of the report on what errors are made of: the budget, and the causes beside the model."""

from __future__ import annotations

import math

from rotorfit.base.digits import two_digits
from rotorfit.models.parameters import bare_name
from rotorfit.show.report.html import Html, element, table
from rotorfit.show.report.material import ReportInput
from rotorfit.show.report.numbers import plain, with_error
from rotorfit.show.report.parts import note, section, symbol, unit_shown


def budget_section(material: ReportInput) -> Html:
    """Standard error of every result by its shares, and by the weightiest causes on trust."""
    fit = material.fit
    if not fit.causes.rows:
        return Html("")
    budget = fit.budget()
    causes = budget.main_causes
    rows = []
    for row in budget.rows:
        name = symbol(row.name, fit.model) if bare_name(row.name) in fit.model.parameter_names else row.name
        shares = (row.noise, row.bounded, row.trust, *(abs(row.on_trust.get(cause, 0.0)) for cause in causes))
        value, error = with_error(row.value, row.stderr)
        rows.append([name, value, error, *(plain(share, 2) for share in shares), unit_shown(row.unit)])
    head = ["", "value", "standard error", "noise", "bounded", "on trust", *causes, "unit"]
    words = (
        "Shares add up as squares. Noise: by the readings (GUM type A). Bounded: causes that had to be found from the "
        "data. On trust: sizes that causes are given before the data (type B), which more readings do not lower. The "
        "coverage factor of 95 % is 1.96, or Student's t where few readings tell the noise."
    )
    return section(
        "Uncertainty budget",
        table(head, rows, numeric=range(1, len(head) - 1), whole=(len(head) - 1,)),
        note(words),
        folded=True,
    )


def causes_section(material: ReportInput) -> Html:
    """Causes beside the model with their sizes, and what the data tell of each."""
    causes = material.fit.causes
    if not causes.rows:
        return Html("")
    rows = []
    for row in causes:
        z = "" if math.isnan(row.z) else plain(row.z, 2)
        found = " ± ".join((two_digits(row.value), two_digits(row.stderr)))
        told = f"{100 * row.determined:.0f} %"
        rows.append(
            [
                element("code", row.name),
                row.meaning,
                two_digits(row.size),
                found,
                unit_shown(row.unit),
                told,
                z,
                row.reason,
            ]
        )
    head = ["cause", "meaning", "size", "found", "unit", "told by the data", "z", "reason"]
    return section(
        "Causes beside the model",
        table(head, rows, numeric=(2, 3, 5, 6), whole=(4,)),
        note(
            "Each is solved with the fitted values, its size a standard uncertainty before the data. z is its score "
            "against none; above 4 the data show it."
        ),
        folded=True,
    )
