"""Sections of the report that are words and tables."""

from __future__ import annotations

import math
import platform
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.equation import stiffness_entries, symbol_mathml, to_mathml
from rotorfit.experiments import Experiment, PerturbationTest
from rotorfit.markup import Html, bullets, element, join, paragraph, table
from rotorfit.refinement import structure_name
from rotorfit.report_numbers import NORMAL_95, RPM, interval, plain, speeds_in_words, with_error
from rotorfit.results import FitResult, FittedParameter, Quantity
from rotorfit.tables import notable_correlations

if TYPE_CHECKING:
    from rotorfit.report import ReportInput

_WRITTEN_OUT = 4
"""Coordinates up to which the dynamic stiffness matrix is written out."""


def section(title: str, *content: str, figure: bool = False) -> Html:
    """A section with its heading."""
    attributes = {"class_": "figure"} if figure else {}
    return element("section", element("h2", title), *content, **attributes)


def groups_of(fit: FitResult) -> list[tuple[str, int]]:
    """Parameter groups: what tells each apart, empty for a single one, and its number."""
    space = fit.problem.space
    result = []
    for group, index in enumerate(space.index):
        names = (space.names[i].partition("[")[2][:-1] for i in index if i >= 0 and "[" in space.names[i])
        result.append((", ".join(dict.fromkeys(names)), group))
    return result


# ---- verdict ---------------------------------------------------------------------------------


def verdict_section(material: ReportInput) -> Html:
    """What an engineer wants to know first."""
    fit = material.fit
    cards = [*_stability_cards(material), _quality_card(fit), *_fluid_cards(fit)]
    content = [element("div", *cards, class_="cards")]
    warnings = [*fit.warnings]
    if not fit.success and not any(fit.message in w for w in warnings):
        warnings.insert(0, f"the optimisation did not converge: {fit.message}")
    if fit.identifiability.unresolved:
        warnings.append("not determined by these data: " + ", ".join(fit.identifiability.unresolved))
    if warnings:
        content.append(bullets((_sentence(w) for w in warnings), class_="warnings"))
    if fit.model.caveats:
        content.append(bullets((_sentence(c) for c in fit.model.caveats), class_="note"))
    return section("Verdict", *content)


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "?", "!")) else ".")


def _card(name: str, value: str, *more: str, bad: bool = False) -> Html:
    return element(
        "div",
        element("div", name, class_="name"),
        element("div", value, class_="value"),
        *(element("div", line, class_="more") for line in more),
        class_="card bad" if bad else "card",
    )


def _stability_cards(material: ReportInput) -> Iterator[Html]:
    fit = material.fit
    if not fit.model.speed_dependent:
        yield _card("Threshold of instability", "none", "this model does not depend on the rotative speed")
        return
    for label, group in groups_of(fit):
        name = "Threshold of instability" + (f", {label}" if label else "")
        onset = fit.threshold_of(group)
        if math.isnan(onset.value):
            yield _card(name, "none found", "the fitted rotor is stable at every speed searched")
        elif not math.isfinite(onset.stderr):
            yield _card(name, "not determined", "these data leave the threshold speed open", bad=True)
        else:
            lines = [*_threshold_intervals(material, onset), *_margins(material, onset)]
            value, error = with_error(onset.value * RPM, onset.stderr * RPM)
            yield _card(name, f"{value} ± {error} rpm", *lines, bad=any("below" in line for line in lines))


def _threshold_intervals(material: ReportInput, onset: Quantity) -> Iterator[str]:
    low, high = (RPM * (onset.value + sign * NORMAL_95 * onset.stderr) for sign in (-1, 1))
    yield f"95 % interval {interval(low, high)} rpm (Laplace)"
    posterior = material.posterior
    if posterior is not None and hasattr(posterior, "threshold_speed"):
        low, high = posterior.threshold_speed().interval(0.95)
        yield f"95 % interval {interval(low * RPM, high * RPM)} rpm (posterior)"


def _margins(material: ReportInput, onset: Quantity) -> Iterator[str]:
    fit = material.fit
    named = [("highest tested speed", float(fit.speeds.max()))] if fit.speeds.size else []
    if material.operating_speed is not None:
        named.append(("operating speed", material.operating_speed))
    for what, speed in named:
        if speed <= 0:
            continue
        margin = 100 * (onset.value / speed - 1)
        error = 100 * NORMAL_95 * onset.stderr / speed
        text, half = with_error(abs(margin), error)
        side = "above" if margin >= 0 else "below"
        yield f"{text} % ± {half} % {side} the {what} of {speed * RPM:.0f} rpm"


