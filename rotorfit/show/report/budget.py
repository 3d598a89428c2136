"""Sections of the report on what errors are made of: the budget, and the causes beside the model."""

from __future__ import annotations

import math

from rotorfit.base.digits import two_digits
from rotorfit.identify.fitting.summary import correction_names
from rotorfit.models.parameters import bare_name
from rotorfit.show.report.figures import embedded
from rotorfit.show.report.html import Html, element, paragraph, table
from rotorfit.show.report.material import ReportInput
from rotorfit.show.report.numbers import plain, with_error
from rotorfit.show.report.parts import note, section, symbol, unit_shown

_LEAST = 0.01
"""Share of the variance of a result from which an entry is listed: a tenth of the error. Chosen."""


def budget_section(material: ReportInput) -> Html:
    """Standard error of every result by its shares, its entries cause by cause, correlations of the results."""
    fit = material.fit
    if not fit.causes.rows:
        return Html("")
    budget = fit.budget()
    rows, entries, names = [], [], []
    for row in budget.rows:
        name = symbol(row.name, fit.model) if bare_name(row.name) in fit.model.parameter_names else row.name
        names.append(name)
        value, error = with_error(row.value, row.stderr)
        shares = (plain(share, 2) for share in (row.noise, row.bounded, row.trust))
        degrees = "∞" if math.isinf(row.freedom) else plain(row.freedom, 2)
        rows.append([name, value, error, *shares, plain(row.coverage, 3), degrees, unit_shown(row.unit)])
        for cause, share in sorted(row.on_trust.items(), key=lambda entry: -abs(entry[1])):
            if share**2 >= _LEAST * row.stderr**2:
                size = two_digits(fit.causes[cause].size)
                entries.append([name, element("code", cause), size, plain(row.slopes[cause], 3), plain(abs(share), 2)])
    head = ["", "value", "standard error", "noise", "bounded", "on trust", "k", "degrees of freedom", "unit"]
    words = (
        "Shares add up as squares. Noise: by the readings (GUM type A). Bounded: causes that had to be found from the "
        "data. On trust: sizes that causes are given before the data (type B), which more readings do not lower. "
        "k is the coverage factor of 95 %: 1.96, or that of Student's t by the degrees of freedom where few readings "
        "tell the noise. What rests on a cause that is never negative lengthens an interval to one side only."
    )
    of_entries = (
        "Entries on trust that are at least a tenth of an error. Size: standard uncertainty of the cause before the "
        "data. Slope: change of the result by a unit of it, the fitted values following."
    )
    corrections = correction_names(fit.model)  # many, which would make the table too wide
    kept = [place for place, row in enumerate(budget.rows) if bare_name(row.name) not in corrections]
    correlated = [[names[i], *(f"{budget.correlation[i, j]:+.2f}" for j in kept)] for i in kept]
    words_of = "Value, error and the shares of its variance of each result."
    drawn = Html("")
    if budget.rows and material.figure_format != "none":  # else what draws is not even loaded
        drawn = embedded(material, "budget", fit.plot.budget, words_of, caption="")
    details = (
        table(head, rows, numeric=range(1, len(head) - 1), whole=(len(head) - 1,)),
        note(words),
        table(["", "cause", "size", "slope", "share"], entries, numeric=(2, 3, 4)),
        note(of_entries),
        paragraph("Correlations of the results, causes included:"),
        table(["", *(names[i] for i in kept)], correlated, numeric=range(1, len(kept) + 1)),
    )
    more = element("details", element("summary", "Shares as numbers, entries cause by cause, correlations"), *details)
    return section("Error budget", drawn, more)


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
