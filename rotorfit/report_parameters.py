"""Sections of the report on the parameters: values, intervals, shares of the uncertainty, identifiability."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.markup import Html, bullets, paragraph, table
from rotorfit.report_numbers import NORMAL_95, RPM, interval, plain, with_error
from rotorfit.report_parts import at_of, groups_of, note, section, sentence, symbol
from rotorfit.results import FittedParameter
from rotorfit.tables import notable_correlations

if TYPE_CHECKING:
    from rotorfit.report import ReportInput


def parameter_section(material: ReportInput) -> Html:
    """All parameters: start, optimum, standard errors."""
    fit = material.fit
    start = "closed-form start" if fit.method == "least squares" else "start"
    head = ["parameter", "value", "standard error", "from noise alone", "unit", start, "meaning", ""]
    notes = ["Errors are one standard deviation."]
    if any(p.stderr > 1.01 * p.stderr_noise for p in fit.params.values() if p.vary and p.resolved):
        notes.append(
            f"They are those from the noise times √redchi = {plain(math.sqrt(fit.redchi), 3)}, because the residuals "
            "exceed the noise."
        )
    rows = [_row(p) for p in fit.params.values()]
    return section("Parameters", table(head, rows, numeric=(1, 2, 3, 5), whole=(4,)), note(*notes))


def _row(p: FittedParameter) -> list[str]:
    name, unit = symbol(p.name), _unit(p.unit)
    if not p.vary:
        return [name, plain(p.value), "known", "", unit, "", p.meaning, ""]
    if not p.resolved:
        return [name, "not determined", "", "", unit, plain(p.init_value), p.meaning, ""]
    value, error = with_error(p.value, p.stderr)
    noise = with_error(p.value, p.stderr_noise)[1]
    bound = "at its bound: no symmetric interval" if p.at_bound else ""
    return [name, value, error, noise if noise != error else "", unit, plain(p.init_value, 6), p.meaning, bound]


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit.replace("s^2", "s²")


# ---- intervals -------------------------------------------------------------------------------


def interval_section(material: ReportInput) -> Html:
    """Three kinds of 95 % interval side by side, and the shares of the uncertainty."""
    rows = [_interval_row(material, p) for p in material.fit.params.values() if p.vary and p.resolved]
    rows += _threshold_rows(material)
    if not rows:
        return Html("")
    head = ["", "Laplace", "profile likelihood", "posterior", "random share", "systematic share", "unit"]
    words = ["Laplace: estimate ± 1.96 standard errors, right where the errors are normal."]
    if material.profile:
        words.append(
            "Profile likelihood: where the best misfit at a fixed value of the parameter has risen by the 95 % point "
            "of chi-squared; it follows a curved likelihood."
        )
    if material.posterior is not None:
        words.append("Posterior: central 95 % of the sampled draws.")
    if material.shares:
        words.append(
            "Random and systematic shares are standard uncertainties, GUM type A (noise) and type B (calibration)."
        )
    missing = [
        name for name, there in (("a posterior", material.posterior), ("profile likelihoods", material.profile))
        if not there
    ]  # fmt: skip
    if len(missing) == 2:
        words.append("A posterior or profile likelihoods would test that.")
    return section("95 % intervals", table(head, rows, numeric=range(1, 6), whole=(6,)), note(*words))


def _interval_row(material: ReportInput, p: FittedParameter) -> list[str]:
    laplace = interval(p.value - NORMAL_95 * p.stderr, p.value + NORMAL_95 * p.stderr)
    profile = interval(*material.profile[p.name]) if p.name in material.profile else ""
    shares = material.shares.get(p.name)
    shown = ("", "") if shares is None else (plain(shares[0], 2), plain(shares[1], 2))
    return [
        symbol(p.name), "–" if p.at_bound else laplace, profile, _posterior_interval(material, p.name), *shown,
        _unit(p.unit),
    ]  # fmt: skip


def _posterior_interval(material: ReportInput, name: str) -> str:
    posterior = material.posterior
    if posterior is None or name not in posterior.names:
        return ""
    low, high = np.quantile(posterior.samples[:, list(posterior.names).index(name)], [0.025, 0.975])
    return interval(float(low), float(high))


def _threshold_rows(material: ReportInput) -> Iterator[list[str]]:
    fit = material.fit
    if not fit.model.speed_dependent:
        return
    for label, group in groups_of(fit):
        onset = fit.threshold_of(group)
        if math.isfinite(onset.value) and math.isfinite(onset.stderr):
            half = NORMAL_95 * onset.stderr
            name = "threshold speed" + (f", {label}" if label else "")
            posterior = ""
            if material.posterior is not None:
                low, high = material.posterior.threshold_speed(at_of(label)).interval(0.95)
                posterior = interval(low * RPM, high * RPM)
            laplace = interval((onset.value - half) * RPM, (onset.value + half) * RPM)
            yield [name, laplace, "", posterior, "", "", "rpm"]


# ---- identifiability ---------------------------------------------------------------------------


def identifiability_section(material: ReportInput) -> Html:
    """What the data determine, and which parameters go together."""
    fit = material.fit
    verdict = fit.identifiability
    content = [
        paragraph(
            f"{verdict.rank} of {verdict.size} parameter combinations are determined by these data; the condition "
            f"number of the scaled sensitivities is {plain(verdict.condition, 2)}."
        )
    ]
    if verdict.combinations:
        content.append(bullets((sentence(c.message) for c in verdict.combinations), class_="warnings"))
    else:
        content.append(paragraph("Every fitted value has a number of its own: nothing is known only as a combination."))
    pairs = notable_correlations(fit)
    if pairs:
        listed = ", ".join(f"{a} and {b} ({plain(r, 2)})" for a, b, r in pairs)
        content.append(
            paragraph(
                f"Estimates that are strongly correlated: {listed}. A prior or a known value of one would narrow the "
                "other."
            )
        )
    return section("Identifiability", *content)