def _quality_card(fit: FitResult) -> Html:
    if not fit.success:
        return _card("Fit", "not converged", fit.message, bad=True)
    limited = fit.redchi > 2 and fit.problem.loss == "linear"
    verdict = (
        "the model, not the noise, limits this fit; standard errors are widened for it"
        if limited
        else "the model explains the data to within their noise"
    )
    worst = max((r.nrmse for r in fit.responses), default=math.nan)
    return _card(
        "Fit",
        f"redchi {plain(fit.redchi, 3)}",
        verdict,
        f"largest error of a response {100 * worst:.2g} %",
        bad=limited,
    )


def _fluid_cards(fit: FitResult) -> Iterator[Html]:
    """Cards of the fluid's parameters, or of the first ones of a model without a fluid."""
    base = {name: p for name, p in fit.params.items() if p.vary and p.name in fit.problem.space.names}
    wanted = [p for name, p in base.items() if name.partition("[")[0] in ("D", "lam", "lam_D", "lam_M", "Mf")]
    for p in (wanted or list(base.values()))[:6]:
        unit = "" if p.unit == "1" else f" {p.unit}"
        if not p.resolved:
            yield _card(f"{p.name}, {p.meaning}", "not determined", "see identifiability", bad=True)
        else:
            value, error = with_error(p.value, p.stderr)
            yield _card(f"{p.name}, {p.meaning}", f"{value} ± {error}{unit}")


# ---- parameters -----------------------------------------------------------------------------


def parameter_section(material: ReportInput) -> Html:
    """All parameters: start, optimum, standard errors, intervals, shares."""
    fit = material.fit
    rows = [_parameter_row(material, p) for p in fit.params.values()]
    start = "closed-form start" if fit.method == "least squares" else "start"
    head = [
        "parameter", "value", "standard error", "from noise alone", start, "95 % Laplace", "95 % profile",
        "95 % posterior", "random share", "systematic share", "unit", "meaning", "",
    ]  # fmt: skip
    notes = ["Values are estimates, errors one standard deviation, intervals central 95 %."]
    if any(p.stderr > 1.01 * p.stderr_noise for p in fit.params.values() if p.vary and p.resolved):
        notes.append(
            f"Standard errors are those from the noise times √redchi = {plain(math.sqrt(fit.redchi), 3)}, because the "
            "residuals exceed the noise."
        )
    if material.shares:
        notes.append(
            "Random and systematic shares are standard uncertainties, GUM type A (noise) and type B (calibration)."
        )
    elif not material.posterior and not material.profile:
        notes.append("Laplace intervals take the errors as normal; a posterior or profile likelihoods would test that.")
    return section("Parameters", table(head, rows, numeric=range(1, 10)), element("p", " ".join(notes), class_="note"))


def _parameter_row(material: ReportInput, p: FittedParameter) -> list[str]:
    symbol = element("math", Html(symbol_mathml(p.name.partition("[")[0])))
    group = p.name.partition("[")[1] + p.name.partition("[")[2]
    name = join([symbol, f" {p.name}" if group else ""])
    unit = "" if p.unit == "1" else p.unit
    if not p.vary:
        return [name, plain(p.value), "known", *[""] * 7, unit, p.meaning, ""]
    if not p.resolved:
        return [name, "not determined", *[""] * 2, plain(p.init_value), *[""] * 5, unit, p.meaning, ""]
    value, error = with_error(p.value, p.stderr)
    noise = with_error(p.value, p.stderr_noise)[1]
    laplace = interval(p.value - NORMAL_95 * p.stderr, p.value + NORMAL_95 * p.stderr)
    profile = interval(*material.profile[p.name]) if p.name in material.profile else ""
    shares = material.shares.get(p.name)
    return [
        name, value, error, noise if noise != error else "", plain(p.init_value, 6), laplace if not p.at_bound else "–",
        profile, _posterior_interval(material, p.name),
        *(("", "") if shares is None else (plain(shares[0], 2), plain(shares[1], 2))),
        unit, p.meaning, "at its bound: no symmetric interval" if p.at_bound else "",
    ]  # fmt: skip


