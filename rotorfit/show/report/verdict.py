"""First screen of the report: a verdict, checks, five numbers, what limits them, two figures; then what to know."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.identify.fitting.headline import Check, Headline, KeyNumber, headline, largest_on_trust, leads_of
from rotorfit.identify.fitting.notices import notices_of
from rotorfit.identify.fitting.onset import onset_note
from rotorfit.identify.fitting.quantities import Quantity, Shown
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.data.findings import Finding, attributed, errors_in
from rotorfit.show.plots.figure_table import first_figures
from rotorfit.show.report import parts
from rotorfit.show.report.figures import embedded
from rotorfit.show.report.html import Html, bullets, element, join, table
from rotorfit.show.report.material import ReportInput
from rotorfit.show.report.numbers import interval, plain, speeds_in_words, typeset, with_error

_LONG = 15
"""Letters of a number with its error that leave a card no room for the unit beside it."""
_SHARES = (
    ("noise", "noise"),
    ("bounded", "bounded by these data"),
    ("trust", "on trust, which these data cannot check (shares of the variance)"),
)
"""Shares of an error: class of their part of a bar, and words."""


def verdict_section(material: ReportInput) -> Html:
    """Verdict, checks, five numbers with their shares, what limits them, two figures."""
    head = headline_of(material)
    content = [element("h2", "Verdict", class_="unseen"), _sentence(head)]
    content.append(element("p", *join_spaced(map(check_of, head.checks)), class_="checks"))
    errors = [f"error in the data: {words}" for words in data_errors(material)]
    if errors:
        content.append(bullets((parts.sentence(words) for words in errors), class_="warnings"))
    if head.numbers:
        content.append(element("div", *(_card(head, number) for number in head.numbers), class_="cards"))
        if any(number.error is not None for number in head.numbers):
            key = (join([element("i", class_=kind), words], " ") for kind, words in _SHARES)
            content.append(element("p", *(element("span", one) for one in key), class_="key"))
    if head.limit is not None:
        what = element("b", "What limits these numbers:")
        remedy = f"{head.limit.cause}. {parts.sentence(head.limit.remedy).removesuffix('.')}: {head.limit.effect}."
        content.append(element("p", join([what, _set(remedy)], " "), class_="limit"))
    figures = [_figure(material, name, title) for name, title in first_figures(material.fit, good=head.good)]
    if any(figures):
        content.append(element("div", *figures, class_="pair"))
    return element("section", *content, id="verdict", class_="first" if head.good else "first not-good")


def notes_section(material: ReportInput) -> Html:
    """Warnings and caveats; nothing where there are none."""
    fit = material.fit
    of_data = [found.words for found in _of_data(material) if found.severity == "warning"]
    warnings = list(dict.fromkeys(f"warning of the data: {words}" for words in of_data))
    own = notices_of(fit)
    warnings += [one.message for one in own if one.severity != "note"]
    if fit.identifiability.unresolved:
        warnings.append("not determined by these data: " + ", ".join(fit.identifiability.unresolved))
    if material.posterior is not None and not material.posterior.converged:
        warnings.append(f"posterior: {material.posterior.message}")
    caveats = [one.message for one in own if one.severity == "note" and one.origin in ("fit", "model")]
    content = [bullets((parts.sentence(words) for words in warnings), class_="warnings")] if warnings else []
    content += [bullets((parts.sentence(words) for words in caveats), class_="note")] if caveats else []
    return element("section", element("h2", "What to know", class_="unseen"), *content) if content else Html("")


def byline_of(fit: FitResult) -> str:
    """The model and its data, in a line."""
    tests = fit.experiments
    runs = sum(len(test.runs) for test in tests)
    speeds = [f"{speeds_in_words(fit.speeds)}"] if fit.speeds.size else []
    readings = f"{sum(len(test) for test in tests)} readings in {runs} {'run' if runs == 1 else 'runs'}"
    return " · ".join([fit.model.name, *speeds, readings])


def headline_of(material: ReportInput) -> Headline:
    """The first screen; errors of the data are those of a refined model's fit before, too."""
    first = material.fit if material.refinement is None else material.refinement.candidates[0]
    return headline(material.fit, (*first.findings, *_of_data(material)))


