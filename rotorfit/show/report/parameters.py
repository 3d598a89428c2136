"""Sections of the report on the parameters: values, intervals, shares of the uncertainty, identifiability."""

from __future__ import annotations

import math
from collections.abc import Iterator

from rotorfit.base.digits import significant
from rotorfit.base.significance import quantile
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.inference.identifiability import Combination
from rotorfit.identify.fitting.headline import leads_of
from rotorfit.identify.fitting.noise.residual_study import VERDICTS
from rotorfit.identify.fitting.notices import notices_of
from rotorfit.identify.fitting.quantities import THRESHOLD, FittedParameter
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.summary import (
    combined,
    correction_names,
    in_order,
    interval_lines,
    notable_correlations,
    start_words,
)
from rotorfit.identify.uncertainty.profile import Profile
from rotorfit.models import RotorModel
from rotorfit.models.parameters import bare_name
from rotorfit.show.report import parts
from rotorfit.show.report.html import Html, bullets, element, paragraph, table
from rotorfit.show.report.material import ReportInput
from rotorfit.show.report.numbers import interval, plain, typeset


def parameter_section(material: ReportInput) -> Html:
    """All parameters: start, optimum, standard errors."""
    fit = material.fit
    # A refined fit starts from the step before it; what the data alone gave is the start of the first step.
    refinement = material.refinement
    first = refinement.steps[0] if refinement is not None and fit is refinement.best else fit
    starts = {p.name: plain(p.init_value, 6) for p in first.params.values() if p.vary}
    begin = f"start: {start_words(first)}"
    head = ["parameter", "value", "standard error", "from noise alone", "unit", begin, "meaning", ""]
    notes = ["Errors are one standard deviation."]
    if not fit.success:
        notes = ["The search did not converge, so no errors are given."]
    elif fit.widening > 1.01:
        notes.append(
            f"They are the errors from the noise times √redchi = {plain(math.sqrt(fit.redchi), 3)}, because the "
            "residuals exceed the noise."
        )
    elif fit.settings.noise_scale:
        notes.append("They follow the residuals of each response where these exceed the noise.")
    if fit.noise is not None:
        notes.append(parts.sentence(f"noise: {VERDICTS[fit.noise.verdict]}"))
    if fit.causes.rows:
        given = ", ".join(f"{name} {plain(size, 3)}" for name, size in fit.settings.sizes.items())
        words = "They include causes beside the model, found and on trust; see the budget"
        notes.append(parts.sentence(f"{words}, with the sizes given ({given})" if given else words))
    of_errors = (one.message for one in notices_of(fit) if one.origin in ("noise", "reading"))
    notes += map(parts.sentence, (*interval_lines(fit), *of_errors))
    corrections = correction_names(fit.model)

    def listed(of_structure: bool) -> Html:
        chosen = (p for p in in_order(fit.params.values()) if (bare_name(p.name) in corrections) == of_structure)
        rows = [_row(p, fit.model, starts.get(p.name, "")) for p in chosen]
        return table(head, rows, numeric=(1, 2, 3, 5), whole=(4,))

    more = f"{len(corrections)} corrections of the structure"
    folded = [element("details", element("summary", more), listed(True))] if corrections else []
    of_seal = "coefficients" in leads_of(fit)  # whose coefficients stand above, by condition
    return parts.section("Parameters", listed(False), *folded, parts.note(*notes), folded=of_seal)


def _row(p: FittedParameter, model: RotorModel, start: str) -> list[str]:
    name, unit = parts.symbol(p.name, model), parts.unit_shown(p.unit)
    if not (shares := p.shares()):
        said = [plain(p.value), "known"] if not p.vary else [p.shown().value, ""]
        return [name, *said, "", unit, start, p.meaning, ""]
    value, (error, noise) = typeset(p.shown().value), map(typeset, shares[:2])
    bound = "at its bound: no symmetric interval" if p.at_bound else "" if p.vary else "known"
    return [name, value, error, noise if noise != error else "", unit, start, p.meaning, bound]


# ---- intervals -------------------------------------------------------------------------------