def _posterior_interval(material: ReportInput, name: str) -> str:
    posterior = material.posterior
    if posterior is None or name not in posterior.names:
        return ""
    low, high = np.quantile(posterior.samples[:, list(posterior.names).index(name)], [0.025, 0.975])
    return interval(float(low), float(high))


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
        content.append(bullets((_sentence(c.message) for c in verdict.combinations), class_="warnings"))
    pairs = notable_correlations(fit)
    if pairs:
        listed = ", ".join(f"{a} and {b} ({plain(r, 2)})" for a, b, r in pairs)
        content.append(paragraph(f"Estimates that are strongly correlated: {listed}."))
    return section("Identifiability", *content)


# ---- data and model -------------------------------------------------------------------------


def data_section(material: ReportInput) -> Html:
    """The experiments and what the check of the data found."""
    fit = material.fit
    rows = [_experiment_row(e) for e in fit.experiments]
    head = ["source", "kind", "readings", "runs", "speeds", "frequencies", "forced at", "measured at"]
    content = [table(head, rows, numeric=(2, 3))]
    found = [
        (e.source or f"experiment {i + 1}", finding)
        for i, (e, findings) in enumerate(zip(fit.experiments, material.findings, strict=True))
        for finding in findings
    ]
    if found:
        content.append(table(["source", "severity", "finding"], [[s, f.severity, f.message] for s, f in found]))
    else:
        content.append(paragraph("The check of the data found nothing to remark on."))
    content.append(
        paragraph(
            f"{fit.ndata} real data (two for each complex reading) and {fit.nvarys} fitted values. The noise was taken "
            "from the sigma given with the data, else estimated without a model from repeated sweeps, from the "
            "component against the direction of the force, or from the smoothness of the responses; never from the "
            "residuals of the fit."
        )
    )
    return section("Test and data", *content)


def _experiment_row(test: Experiment) -> list[str]:
    kind, forced = test.title, ""
    if isinstance(test, PerturbationTest):
        kind = "synchronous" if test.synchronous else "nonsynchronous perturbation"
        forced = ", ".join(test.force_planes)
        pairs = dict.fromkeys(zip(test.plane.tolist(), test.direction.tolist(), strict=True))
        measured = ", ".join(f"{plane} {direction}" for plane, direction in pairs)
    else:
        measured = ", ".join(test.planes)
    w = test.frequencies * RPM
    band = f"{plain(float(w.min()), 5)} to {plain(float(w.max()), 5)} rpm" if w.size else "constant"
    return [
        test.source or "data in memory", kind, str(len(test)), str(len(test.runs)), speeds_in_words(test.speed),
        band, forced, measured,
    ]  # fmt: skip


def model_section(material: ReportInput) -> Html:
    """The equation of motion as dynamic stiffness, written from the model itself."""
    model = material.fit.model
    kappa = "<msub><mi>κ</mi><mrow><mi>i</mi><mi>k</mi></mrow></msub>"
    general = (
        "<munder><mo>∑</mo><mi>k</mi></munder>" + kappa + "<mo>(</mo><mi>ω</mi><mo>,</mo><mi>Ω</mi><mo>)</mo>"
        "<mspace width='0.2em'/><msub><mi>A</mi><mi>k</mi></msub><mo>=</mo><msub><mi>F</mi><mi>i</mi></msub>"
    )
    frame = (
        "amplitudes of z = x + j y relative to exp(jωt), ω signed: negative is backward whirl"
        if model.frame == "z"
        else "phasors of x and y relative to exp(j|ω|t), forward and backward forces apart"
    )
    content = [
        paragraph(
            f"Model “{model.name}” with coordinates ", ", ".join(_coordinate_name(c) for c in model.coordinates),
            f"; A are the responses and F the forces ({frame}). Ω is the rotative speed.",
        ),
        _equation(general),
    ]  # fmt: skip
    if model.shaft is not None:
        content.append(paragraph("To the entries below the condensed dynamic stiffness of the known shaft is added."))
    if len(model.coordinates) > _WRITTEN_OUT:
        content.append(paragraph("The matrix is too large to be written out here."))
    else:
        content += [
            _equation(line)
            for i, row in enumerate(stiffness_entries(model))
            for k, entry in enumerate(row)
            for line in [_entry_line(i, k, entry, model.parameter_names)]
        ]
    return section("Model", *content)


def _coordinate_name(coordinate: Any) -> str:
    what = {"z": "displacement", "r": "slope", "x": "x", "y": "y"}[coordinate.axis]
    return f"{what} at {coordinate.plane}"


