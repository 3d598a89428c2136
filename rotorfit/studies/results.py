"""Files that a study writes into its folder: summary, tables, files that read back, report and figures."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.fitting.quantities import FittedParameter
from rotorfit.fitting.result import FitResult
from rotorfit.fitting.structure.coefficients import of_a_rig
from rotorfit.io.tables.cells import as_text
from rotorfit.studies.data_files import StudyProgress
from rotorfit.studies.recording_files import RecordingFiles
from rotorfit.studies.study import Outcome
from rotorfit.studies.text import summary

if TYPE_CHECKING:
    from rotorfit.report.material import FigureFormat
    from rotorfit.uncertainty.profile import Profile


def write_outcome(
    outcome: Outcome, folder: Path, progress: StudyProgress, rig: str = "", figure_format: FigureFormat = "png"
) -> None:
    """Write report, tables, figures and files that read back, of a study, into a folder."""
    from rotorfit.report.write import write_report

    best = outcome.best
    progress("writing tables")
    (folder / "summary.txt").write_text(summary(outcome, rig) + "\n", encoding="utf-8")
    _write_csv(folder / "parameters.csv", _parameter_rows(outcome))
    _write_csv(folder / "covariance.csv", _covariance_rows(best))
    _write_csv(folder / "responses.csv", _response_rows(best))
    if of_a_rig(best):
        best.coefficient_table().to_csv(folder / "coefficients.csv")
        best.plot_coefficients().savefig(folder / f"coefficients.{figure_format}")
    if outcome.profiles:
        _write_csv(folder / "profiles.csv", _profile_rows(outcome.profiles))
    if outcome.bootstrap is not None:
        _write_csv(folder / "bootstrap.csv", (outcome.bootstrap.names, *outcome.bootstrap.samples.tolist()))
    best.save(folder / "fit.json")
    if outcome.posterior is not None:
        outcome.posterior.save(folder / "posterior.nc")
    progress("drawing the report")
    write_report(
        best,
        folder / "report.html",
        figures=folder,
        figure_format=figure_format,
        **_report_parts(outcome, progress),
    )


def report_text(outcome: Outcome, progress: StudyProgress) -> str:
    """The report as it would be written."""
    from rotorfit.report.material import ReportInput
    from rotorfit.report.write import document, shares_of, title_of

    best = outcome.best
    return document(ReportInput(fit=best, shares=shares_of(best), **_report_parts(outcome, progress)), title_of(best))


def _report_parts(outcome: Outcome, progress: StudyProgress) -> dict[str, Any]:
    """All that a study has for its report beside the fit."""
    recorded = [files for files in outcome.study.files if isinstance(files, RecordingFiles)]
    return {
        "refinement": outcome.refinement,
        "findings": outcome.findings,
        "posterior": outcome.posterior,
        "profiles": outcome.profiles,
        "bootstrap": outcome.bootstrap,
        "recordings": [record for files in recorded for record in files.open(progress)],
        "turns": next((files.windows for files in recorded), None),
    }


def _write_csv(path: Path, rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([as_text(cell) for cell in row] for row in rows)


def status(p: FittedParameter) -> str:
    """How a parameter came to its value, in a word or two for tables."""
    if not p.vary:
        return "known"
    if not p.resolved:
        return "not determined"
    return "at its bound" if p.at_bound else "fitted"


def closed_value(outcome: Outcome, name: str) -> float | None:
    """The closed form's value of a parameter, ``None`` where it has none."""
    if isinstance(outcome.closed, str) or name not in outcome.closed.params:
        return None
    p = outcome.closed.params[name]
    return p.value if p.resolved else None


def _parameter_rows(outcome: Outcome) -> Iterator[Sequence[Any]]:
    yield "parameter", "value", "stderr", "stderr_noise", "unit", "status", "closed_form", "meaning"
    for p in outcome.best.params.values():
        numbers = ("", "", "") if not p.resolved else (p.value, p.stderr, p.stderr_noise)
        closed = closed_value(outcome, p.name)
        yield p.name, *numbers, p.unit, status(p), "" if closed is None else closed, p.meaning


def _covariance_rows(fit: FitResult) -> Iterator[Sequence[Any]]:
    entries = [i for i, name in enumerate(fit.var_names) if name in fit.params]
    resolved = [i for i in entries if fit.params[fit.var_names[i]].resolved]
    yield "", *[fit.var_names[i] for i in resolved]
    for i in resolved:
        yield fit.var_names[i], *fit.covar[i, resolved].tolist()


def _response_rows(fit: FitResult) -> Iterator[Sequence[Any]]:
    yield "response", "readings", "nrmse", "frac", "redchi"
    for r in fit.responses:
        yield r.name, r.count, r.nrmse, r.frac, r.redchi


def _profile_rows(profiles: Sequence[Profile]) -> Iterator[Sequence[Any]]:
    yield "parameter", "unit", "value", "rise_of_chi_squared"
    for p in profiles:
        for value, rise in zip(p.values.tolist(), p.rise.tolist(), strict=True):
            yield p.name, p.unit, value, rise
