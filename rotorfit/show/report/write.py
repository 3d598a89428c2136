"""The report of a fit: one HTML file that needs nothing else, to read on a screen, to print and to hand on."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.base.units import in_rad_s
from rotorfit.estimators.misfit.parameter_space import DATUM
from rotorfit.identify.fitting.headline import rig_name, task_of
from rotorfit.identify.fitting.quantities import THRESHOLD
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.structure.refine import Refinement
from rotorfit.identify.uncertainty.bootstrap import Bootstrap
from rotorfit.identify.uncertainty.posterior import Posterior
from rotorfit.identify.uncertainty.profile import Profile
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.data.probes import at_common_zero
from rotorfit.show.report.html import Html
from rotorfit.show.report.material import LEVEL, FigureFormat, ReportInput
from rotorfit.show.report.page import page, write_whole

if TYPE_CHECKING:
    from rotorfit.lab.recordings.recording import Recording


def write_report(
    fit: FitResult,
    path: str | os.PathLike[str],
    *,
    posterior: Posterior | None = None,
    refinement: Refinement | None = None,
    findings: Sequence[Sequence[Finding]] | None = None,
    profiles: Sequence[Profile] = (),
    bootstrap: Bootstrap | None = None,
    shares: Mapping[str, tuple[float, float]] | None = None,
    operating_speed: float | None = None,
    operating_speed_rpm: float | None = None,
    title: str | None = None,
    figures: str | os.PathLike[str] | None = None,
    figure_format: FigureFormat = "png",
    recordings: Sequence[Recording] = (),
    turns: int | None = None,
    interactive: bool = False,
    command: str = "",
    reading: Mapping[str, Mapping[str, Any]] | None = None,
) -> Path:
    """Write the report of a fit as one self-contained HTML file, whole or not at all.

    Args:
        fit: the result to report.
        path: file to write; one that is there is replaced.
        posterior: samples, :meth:`FitResult.sample`.
        refinement: forward selection of structural blocks, see :func:`rotorfit.refine`.
        findings: what the data check found, one sequence for each experiment; by default the check is run.
        profiles: profile likelihoods of some parameters or of the threshold speed, :meth:`FitResult.profile`.
        bootstrap: fits of simulated data, :meth:`FitResult.bootstrap`.
        shares: standard uncertainty by the noise and by causes beside the model, by parameter, SI units; by default
            those of the fit.
        operating_speed: speed, rad/s, to which the stability margin refers beside the tested speeds.
        operating_speed_rpm: the same in rpm.
        title: heading of the report.
        figures: folder that is there, to which the figures are also written, each as a file; of responses that are
            too many for a page, all of them too.
        figure_format: of these files: png, pdf or svg; none leaves figures out of the report too.
        recordings: what the experiments were reduced from, to be shown with what was done to them.
        turns: as :func:`rotorfit.responses` was given it.
        interactive: with Bode plots to zoom and to point at; Bokeh's script makes the file some MB larger.
        command: what was typed for this fit; by default the command is worked out of the fit.
        reading: options of :func:`rotorfit.read` that files were read with, by the first of their paths.

    Returns:
        the path written.

    Raises:
        ValueError: names in ``profiles`` or ``shares`` that the fit does not have, findings that do not go with the
            experiments, profiles at another level than 95 %, a posterior of other parameters, Bokeh missing.
        TypeError: models averaged over as the posterior.
        OSError: the file cannot be written.

    Example:
        >>> rf.write_report(fit, folder / "report.html").name
        'report.html'
    """
    if findings is None:
        from rotorfit.identify.diagnosis.check import check

        datum = fit.params[DATUM].value if DATUM in fit.params else 0.0
        findings = [check(experiment) for experiment in at_common_zero(fit.experiments, datum)]
    material = ReportInput(
        fit=fit,
        posterior=posterior,
        refinement=refinement,
        findings=findings,
        profiles=profiles,
        bootstrap=bootstrap,
        shares=shares_of(fit) if shares is None else shares,
        operating_speed=in_rad_s("operating_speed", operating_speed, needed=False, rpm=operating_speed_rpm),
        figure_format=figure_format,
        recordings=recordings,
        turns=turns,
        interactive=interactive,
        command=command,
        reading=reading or {},
    )
    _check(material)
    text = document(material, title or title_of(fit))
    if figures is not None:
        from rotorfit.show.report.figures import whole_matrices

        for name, png in (*material.pictures.items(), *whole_matrices(material)):
            write_whole(Path(figures) / f"{name}.{figure_format}", png)
    return write_whole(Path(path), text.encode())


def title_of(fit: FitResult) -> str:
    """The heading that a report has unless it is given another."""
    return f"{rig_name(fit)}: {task_of(fit)}"


def shares_of(fit: FitResult) -> Mapping[str, tuple[float, float]]:
    """Shares of the standard error by the noise and by causes, by parameter."""
    return {name: (fit.params[name].noise, fit.params[name].systematic) for name in fit.problem.space.names}


def _check(material: ReportInput) -> None:
    fit = material.fit
    if material.interactive:
        from rotorfit.show.report.interactive import check_interactive

        check_interactive()
    if len(material.findings) != len(fit.experiments):
        raise ValueError(f"findings of {len(material.findings)} experiments, but the fit has {len(fit.experiments)}")
    given = {
        "profiles": [p.name for p in material.profiles if p.name not in (THRESHOLD, *fit.var_names)],
        "shares": [name for name in material.shares if name not in fit.params],
    }
    for where, unknown in given.items():
        if unknown:
            raise ValueError(f"{where}: the fit has no {', '.join(unknown)}; it has {', '.join(fit.params)}")
    for p in material.profiles:
        if p.level != LEVEL:
            raise ValueError(f"profile of {p.name}: its level is {p.level:g}, the report's intervals are at {LEVEL:g}")
    if material.posterior is not None and not hasattr(material.posterior, "fit"):
        raise TypeError(
            "posterior must be what fit.sample returns; of models averaged over report the most probable, "
            "write_report(average.posteriors[0].fit, path, posterior=average.posteriors[0])"
        )
    for what, other in (("posterior", material.posterior), ("bootstrap", material.bootstrap)):
        if other is not None and other.fit.var_names != fit.var_names:
            raise ValueError(
                f"{what} of {', '.join(other.fit.var_names)}, but the fit is of {', '.join(fit.var_names)}"
            )


def document(material: ReportInput, title: str) -> Html:
    """The whole page."""
    from rotorfit.show.report.budget import budget_section, causes_section
    from rotorfit.show.report.data_and_model import data_section, model_section, refinement_section
    from rotorfit.show.report.figures import coefficient_section, figure_sections
    from rotorfit.show.report.interactive import interactive_section
    from rotorfit.show.report.parameters import identifiability_section, interval_section, parameter_section
    from rotorfit.show.report.recorded import recordings_section
    from rotorfit.show.report.reproduce import reproduce_section
    from rotorfit.show.report.verdict import byline_of, notes_section, verdict_section

    interactive = [interactive_section(material.fit)] if material.interactive else []
    sections = [
        verdict_section(material),
        notes_section(material),
        coefficient_section(material),
        parameter_section(material),
        budget_section(material),
        causes_section(material),
        interval_section(material),
        identifiability_section(material),
        *interactive,
        *figure_sections(material),
        data_section(material),
        *recordings_section(material),
        model_section(material),
        refinement_section(material),
        reproduce_section(material),
    ]
    sources = ", ".join(dict.fromkeys(e.source or "data in memory" for e in material.fit.experiments))
    return page(title, f"{byline_of(material.fit)} · {sources}", sections, scripted=interactive)
