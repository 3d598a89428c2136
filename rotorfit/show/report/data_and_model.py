"""Sections of the report on the test, the data, the model and its structural refinement."""

from __future__ import annotations

import math

from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.identify.fitting.structure.refine import structure_name
from rotorfit.lab.data.rows import Experiment
from rotorfit.models import Constant
from rotorfit.models.motion.equation_text import stiffness_entries, to_mathml
from rotorfit.show.report.html import Html, element, paragraph, table
from rotorfit.show.report.material import ReportInput
from rotorfit.show.report.numbers import plain, speeds_in_words, with_error
from rotorfit.show.report.parts import section

_FROM_READINGS = (
    "The noise was taken from the sigma given with the data, else estimated without a model from repeated sweeps, from "
    "the component against the direction of the force, or from the smoothness of the responses."
)
_FROM_MOUNTINGS = (
    "All weights were solved together, speed by speed, for what each plane's weight adds to each reading; the noise is "
    "that of mountings and repeats about this, estimated by restricted maximum likelihood."
)


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
    weights = (
        " Misfit over noise (redchi) refers to it. Weights and standard errors of this structure, the best of a "
        "refinement, follow the residuals of each response instead, which show its own noise better."
        if fit.settings.noise_scale
        else " Misfit over noise (redchi) and standard errors refer to it; the residuals of the fit have no part in it."
    )
    count = f"{fit.ndata} real data (two for each complex reading) and {fit.nvarys} fitted values."
    balanced = any(test.synchronous for test in fit.experiments)
    mounted = balanced and any(block.remarks for block in fit.problem.blocks)
    content.append(paragraph(f"{count} {_FROM_MOUNTINGS if mounted else _FROM_READINGS}{weights}"))
    return section("Test and data", *content)


def _experiment_row(test: Experiment) -> list[str]:
    w = test.frequencies * RPM_PER_RAD_S
    span = f"{plain(float(w.min()), 5)} to {plain(float(w.max()), 5)} rpm" if w.size else ""
    source, counts = test.source or "data in memory", (str(len(test)), str(len(test.runs)))
    forced, measured = ", ".join(test.forces or test.force_planes), ", ".join(test.probes)
    return [source, test.kind, *counts, speeds_in_words(test.set_speed), span, forced, measured]


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
    axes = {"z": "displacement", "r": "slope", "x": "x", "y": "y"}
    content = [
        paragraph(
            f"Model “{model.name}” with coordinates ",
            ", ".join(f"{axes[c.axis]} at {c.plane}" for c in model.coordinates),
            f"; A are the responses and F the forces ({frame}). Ω is the rotative speed.",
        ),
        _equation(general),
    ]
    if model.shaft is not None:
        content.append(paragraph("To the entries below the condensed dynamic stiffness of the known shaft is added."))
    changing = [fluid for fluid in model.fluids if fluid.law.of_eccentricity] if "law" in model.options() else []
    for fluid in changing:
        first = (type(fluid.law).__doc__ or "").partition("\n")[0].replace("``", "")
        content.append(
            paragraph(
                f"{', '.join(f'{name}{fluid.ending}' for name in ('K0', 'D'))} and lam{fluid.ending} below stand for "
                f"functions of the eccentricity eps of the journal at {fluid.plane}, its displacement over the "
                f"clearance of {plain(1e6 * (model.clearance_at(fluid.plane) or math.nan), 4)} µm. "
                f"{fluid.law.name} law: {first}"
            )
        )
    if changing:
        model = model.variant(law=Constant(), clearance_um=None)
    written_out = 4  # coordinates up to which the dynamic stiffness matrix is written out
    if len(model.coordinates) > written_out:
        content.append(paragraph("The matrix is too large to be written out here."))
    else:
        for i, row in enumerate(stiffness_entries(model), 1):
            for k, entry in enumerate(row, 1):
                left = f"<msub><mi>κ</mi><mrow><mn>{i}</mn><mn>{k}</mn></mrow></msub><mo>=</mo>"
                right = to_mathml(entry.direct, model.parameter_names)
                if entry.quadrature:
                    quadrature = to_mathml(entry.quadrature, model.parameter_names)
                    right = right + "<mo>+</mo>" if entry.direct else ""
                    right += f"<mi>j</mi><mrow><mo>[</mo>{quadrature}<mo>]</mo></mrow>"
                content.append(_equation(left + right))
    return section("Model", *content, folded=True)


def _equation(inner: str) -> Html:
    return element("div", element("math", Html(f"<mrow>{inner}</mrow>")), class_="equation")


# ---- refinement -----------------------------------------------------------------------------


def refinement_section(material: ReportInput) -> Html:
    """Forward selection of structural blocks."""
    refinement = material.refinement
    if refinement is None:
        return Html("")
    rows = []
    for step in refinement.candidates:
        threshold = ""
        if step.model.speed_dependent and len(step.thetas) == 1:
            onset = step.threshold_of(0)
            value, error = with_error(onset.value * RPM_PER_RAD_S, onset.stderr * RPM_PER_RAD_S)
            threshold = f"{value} ± {error}" if error != "–" else value
        numbers = str(step.nvarys), plain(step.redchi, 4), f"{step.aic:.1f}", threshold
        rows.append([structure_name(step.model), *numbers, "chosen" if step is refinement.best else ""])
    words = (
        "Structural blocks that a lumped model leaves out (coupling mass, gyroscopic, damping between and within, "
        "out-of-band modes) were added one block at a time. Of the candidates with indistinguishable AIC, the simplest "
        "is chosen."
    )
    again = " The chosen model was then fitted again, each response weighted by its residuals; its row is that fit."
    words += again if refinement.best.settings.noise_scale else ""
    if material.fit is not refinement.best:
        words += " This report is not of the chosen model."
    head = ["structure", "fitted values", "redchi", "AIC", "threshold, rpm", ""]
    return section("Structural refinement", paragraph(words), table(head, rows, numeric=(1, 2, 3, 4)), folded=True)
