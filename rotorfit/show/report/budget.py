"""Sections of the report on where uncertainty comes from: the calibration, terms left out, values taken as known."""

from __future__ import annotations

import math

from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.identify.uncertainty.budget import Share
from rotorfit.models.parameters import bare_name
from rotorfit.show.report.html import Html, element, join, table
from rotorfit.show.report.material import ReportInput
from rotorfit.show.report.numbers import plain, with_error
from rotorfit.show.report.parts import note, section, symbol, unit_shown


def budget_section(material: ReportInput) -> Html:
    """Standard uncertainty of every parameter by source, and what the data say of the calibration."""
    from rotorfit.identify.uncertainty.budget import Budget

    fit = material.fit
    if fit.settings.calibration is None:
        return Html("")
    budget = Budget(fit, fit.settings.calibration)
    shares = [budget.share(name) for name in fit.problem.space.names]
    known = [share for share in shares if math.isfinite(share.combined)]
    rows = [_row(symbol(share.name, fit.model), share) for share in known]
    if fit.model.speed_dependent and len(fit.problem.space.index) == 1:
        onset = budget.threshold_speed()
        rows += [_row("threshold speed", onset.times(RPM_PER_RAD_S, "rpm"))] if math.isfinite(onset.combined) else []
    sources = list(shares[0].sources)
    head = ["", "combined", "random", "systematic", *sources, "unit"]
    words = (
        "Standard uncertainties. Random: from the noise of the readings (GUM type A). Systematic: from the calibration "
        "and other knowledge from before (type B), source by source. More readings with the same probes lower the "
        "random part only."
    )
    return section(
        "Uncertainty budget",
        table(head, rows, numeric=range(1, len(head) - 1), whole=(len(head) - 1,)),
        note(words),
        *_calibration(material),
        folded=True,
    )


def _row(name: str, share: Share) -> list[str]:
    sources = [plain(part, 2) if part else "" for part in share.notable.values()]
    parts = (share.combined, share.random, share.systematic)
    return [name, *(plain(part, 2) for part in parts), *sources, unit_shown(share.unit)]


def _calibration(material: ReportInput) -> list[Html]:
    """Errors of calibration as assumed and as found."""
    from rotorfit.identify.fitting.assumptions.calibration import NUISANCE_KINDS

    fit = material.fit
    assumed = {prior.entry: float(prior.distribution.std()) for prior in fit.problem.priors}
    rows = []
    for entry, name in enumerate(fit.var_names):
        kind = bare_name(name)
        if kind not in NUISANCE_KINDS or entry not in assumed:
            continue
        p = fit.params[name]
        factor, unit = (180 / math.pi, "°") if p.unit == "rad" else (100.0, "%")
        found = " ± ".join(with_error(factor * p.value, factor * p.stderr))
        rows.append(
            [element("code", name), f"0 ± {plain(factor * assumed[entry], 2)}", found, unit, NUISANCE_KINDS[kind][1]]
        )
    words = (
        "An error that the data leave as large as it was assumed is one that they do not show: only a better "
        "calibration makes it smaller."
    )
    head = ["error", "assumed", "found", "unit", "meaning"]
    return [join([element("h3", "Calibration"), table(head, rows, numeric=(1, 2)), note(words)])]


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