def data_errors(material: ReportInput) -> tuple[str, ...]:
    """Errors of the data, those that explain the misfit first; of a refined model those of the fit before."""
    first = material.fit if material.refinement is None else material.refinement.candidates[0]
    return errors_in((*first.findings, *_of_data(material)))


def _of_data(material: ReportInput) -> list[Finding]:
    """What the check of the data found, errors first."""
    return attributed(material.findings, [test.source or test.title for test in material.fit.experiments])


def join_spaced(pieces: Iterable[Html]) -> list[Html]:
    """Pieces that a line may break between."""
    return [piece for one in pieces for piece in (one, Html(" "))]


def _sentence(head: Headline) -> Html:
    """The verdict, its number bold where nothing speaks against it."""
    words = _set(head.meaning if head.good and head.meaning else head.verdict)
    number = next((_number(n) for n in head.numbers if n.known and _number(n) in words), "")
    if not (number and head.good):
        return element("p", words, class_="headline")
    before, _, after = words.partition(number)
    return element("p", join([before, element("b", number), after]), class_="headline")


def _set(words: str) -> str:
    """Printed words as a page sets them: no line break parts a value from its error and unit."""
    text = re.sub(r" \+- ([\d.]+)( (?:rpm|kg|N))?", lambda found: f"\u00a0±\u00a0{found[1]}{_hard(found[2])}", words)
    return re.sub(r"(\d) %", "\\1\u00a0%", text)


def _hard(words: str | None) -> str:
    return (words or "").replace(" ", "\u00a0")


def _number(number: KeyNumber) -> str:
    shown = number.shown
    unit = f" {shown.unit}" if shown.unit == "rpm" else ""
    return _set(f"{shown.number}{unit}")


def check_of(check: Check) -> Html:
    """A tick, or a sign in amber; a second sign beside the colour."""
    said = element(
        "span", join([" ".join(("✓" if check.good else "▲", check.words))]), class_="good" if check.good else "bad"
    )
    return join([said, _set(f"({check.more})")], " ") if check.more else said


def _card(head: Headline, number: KeyNumber) -> Html:
    """A number with its error, interval and the shares of the error."""
    name = _name_of(number)
    shown = number.shown
    if not number.known:
        why = element("div", _why(head.fit, number), class_="more")
        return element(
            "div",
            element("div", name, class_="name"),
            element("div", shown.value, class_="value"),
            why,
            class_="card bad",
        )
    lines = []
    if number.error is not None:
        bar = [
            element("i", class_=kind, style=f"width:{100 * share:.1f}%")
            for (kind, _), share in zip(_SHARES, number.shares, strict=True)
            if share > 0.002
        ]
        lines.append(element("div", *bar, class_="bar"))
        cause = largest_on_trust(head.fit, number.error)
        lines += [element("div", f"largest on trust: {_set(cause)}", class_="more rests")] if cause else []
    named = number.quantity.unit == "1" and shown.unit != "%"  # the name says the unit
    return card(name, replace(shown, unit="") if named else shown, lines)


def card(name: str, shown: Shown, lines: Sequence[Html]) -> Html:
    """A number with its error and interval, and further lines."""
    error = f"\u00a0±\u00a0{typeset(shown.error)}" if shown.error.strip("-") else ""
    unit = element("span", parts.unit_shown(shown.unit), class_="unit") if shown.unit else Html("")
    gap = " " if len(shown.number) > _LONG else "\u00a0"
    number = join([element("b", typeset(shown.value)), error])
    value = element("div", number, *([gap, unit] if shown.unit else []), class_="value")
    ends = f"95 %: {typeset(shown.low)} to {typeset(shown.high)}" if shown.low else ""
    between = [element("div", ends, class_="more ends")] if ends else []
    return element("div", element("div", name, class_="name"), value, *between, *lines, class_="card")