def interval_section(material: ReportInput) -> Html:
    """Three kinds of 95 % interval side by side, and the shares of the uncertainty."""
    profiles = {p.name: p for p in material.profiles}
    rows = [
        _interval_row(material, p, profiles.get(p.name)) for p in in_order(material.fit.params.values()) if _shown(p)
    ]
    rows += _threshold_rows(material, profiles.get(THRESHOLD))
    if not rows:
        return Html("")
    head = ["", "Laplace", "profile likelihood", "posterior", "bootstrap", "noise", "systematic", "unit"]
    degrees = material.fit.freedom
    words = [
        "Laplace: estimate ± 1.96 standard errors, or the quantile of Student's t where they rest on few runs or "
        "readings. It is right where the errors are normal."
    ]
    if math.isfinite(degrees):
        reach = f"estimate ± {significant(quantile(0.95, degrees), 3)} standard errors"
        why = f"Student's t with {degrees:.0f} degrees of freedom, because the noise is estimated from few mountings"
        words = [f"Laplace: {reach}, {why}."]
    if material.profiles:
        words.append(
            "Profile likelihood: where the best misfit at a fixed value of the parameter has risen by the 95 % point "
            "of chi-squared; it follows a curved likelihood."
        )
    if material.posterior is not None:
        words.append("Posterior: central 95 % of the sampled draws.")
    simulated = material.bootstrap
    if simulated is not None:
        failed = f", {simulated.failures} of whose fits failed" if simulated.failures else ""
        words.append(f"Bootstrap: central 95 % of the estimates from {len(simulated.samples)} simulated tests{failed}.")
    if material.shares:
        words.append(
            "Noise and systematic are the shares of the standard error: by the readings' noise (GUM type A), and by "
            "causes beside the model (type B)."
        )
    if not material.profiles and material.posterior is None and simulated is None:
        words.append("A posterior or profile likelihoods would test it.")
    words += [parts.sentence(f"{p.name}: {p.message}") for p in material.profiles if p.message]
    return parts.section(
        "95 % intervals", table(head, rows, numeric=range(1, 7), whole=(7,)), parts.note(*words), folded=True
    )


def _shown(p: FittedParameter) -> bool:
    return p.vary and p.determined


def _interval_row(material: ReportInput, p: FittedParameter, profile: Profile | None) -> list[str]:
    laplace = interval(*material.fit.interval(p.name))
    shares = material.shares.get(p.name)
    posterior, simulated = material.posterior, material.bootstrap
    return [
        parts.symbol(p.name, material.fit.model),
        "–" if p.at_bound else laplace,
        "" if profile is None else interval(*profile.interval),
        "" if posterior is None else interval(*posterior.interval(p.name)),
        "" if simulated is None else interval(*simulated.interval(p.name)),
        *(("", "") if shares is None else (plain(shares[0], 2), plain(shares[1], 2))),
        parts.unit_shown(p.unit),
    ]


def _threshold_rows(material: ReportInput, profile: Profile | None) -> Iterator[list[str]]:
    fit = material.fit
    if not fit.model.speed_dependent:
        return
    for label, group in parts.groups_of(fit):
        onset = fit.threshold_of(group)
        if math.isfinite(onset.value) and math.isfinite(onset.stderr):
            low, high = parts.onset_interval(fit, onset)
            yield [
                "threshold speed" + (f", {label}" if label else ""),
                interval(low * RPM_PER_RAD_S, high * RPM_PER_RAD_S),
                # A profile does not say which group it belongs to.
                interval(profile.lower * RPM_PER_RAD_S, profile.upper * RPM_PER_RAD_S)
                if profile is not None and not label
                else "",
                parts.threshold_interval(material.posterior, parts.at_of(fit, group)),
                parts.threshold_interval(material.bootstrap, parts.at_of(fit, group)),
                *(plain(RPM_PER_RAD_S * share, 2) for share in (onset.noise, onset.systematic)),
                "rpm",
            ]


# ---- identifiability ---------------------------------------------------------------------------


def _open(fit: FitResult, combination: Combination) -> str:
    """A combination of undetermined parameters, and the value of it that the data determine."""
    value = combined(fit, combination)
    return parts.sentence(combination.message) + (f" Determined: {value.replace('+-', '±')}." if value else "")


def identifiability_section(material: ReportInput) -> Html:
    """Determined combinations and correlated parameters."""
    fit = material.fit
    verdict = fit.identifiability
    count = f"{verdict.rank} of {verdict.size} parameter combinations are determined by these data"
    condition = f"the condition number of the scaled sensitivities is {plain(verdict.condition, 2)}"
    content = [paragraph(f"{count}; {condition}.")]
    if verdict.combinations:
        content.append(bullets((_open(fit, c) for c in verdict.combinations), class_="warnings"))
    else:
        content.append(paragraph("Each fitted value is determined on its own."))
    pairs = notable_correlations(fit)
    if pairs:
        listed = ", ".join(f"{a} and {b} ({plain(r, 2)})" for a, b, r in pairs)
        advice = "A prior or a known value of one would narrow the other."
        content.append(paragraph(f"Estimates that are strongly correlated: {listed}. {advice}"))
    return parts.section("Identifiability", *content, folded=not verdict.combinations)
