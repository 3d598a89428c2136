"""Sections of the report that are figures, with the tables that belong to them.

What draws is imported when it is called: matplotlib takes as long to load as a fit with its tables to write.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.base.atomic_file import file_name
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S, shown_units
from rotorfit.identify.fitting.headline import leads_of
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.structure.coefficients import measured_by_frequency, of_a_rig
from rotorfit.identify.fitting.structure.modes import own_modes
from rotorfit.identify.uncertainty.posterior import Posterior
from rotorfit.show.plots.figure_table import figures_of
from rotorfit.show.report.html import Html, element, join, paragraph, picture, table
from rotorfit.show.report.material import ReportInput
from rotorfit.show.report.numbers import plain, typeset, with_error
from rotorfit.show.report.parts import at_of, groups_of, note, section, sentence, symbol

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_SAYS_ITSELF = ("dynamic_stiffness", "bode", "polar", "residuals")
"""Figures that say below their titles how they are read."""


def figure_sections(material: ReportInput) -> list[Html]:
    """Stability, then the figures of the data, how well they are fitted, profiles, the posterior."""
    fit = material.fit
    of_seal = "coefficients" in leads_of(fit)
    found = [section("Stability", *_stability(material))] if not of_seal else []
    for figure in figures_of(fit) if material.figure_format != "none" else ():
        if of_seal and figure.name == "polar":  # of a stator with its rods, which says nothing of the seal
            continue
        words = figure.caption
        if fit.settings.solved is not None and "Points: measured" in words:
            words += " What causes beside the model were found to add is taken out of the points."
        shown = words if figure.name not in _SAYS_ITSELF else ""
        picture_in = embedded(material, figure.name, getattr(fit.plot, figure.name), words, caption=shown)
        found.append(section(figure.title, picture_in, figure=True))
    if fit.responses:
        found.append(section("Quality of fit", *_quality(fit), folded=True))
    if material.profiles:
        drawn = []
        for p in material.profiles:
            name = file_name(re.sub(r"\W+", "_", f"profile_{p.name}").rstrip("_"), material.pictures)
            caption = p.name.replace("_", " ") + (f". {p.message}" if p.message else "")
            drawn.append(embedded(material, name, p.plot, caption))
        found.append(section("Profile likelihoods", element("div", *drawn, class_="side")))
    if material.posterior is not None:
        found.append(section("Posterior", *_posterior(material, material.posterior)))
    return found


def coefficient_section(material: ReportInput) -> Html:
    """Of a seal or bearing alone its coefficients by condition, over speed, and as measured over frequency."""
    fit = material.fit
    found = fit.coefficient_table() if fit.success and of_a_rig(fit) else None
    if found is None or not found.rows:
        return Html("")
    tables = [
        table(head, [[own[0], *map(_set_apart, own[1:])] for own in rows], numeric=range(1, len(head)))
        for head, *rows in found.by_condition([row.condition for row in found.rows])
    ]
    words = "Coefficients against speed, a line a condition, with 95 % errors."
    figures = [embedded(material, "coefficients", fit.plot.coefficients, words, caption="")]
    if fit.model.frame != "z" and measured_by_frequency(fit):
        words = "Stiffness K − w² M and damping C along x and y against frequency, as measured and as fitted."
        figures.append(embedded(material, "frequency_coefficients", fit.plot.frequency_coefficients, words))
    return section("Coefficients", *tables, *figures)


def _set_apart(cell: str) -> str:
    """A printed value with its error as a page sets them; words as they are."""
    return " ± ".join(map(typeset, cell.split(" +- "))) if " +- " in cell else cell


def embedded(
    material: ReportInput, name: str, draw: Callable[[], Figure], words: str, *, caption: str | None = None
) -> Html:
    """Draw a figure, keep the file, embed it; nothing where figures are left out.

    ``words`` say what it shows where it cannot be seen, and below it unless there is another ``caption``.
    """
    if material.figure_format == "none":
        return Html("")
    from rotorfit.show.plots.style import picture_of

    figure = draw()
    png = picture_of(figure)
    material.pictures[name] = png if material.figure_format == "png" else picture_of(figure, material.figure_format)
    return picture(png, words, figure.get_figwidth(), words if caption is None else caption)


def whole_matrices(material: ReportInput) -> Iterator[tuple[str, bytes]]:
    """Files with all responses and the whole stiffness matrix, of a fit whose report shows a part of them."""
    fit = material.fit
    shown = [name for name in ("dynamic_stiffness", "bode", "polar") if name in material.pictures]
    if not shown:
        return
    from rotorfit.show.plots.style import picture_of
    from rotorfit.show.plots.sweeps import MOST_PANELS, curves

    if len({(c.coordinate, c.force_plane) for c in curves(fit)[1]}) <= MOST_PANELS:
        return
    for name in shown:
        yield f"{name}_all", picture_of(getattr(fit.plot, name)(every=True), material.figure_format)


def _quality(fit: FitResult) -> Iterator[Html]:
    from rotorfit.show.report.verdict import misfit_words

    rows = [
        [r.name, str(r.count), f"{plain(100 * r.nrmse, 3)} %", f"{r.frac:.6f}", plain(r.redchi, 3)]
        for r in fit.responses
    ]
    yield paragraph(misfit_words(fit))
    yield table(["response", "readings", "NRMSE", "FRAC", "redchi"], rows, numeric=(1, 2, 3, 4))
    words = (
        "NRMSE: rms residual over rms response. FRAC: frequency response assurance criterion, 1 for equal shape. "
        "redchi: mean squared residual over the noise's variance, 1 for noise alone."
    )
    yield note(words)


def _stability(material: ReportInput) -> Iterator[Html]:
    from rotorfit.show.report.verdict import threshold_table

    fit = material.fit
    for label, group in groups_of(fit):
        caption = "Modes of the fitted rotor against its speed" + (f", {label}." if label else ".")
        name = "stability" if group == 0 else f"stability_{group + 1}"

        def of_group(group: int = group) -> Figure:
            from rotorfit.show.plots.stability import plot_stability

            return plot_stability(fit, group=group)

        yield embedded(material, name, of_group, caption, caption=label)
    yield from threshold_table(material)
    rows = [row for label, group in groups_of(fit) for row in _mode_rows(fit, label, group)]
    unit = shown_units().rate_name
    head = ["group", "rotative speed, rpm", f"damped frequency, {unit}", "±", "damping ratio", "±"]
    if rows and not rows[0][0]:
        head, rows = head[1:], [row[1:] for row in rows]
    modes = table(head, rows, numeric=range(len(head) - 5, len(head)))
    yield from _criteria(material)
    own = own_modes(fit)  # modal masses, stiffnesses and shapes of a passive rotor
    if own is not None:
        yield element("h3", "Modes one by one")
        yield table(own.rows()[0], own.rows()[1:], numeric=range(1, len(own.rows()[0])))
        of_each = f"are those of each mode by itself, with a deflection of one at {next(iter(own[0].shape))}."
        words = f"Mass, stiffness and damping {of_each}"
        yield note(f"{words} Half-power: damping ratio by the width of the measured peaks.")
    yield element("details", element("summary", "Modes at the tested speeds"), modes)


def _criteria(material: ReportInput) -> Iterator[Html]:
    """The rotor judged at its running speed, or why it cannot be; nothing where it has no such speed."""
    fit, speed = material.fit, material.operating_speed
    top = float(fit.speeds.max(initial=0.0)) if speed is None else speed
    if not top or fit.model.turns or not fit.success or len(fit.thetas) > 1:
        return
    draws = fit if material.posterior is None else material.posterior
    where = "running speed" if speed is not None else "highest tested speed"
    title = element("summary", f"Criteria at the {where}, {significant(top * RPM_PER_RAD_S, 5)} rpm")
    try:
        found = draws.stability_report(max_speed_rpm=top * RPM_PER_RAD_S)
    except ValueError as refusal:  # such as of a fit to wrong data, whose stiffness vanishes
        yield element("details", title, note(sentence(str(refusal))))
        return
    head, *rows = found.rows()
    words = map(sentence, (*([found.caution] if found.caution else []), *found.remarks))
    yield element("details", title, table(head, rows, numeric=(1, 5)), note(*words))


def _mode_rows(fit: FitResult, label: str, group: int) -> Iterator[list[str]]:
    at = at_of(fit, group)
    speeds = fit.speeds if fit.model.speed_dependent else np.zeros(1)
    for speed in speeds.tolist():
        for frequency, damping, _ in fit.natural_frequencies(speed, at):
            shown = f"{speed * RPM_PER_RAD_S:.0f}" if fit.model.speed_dependent else "any"
            own = frequency.to(shown_units().rate_name)
            ends = with_error(own.value, own.stderr), with_error(damping.value, damping.stderr)
            yield [label, shown, *ends[0], *ends[1]]


def _posterior(material: ReportInput, posterior: Posterior) -> Iterator[Html]:

    def traces() -> Figure:
        from rotorfit.show.plots.uncertainty import corner_names, plot_traces

        shown = corner_names(posterior.names, posterior.samples)
        return plot_traces(posterior.chain[..., [posterior.names.index(name) for name in shown]], shown)

    caption = "Margins with their 95 % interval, regions of 68 and 95 % of pairs, and correlations."
    yield embedded(material, "corner", posterior.plot.corner, caption)
    yield element("h3", "Health of the chains")
    yield paragraph(sentence(posterior.message))
    yield paragraph(sentence(posterior.treatment))
    yield _health(posterior)
    yield embedded(material, "chains", traces, "Walkers' paths after burn-in.")


def _health(posterior: Posterior) -> Html:
    from rotorfit.identify.uncertainty.posterior_file import health

    rows = [
        [symbol(h.name, posterior.fit.model), f"{h.rhat:.3f}", f"{h.bulk:.0f}", f"{h.tail:.0f}", f"{tau:.1f}"]
        for h, tau in zip(health(posterior), posterior.tau.tolist(), strict=True)
    ]
    head = ["parameter", "split R-hat", "bulk ESS", "tail ESS", "autocorrelation time, steps"]
    settings, accepted = posterior.settings, 100 * float(posterior.acceptance.mean())
    words = (
        f"emcee with {settings.walkers} walkers, {settings.steps} steps of which {posterior.burn_in} burn-in, "
        f"{accepted:.0f} % of the proposals accepted, seed {posterior.seed}. R-hat is 1 for chains that agree; ESS: "
        "effective samples for the middle and for the tails of the distribution."
    )
    return join([table(head, rows, numeric=range(1, 5)), note(words)])