def _name_of(number: KeyNumber) -> str:
    """Name and meaning, the fluid's velocity ratio as formulas have it."""
    if number.is_named:
        return parts.capital(f"{number.name}, {number.meaning}".replace(", of ", " of "))
    return f"{re.sub('^lam', 'λ', number.name)}, {number.meaning}"


def _why(fit: FitResult, number: KeyNumber) -> str:
    """Why a number is not there."""
    if number.name.startswith("threshold speed"):
        notes = [note for group in range(len(fit.thetas)) if (note := onset_note(fit, group))]
        return notes[0] if notes else ""
    found = [c.message for c in fit.identifiability.combinations if number.name in c.names]
    return found[0] if found else ""


def _figure(material: ReportInput, name: str, title: str) -> Html:
    """A half figure, or nothing where the data have none of it."""
    if material.figure_format == "none":  # what draws is not even loaded
        return Html("")
    return embedded(material, name, getattr(material.fit.plot, name), title, caption="")


# ---- thresholds ----------------------------------------------------------------------------------


def threshold_table(material: ReportInput) -> Iterator[Html]:
    """The threshold speed of each condition with its intervals, and how far it is from tested and operating speeds."""
    fit = material.fit
    if not fit.model.speed_dependent:
        yield parts.note("This model does not depend on the rotative speed.")
        return
    if fit.model.turns or "coefficients" in leads_of(fit):
        return
    rows, notes = [], []
    for label, group in parts.groups_of(fit):
        onset = fit.threshold_of(group)
        name = "Threshold of instability" + (f", {label}" if label else "")
        if math.isinf(onset.stderr) or math.isnan(onset.value):
            said = "not determined" if math.isinf(onset.stderr) else "none found at any speed searched"
            rows.append([name, said, "", "", ""])
        else:
            value, error = with_error(onset.value * RPM_PER_RAD_S, onset.stderr * RPM_PER_RAD_S)
            low, high = (RPM_PER_RAD_S * end for end in parts.onset_interval(fit, onset))
            posterior = parts.threshold_interval(material.posterior, parts.at_of(fit, group))
            margins = "; ".join(_margins(material, onset))
            rows.append([name, f"{value} ± {error} rpm", interval(low, high), posterior, margins])
        notes += [parts.sentence(note)] if (note := onset_note(fit, group)) else []
    yield table(["", "value", "95 % Laplace, rpm", "95 % posterior, rpm", "margin"], rows)
    if notes:
        yield parts.note(*dict.fromkeys(notes))


def _margins(material: ReportInput, onset: Quantity) -> Iterator[str]:
    """How far a threshold is from the speeds that it refers to."""
    half = parts.onset_interval(material.fit, onset)[1] - onset.value
    for what, speed in _reference_speeds(material):
        value, error = with_error(abs(100 * (onset.value / speed - 1)), 100 * half / speed)
        yield f"{value} ± {error} % (95 %) {'above' if onset.value >= speed else 'below'} the {what}"


def _reference_speeds(material: ReportInput) -> Iterator[tuple[str, float]]:
    """Speeds, rad/s, that a margin of stability refers to."""
    highest = float(material.fit.speeds.max(initial=0.0))
    if highest > 0:
        yield f"highest tested speed ({highest * RPM_PER_RAD_S:.0f} rpm)", highest
    if material.operating_speed is not None:
        yield f"operating speed ({material.operating_speed * RPM_PER_RAD_S:.0f} rpm)", material.operating_speed


def misfit_words(fit: FitResult) -> str:
    """How the misfit varies between responses."""
    sizes = {r.name: r.redchi for r in fit.responses if math.isfinite(r.redchi)}
    worst = max((r.nrmse for r in fit.responses), default=math.nan)
    said = [f"redchi {plain(fit.redchi, 3)}"]
    if len(sizes) > 1:
        name = max(sizes, key=lambda one: sizes[one])
        said.append(f"by response {plain(min(sizes.values()), 2)} to {plain(sizes[name], 2)} ({name})")
    if np.isfinite(worst):
        said.append(f"largest rms error of a response {plain(100 * worst, 2)} %")
    return parts.sentence("; ".join(said))