def _entry_line(row: int, column: int, entry: Any, names: tuple[str, ...]) -> str:
    left = f"<msub><mi>κ</mi><mrow><mn>{row + 1}</mn><mn>{column + 1}</mn></mrow></msub><mo>=</mo>"
    direct = to_mathml(entry.direct, names)
    if not entry.quadrature:
        return left + direct
    quadrature = "<mi>j</mi><mrow><mo>[</mo>" + to_mathml(entry.quadrature, names) + "<mo>]</mo></mrow>"
    return left + (direct + "<mo>+</mo>" if entry.direct else "") + quadrature


def _equation(inner: str) -> Html:
    return element("div", element("math", Html(f"<mrow>{inner}</mrow>")), class_="equation")


# ---- refinement and reproduction ----------------------------------------------------------------


def refinement_section(material: ReportInput) -> Html:
    """The ladder of structural blocks."""
    ladder = material.refinement
    if ladder is None:
        return Html("")
    rows = [
        [
            structure_name(step.model), str(step.nvarys), plain(step.redchi, 4), f"{step.bic:.1f}",
            _threshold_cell(step), "chosen" if step is ladder.best else "",
        ]
        for step in ladder.steps
    ]  # fmt: skip
    reported = any(step is material.fit for step in ladder.steps)
    words = (
        "Structural blocks that a lumped model leaves out (coupling mass, gyroscopic, out-of-band modes) were added "
        "whole, one after the other, while the Bayesian information criterion fell. "
        + ("" if reported and material.fit is ladder.best else "This report is not of the chosen step. ")
    )
    head = ["structure", "fitted values", "redchi", "BIC", "threshold, rpm", ""]
    return section("Structural refinement", paragraph(words), table(head, rows, numeric=(1, 2, 3, 4)))


def _threshold_cell(fit: FitResult) -> str:
    if not fit.model.speed_dependent or len(groups_of(fit)) > 1:
        return ""
    onset = fit.threshold_of(0)
    value, error = with_error(onset.value * RPM, onset.stderr * RPM)
    return f"{value} ± {error}" if error != "–" else value


def reproduce_section(material: ReportInput) -> Html:
    """Versions and settings."""
    from rotorfit import __version__

    fit = material.fit
    packages = ["casadi", "numpy", "scipy", "matplotlib", *(["emcee"] if material.posterior is not None else [])]
    versions = [f"rotorfit {__version__}", f"Python {platform.python_version()}"]
    versions += [f"{name} {version(name)}" for name in packages]
    calls = "\n".join(_calls(fit))
    outcome = f"{fit.method}: {fit.message}; {fit.nfev} evaluations of the model."
    return section(
        "To reproduce",
        element("pre", calls),
        paragraph(outcome[:1].upper() + outcome[1:]),
        paragraph(", ".join(versions), "."),
    )


def _calls(fit: FitResult) -> Iterator[str]:
    settings = fit.settings
    options = ", ".join(f"{name}={_shown(value)}" for name, value in fit.model.options().items())
    yield "import rotorfit as rf"
    sources = [f"rf.read({e.source!r})" if e.source else "data_in_memory" for e in fit.experiments]
    yield f"model = rf.models.{type(fit.model).__name__}({options})"
    yield f"experiments = [{', '.join(sources)}]"
    call = "rf.closed_form" if fit.method == "closed form" else "rf.fit"
    parts = [f"known={_shown(dict(settings.known))}"]
    parts += [f"{n}={_shown(dict(v))}" for n, v in (("bounds", settings.bounds), ("per", settings.per)) if v]
    if settings.priors:
        shown = ", ".join(f"{name!r}: {_distribution(prior)}" for name, prior in settings.priors.items())
        parts.append(f"priors={{{shown}}}")
    if call == "rf.fit":
        parts.append(f"loss={settings.loss!r}")
        parts += ["phase_offsets=True"] if settings.phase_offsets else []
    yield f"fit = {call}(model, experiments, {', '.join(parts)})"


def _shown(value: Any) -> str:
    """A setting as Python would write it; large arrays by their shape."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k!r}: {_shown(v)}" for k, v in value.items()) + "}"
    if isinstance(value, np.ndarray):
        return f"<array {' × '.join(map(str, value.shape))}>"
    return repr(value)


def _distribution(prior: Any) -> str:
    words = [f"{v:g}" for v in prior.args] + [f"{k}={v:g}" for k, v in prior.kwds.items()]
    return f"scipy.stats.{prior.dist.name}({', '.join(words)})"
