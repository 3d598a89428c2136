"""First section of the report: what an engineer wants to know before anything else."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.identify.fitting.noise.record import NoiseVerdict
from rotorfit.identify.fitting.noise.residual_study import MODEL_LIMITED_REDCHI, VERDICTS
from rotorfit.identify.fitting.notices import notices_of
from rotorfit.identify.fitting.quantities import Number, Quantity
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.data.findings import Finding, attributed, errors_in
from rotorfit.models.motion.stability import growth_rate
from rotorfit.models.parameters import bare_name
from rotorfit.show.report import parts
from rotorfit.show.report.html import Html, bullets, element, join
from rotorfit.show.report.material import ReportInput
from rotorfit.show.report.numbers import interval, plain, with_error

_FLUID = ("D", "lam", "lam_D", "lam_M", "Mf")


def verdict_section(material: ReportInput) -> Html:
    """Headline, figures that matter, warnings."""
    fit = material.fit
    cards = [*_stability_cards(material), _quality_card(fit), *_fluid_cards(fit)]
    content = [element("p", " ".join(_headline(material)), class_="headline"), element("div", *cards, class_="cards")]
    errors = data_errors(material)
    warnings = [f"error in the data: {words}" for words in errors]
    of_data = [found.words for found in _of_data(material) if found.severity == "warning"]
    warnings += dict.fromkeys(f"warning of the data: {words}" for words in of_data)
    own = notices_of(fit)
    warnings += [one.message for one in own if one.severity != "note"]
    if fit.identifiability.unresolved:
        warnings.append("not determined by these data: " + ", ".join(fit.identifiability.unresolved))
    if material.posterior is not None and not material.posterior.converged:
        warnings.append(f"posterior: {material.posterior.message}")
    if warnings:
        content.append(bullets((parts.sentence(w) for w in warnings), class_="warnings"))
    notes = [one.message for one in own if one.severity == "note" and one.origin in ("fit", "model")]
    if notes:
        content.append(bullets(map(parts.sentence, notes), class_="note"))
    return parts.section("Verdict", *content)


def data_errors(material: ReportInput) -> tuple[str, ...]:
    """Errors of the data, those that explain the misfit first; of a refined model those of the fit before."""
    first = material.fit if material.refinement is None else material.refinement.candidates[0]
    return errors_in((*first.findings, *_of_data(material)))


def _of_data(material: ReportInput) -> list[Finding]:
    """What the check of the data found, errors first."""
    return attributed(material.findings, [test.source or test.title for test in material.fit.experiments])


def _headline(material: ReportInput) -> Iterator[str]:
    """The verdict in two or three sentences."""
    fit = material.fit
    if data_errors(material):
        yield "The data have an error, which is named below: no number in this report should be relied on."
        return
    if not fit.success:
        yield "The fit did not converge: no number in this report should be relied on."
        return
    if fit.model.speed_dependent:
        yield from _stability_words(material)
    if fit.perhaps_local:
        yield (
            f"The search may have ended in a local minimum (redchi {plain(fit.redchi, 3)}), as is said below: other "
            "values may explain these data as well, or better."
        )
    elif fit.model_limited:
        yield (
            f"The model explains the data only roughly (redchi {plain(fit.redchi, 3)}): its own error, not the noise, "
            "limits the result."
        )
    elif fit.problem.loss == "linear":
        redchi = f"redchi {plain(fit.redchi, 3)}, by noise alone at most {plain(fit.largest_redchi, 3)}"
        yield f"{parts.sentence(_agreement(fit)).removesuffix('.')} ({redchi}{_by_response(fit)})."
        yield from ([] if fit.noise is None else (parts.sentence(words) for words in fit.noise.notable))
    else:
        yield f"Outliers were given less weight ({fit.problem.loss} loss)."
    unresolved = len(fit.identifiability.unresolved)
    if unresolved:
        yield f"The data leave {unresolved} of {fit.nvarys} fitted values undetermined; they are named below."


def _agreement(fit: FitResult) -> str:
    """Model and data in words, by redchi and what noise alone lets it be."""
    if fit.model_limited:
        return "the model, not the noise, limits this fit; standard errors are widened for it"
    if fit.problem.loss != "linear":
        return "outliers included, whose weight in the fit is small"
    if fit.redchi <= fit.largest_redchi:
        return "the model explains the data to within their noise"
    more = f"the residuals are {plain(100 * (math.sqrt(fit.redchi) - 1), 2)} % larger than the noise"
    known = fit.noise is not None and fit.noise.verdict is not NoiseVerdict.AS_FOUND
    return f"{more}: {VERDICTS[fit.noise.verdict]}" if fit.noise is not None and known else more


def _by_response(fit: FitResult) -> str:
    """How the misfit varies between responses, in words, and which is worst where it is missed."""
    sizes = {r.name: r.redchi for r in fit.responses if math.isfinite(r.redchi)}
    if len(sizes) < 2:
        return ""
    worst = max(sizes, key=lambda name: sizes[name])
    words = f"; by response {plain(min(sizes.values()), 2)} to {plain(sizes[worst], 2)}"
    return f"{words} ({worst})" if sizes[worst] > MODEL_LIMITED_REDCHI else words


def _stability_words(material: ReportInput) -> Iterator[str]:
    fit = material.fit
    onsets = [(fit.threshold_of(group), label, group) for label, group in parts.groups_of(fit)]
    found = [(onset, label) for onset, label, _ in onsets if not math.isnan(onset.value)]
    if any(_unstable(fit, group) for _, _, group in onsets):
        yield "The fitted rotor is unstable at a speed that was tested."
    elif fit.speeds.size:
        yield "The rotor is stable at every tested speed."
    if not found and any(math.isinf(onset.stderr) for onset, _, _ in onsets):
        yield "These data do not determine whether or at which speed it becomes unstable."
        yield from (parts.sentence(note) for note in {fit.onset_note(group) for _, _, group in onsets} if note)
        return
    if not found:
        yield "No threshold of instability was found at any speed searched."
        return
    lowest, label = min(found, key=lambda item: item[0].value)
    note = fit.onset_note(next(group for onset, _, group in onsets if onset is lowest))
    where = f" ({label})" if label else ""
    if lowest.value == 0:
        yield f"It is unstable from standstill on{where}."
        return
    if not math.isfinite(lowest.stderr):
        yield f"These data do not determine the speed at which it becomes unstable{where}."
        return
    value, error = with_error(*(RPM_PER_RAD_S * part for part in (lowest.value, lowest.stderr)))
    margins = " and ".join(
        f"{plain(abs(100 * (lowest.value / speed - 1)), 3)} % {_side(lowest, speed)} the {what}"
        for what, speed in _reference_speeds(material)
    )
    highest = float(fit.speeds.max(initial=0.0))
    beyond = ", extrapolated" if 0 < highest < lowest.value else ""
    yield f"It becomes unstable at {value} ± {error} rpm{where}{', ' + margins if margins else ''}{beyond}."
    if note:
        yield parts.sentence(note)


def _unstable(fit: FitResult, group: int) -> bool:
    """True if the fitted rotor is unstable at a speed that was tested."""
    theta, speeds = fit.thetas[group], fit.speeds
    if not speeds.size:
        return False
    rates = growth_rate(fit.model, np.broadcast_to(theta, (speeds.size, theta.size)), speeds, fit.stability_band)
    return bool((rates > 1e-9 * np.abs(theta).max()).any())


def _reference_speeds(material: ReportInput) -> Iterator[tuple[str, float]]:
    """Speeds, rad/s, that a margin of stability refers to."""
    highest = float(material.fit.speeds.max(initial=0.0))
    if highest > 0:
        yield f"highest tested speed ({highest * RPM_PER_RAD_S:.0f} rpm)", highest
    if material.operating_speed is not None:
        yield f"operating speed ({material.operating_speed * RPM_PER_RAD_S:.0f} rpm)", material.operating_speed


def _side(onset: Quantity, speed: float) -> str:
    return "above" if onset.value >= speed else "below"


# ---- cards -----------------------------------------------------------------------------------


def _card(name: str, value: str, *more: str, unit: str = "", bad: bool = False) -> Html:
    shown = join([value, element("span", unit, class_="unit")], " ") if unit else value
    return element(
        "div",
        element("div", name, class_="name"),
        element("div", shown, class_="value"),
        *(element("div", line, class_="more") for line in more),
        class_="card bad" if bad else "card",
    )


def _plus_minus(value: float, error: float) -> Html:
    """Value and error, which no line break may part."""
    return element("span", " ± ".join(with_error(value, error)), class_="whole")


def _shares(found: Number, scale: float = 1.0) -> list[str]:
    """What the error of a number is made of."""
    bar = found._quantity.error
    if bar is None:
        return []
    shares = ((bar.noise, "noise"), (bar.bounded, "bounded"), (bar.trust, f"on trust, most by {bar.largest_on_trust}"))
    return [", ".join(f"± {with_error(0.0, scale * share)[1]} {words}" for share, words in shares)]


def _stability_cards(material: ReportInput) -> Iterator[Html]:
    fit = material.fit
    if not fit.model.speed_dependent:
        yield _card("Threshold of instability", "none", "this model does not depend on the rotative speed")
        return
    for label, group in parts.groups_of(fit):
        name = "Threshold of instability" + (f", {label}" if label else "")
        onset = fit.threshold_of(group)
        if math.isinf(onset.stderr):
            why = fit.onset_note(group) or "these data leave the threshold speed open"
            yield _card(name, "not determined", why, bad=True)
        elif math.isnan(onset.value):
            yield _card(name, "none found", "the fitted rotor is stable at every speed searched")
        else:
            low, high = (RPM_PER_RAD_S * end for end in parts.onset_interval(fit, onset))
            lines = [f"95 % Laplace {interval(low, high)} rpm"]
            posterior = parts.threshold_interval(material.posterior, parts.at_of(fit, group))
            lines += [f"95 % posterior {posterior} rpm"] if posterior else []
            for what, speed in _reference_speeds(material):
                half_width = 100 * (parts.onset_interval(fit, onset)[1] - onset.value) / speed
                value, half = with_error(abs(100 * (onset.value / speed - 1)), half_width)
                lines.append(f"{value} ± {half} % (95 %) {_side(onset, speed)} the {what}")
            if onset.value == 0:
                yield _card(name, "0", "the fitted rotor is unstable from standstill on", unit="rpm", bad=True)
                continue
            below = any(onset.value < speed for _, speed in _reference_speeds(material))
            yield _card(
                name,
                _plus_minus(onset.value * RPM_PER_RAD_S, onset.stderr * RPM_PER_RAD_S),
                *_shares(onset, RPM_PER_RAD_S),
                *lines,
                unit="rpm",
                bad=below,
            )


def _quality_card(fit: FitResult) -> Html:
    if not fit.success:
        return _card("Fit", "not converged", fit.message, bad=True)
    worst = max((r.nrmse for r in fit.responses), default=math.nan)
    lines = [
        _agreement(fit) + _by_response(fit),
        *([f"largest rms error of a response {plain(100 * worst, 2)} %"] if math.isfinite(worst) else []),
    ]
    return _card("Misfit over noise (redchi)", plain(fit.redchi, 3), *lines, bad=fit.model_limited)


def _fluid_cards(fit: FitResult) -> Iterator[Html]:
    """Cards of the fluid's parameters, or of the first ones of a model without a fluid."""
    fitted = [p for p in fit.params.values() if p.vary and p.name in fit.problem.space.names]
    wanted = [p for p in fitted if bare_name(p.name) in _FLUID]
    cards = 6
    for p in (wanted or fitted)[:cards]:
        name = f"{p.name}, {p.meaning}"
        if not p.resolved:
            yield _card(name, "not determined", "see identifiability", bad=True)
        else:
            yield _card(name, _plus_minus(p.value, p.stderr), *_shares(p), unit=parts.unit_shown(p.unit))
