"""What a study writes: summary, tables, files that read back, report and figures in its folder; its numbers as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.apps.study_files.data_files import DataFile, RecordingFiles, StudyProgress
from rotorfit.apps.study_files.study import Outcome
from rotorfit.apps.study_files.text import summary
from rotorfit.base.array_types import Float
from rotorfit.base.significance import CHANCE_ERRORS
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.blocks.observations import Block
from rotorfit.identify.fitting.propagation import stderr_of
from rotorfit.identify.fitting.quantities import FittedParameter
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.structure.coefficients import measured_by_frequency, of_a_rig
from rotorfit.identify.fitting.structure.law_ranking import LawComparison
from rotorfit.identify.fitting.structure.modes import own_modes
from rotorfit.identify.uncertainty.predict import rotor_changes
from rotorfit.lab.io.tables.result_tables import frame_csv, records_csv, rows_csv
from rotorfit.show.report.material import FigureFormat


def write_outcome(
    outcome: Outcome,
    folder: Path,
    progress: StudyProgress,
    rig: str = "",
    figure_format: FigureFormat = "png",
    interactive: bool = False,
) -> tuple[str, ...]:
    """Write tables and files that read back, of a study, into a folder, then its figures and report. Where there is no
    room for these, the sentence that is returned says so and the others stay."""
    best = outcome.best
    progress("writing tables")
    (folder / "summary.txt").write_text(summary(outcome, rig) + "\n", encoding="utf-8")
    _write_csv(folder / "parameters.csv", _parameter_rows(outcome))
    entries = [i for i, name in enumerate(best.var_names) if name in best.params and best.params[name].resolved]
    names = [best.var_names[i] for i in entries]
    covariance = ((name, *best.covar[i, entries].tolist()) for i, name in zip(entries, names, strict=True))
    _write_csv(folder / "covariance.csv", (("", *names), *covariance))
    quality = ("response", "readings", "nrmse", "frac", "redchi")
    responses = ((r.name, r.count, r.nrmse, r.frac, r.redchi) for r in best.responses)
    _write_csv(folder / "responses.csv", (quality, *responses))
    _write_csv(folder / "curves.csv", _curve_rows(best))
    if outcome.ranking is not None:
        (folder / "law_comparison.csv").write_text(records_csv(_law_rows(outcome.ranking)), encoding="utf-8")
    if of_a_rig(best):
        table = best.coefficient_table()
        table.to_csv(folder / "coefficients.csv")
        (folder / "coefficients_ross.csv").write_text(frame_csv(table.for_ross()), encoding="utf-8")
        if _of_frequency(best):
            best.frequency_coefficients().to_csv(folder / "frequency_coefficients.csv")
    modes = own_modes(best)
    if modes is not None:
        _write_csv(folder / "modes.csv", modes.numbers())
    best.save(folder / "fit.json")
    write_uncertainty(outcome, folder)
    written = set(folder.iterdir())
    try:
        _draw(outcome, folder, progress, figure_format, interactive)
    except OSError as problem:
        for file in set(folder.iterdir()) - written:
            file.unlink()
        return (f"figures and report were not written, tables and fit.json were: {problem.strerror or problem}",)
    return ()


def _of_frequency(fit: FitResult) -> bool:
    """True if coefficients are told apart by frequency too."""
    return fit.model.frame != "z" and measured_by_frequency(fit)


def _draw(
    outcome: Outcome, folder: Path, progress: StudyProgress, figure_format: FigureFormat, interactive: bool
) -> None:
    """Write figures and report."""
    from rotorfit.show.report.write import write_report

    best = outcome.best
    progress("drawing the report")
    write_report(
        best,
        folder / "report.html",
        figures=folder,
        figure_format=figure_format,
        interactive=interactive,
        **_report_parts(outcome, progress),
    )


UNCERTAINTY_FILES = ("profiles.csv", "bootstrap.csv", "posterior.nc")
"""Files that hold what a study asks for beside the fit."""


def write_uncertainty(outcome: Outcome, folder: Path) -> None:
    """Write profiles, estimates from simulated tests and the posterior, as far as the study has them."""
    if outcome.profiles:
        pairs = ((p, *pair) for p in outcome.profiles for pair in zip(p.values.tolist(), p.rise.tolist(), strict=True))
        rows = ((p.name, p.unit, value, rise) for p, value, rise in pairs)
        _write_csv(folder / "profiles.csv", (("parameter", "unit", "value", "rise_of_chi_squared"), *rows))
    if outcome.bootstrap is not None:
        _write_csv(folder / "bootstrap.csv", (outcome.bootstrap.names, *outcome.bootstrap.samples.tolist()))
    if outcome.posterior is not None:
        outcome.posterior.save(folder / "posterior.nc")


def report_text(outcome: Outcome, progress: StudyProgress) -> str:
    """The report as it would be written."""
    from rotorfit.show.report.material import ReportInput
    from rotorfit.show.report.write import document, shares_of, title_of

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
        "command": outcome.command,
        "reading": {str(file.path): _read_with(file) for file in outcome.study.files},
    }


def _read_with(file: DataFile | RecordingFiles) -> dict[str, Any]:
    """Options that a file was read with, by name."""
    if isinstance(file, DataFile):
        return dict(file.options)
    return {name: value for name in ("where", "exclude", "casing", "stator") if (value := getattr(file, name))}


def _write_csv(path: Path, rows: Iterable[Sequence[Any]]) -> None:
    path.write_text(rows_csv(rows), encoding="utf-8")


def status(p: FittedParameter) -> str:
    """How a parameter came to its value, in a word or two for tables."""
    if not p.vary:
        return "known"
    if not p.determined:
        return p.shown().value
    return "at its bound" if p.at_bound else "fitted"


def closed_value(outcome: Outcome, name: str) -> float | None:
    """The closed form's value of a parameter, ``None`` where it has none."""
    if isinstance(outcome.closed, str) or name not in outcome.closed.params:
        return None
    p = outcome.closed.params[name]
    return p.value if p.resolved else None


def _parameter_rows(outcome: Outcome) -> Iterator[Sequence[Any]]:
    shares = ("stderr", "noise", "bounded", "trust", "low", "high", "largest_on_trust", "plain")
    yield "parameter", "value", "unit", *shares, "status", "closed_form", "meaning"
    for p in outcome.best.params.values():
        largest = "" if p.error is None else p.error.largest_on_trust
        numbers = (p.stderr, p.noise, p.bounded, p.trust, *p.interval(0.95), largest, p.plain)
        shown: tuple[Any, ...] = (p.value, p.unit, *numbers) if p.resolved else ("", p.unit, *[""] * len(shares))
        closed = closed_value(outcome, p.name)
        yield p.name, *shown, status(p), "" if closed is None else closed, p.meaning


def _law_rows(ranking: LawComparison) -> list[dict[str, Any]]:
    """The laws of a ranking; what was not fitted is ``None``."""
    return [
        {"law": repr(entry.law), "fitted": entry.count, "redchi": None if entry.fit is None else entry.fit.redchi}
        | {name: getattr(entry, name) for name in ("aic", "bic", "weight", "reason")}
        for entry in ranking.laws
    ]


def _curve_rows(fit: FitResult) -> Iterator[Sequence[Any]]:
    """Every reading with what the fit has there, in the model's coordinates and SI units."""
    parts = [f"{what}_{part}" for what in ("measured", "fitted", "fitted_low", "fitted_high") for part in ("re", "im")]
    yield "run", "response", "speed_rad_s", "frequency_rad_s", *parts, "sigma", "residual_re", "residual_im"
    space = fit.problem.space
    begin = 0
    whitened = fit.problem.residuals(fit.x)
    _, rows = fit.problem.jacobian(fit.x)
    for block, predicted in zip(fit.problem.blocks, fit.problem.predict(fit.x), strict=True):
        here = slice(begin, begin + block.measured.size)
        begin = here.stop
        mixed = not block.independent  # residuals are mixed then: errors of predictions come from these
        slope = block.predict_jacobian(fit.thetas)[1] if mixed else rows[here] * block.sigma[:, None]
        if mixed:
            slope = np.array(
                [space.pull_back(one, group) for one, group in zip(slope, block.reading_group, strict=True)]
            )
        moved = rotor_changes(fit, block)  # as bands of predictions are
        half = [
            CHANCE_ERRORS * stderr_of(fit, *parts) for parts in ((slope.real, moved.real), (slope.imag, moved.imag))
        ]
        speed, frequency = _conditions(block)
        low, high = predicted - half[0] - 1j * half[1], predicted + half[0] + 1j * half[1]
        values = [part for z in (block.measured, predicted, low, high) for part in (z.real, z.imag)]
        columns = [speed, frequency, *values, block.sigma, whitened[here].real, whitened[here].imag]
        names = np.array(block.labels)[block.label]
        for run, name, *numbers in zip(block.run, names, *(column.tolist() for column in columns), strict=True):
            yield str(run), str(name), *numbers


def _conditions(block: Block) -> tuple[Float, Float]:
    """Speed and frequency of each reading, rad/s, NaN where a kind of test has none."""
    base: Any = block.responses or block
    line = getattr(base, "line", None)
    lines = line if isinstance(line, np.ndarray) and line.dtype.kind == "i" else slice(None)
    found = [
        np.asarray(getattr(base, name, np.full(block.measured.size, np.nan)), float) for name in ("speed", "frequency")
    ]
    speed, frequency = (values[lines] if values.size != block.measured.size else values for values in found)
    return speed, frequency


# ---- JSON --------------------------------------------------------------------------------------


def outcome_values(outcome: Outcome) -> dict[str, Any]:
    """The numbers of a study for JSON; what the data do not determine is null."""
    best, bootstrap, posterior = outcome.best, outcome.bootstrap, outcome.posterior

    def some(of: Any, *names: str) -> dict[str, Any]:
        return {name: getattr(of, name) for name in names}

    numbers = ("value", "stderr", "noise", "bounded", "trust", "plain")
    parameters = {
        p.name: {
            **(some(p, *numbers) if p.resolved else dict.fromkeys(numbers)),
            "interval_95": p.interval(0.95) if p.resolved else None,
            "largest_on_trust": None if p.error is None else p.error.largest_on_trust,
            **some(p, "systematic", "unit"),
            "status": status(p),
            "closed_form": closed_value(outcome, p.name),
        }
        for p in best.params.values()
    }
    sampled = (
        None
        if posterior is None
        else {
            **some(posterior, "converged", "message", "treatment", "seed"),
            "interval_95": {name: posterior.interval(name) for name in posterior.names},
        }
    )
    return {
        "model": best.model.name,
        "files": [str(path) for file in outcome.study.files for path in file.paths],
        "out": None if outcome.study.out is None else str(outcome.study.out),
        **some(best, "success", "message", "redchi", "aic", "bic"),
        "blocks": list(getattr(best.model, "blocks", ())),
        **({} if outcome.ranking is None else {"laws": _law_rows(outcome.ranking), "verdict": outcome.ranking.verdict}),
        "parameters": parameters,
        "threshold_rpm": _threshold(best),
        "profiles": {p.name: some(p, "lower", "upper", "level", "message") for p in outcome.profiles},
        "bootstrap": None if bootstrap is None else some(bootstrap, "seed", "failures", "stderr"),
        "posterior": sampled,
        "unresolved": list(best.identifiability.unresolved),
        "findings": [[str(f) for f in found] for found in outcome.findings],
        "warnings": [one.message for one in best.notices],
    }


def _threshold(fit: FitResult) -> dict[str, float | None] | None:
    if not fit.model.speed_dependent or fit.problem.space.index.shape[0] > 1:
        return None
    onset = fit.threshold_speed()
    if not (math.isfinite(onset.value) and math.isfinite(onset.stderr)):
        return None
    shares = {"value": onset.value, "stderr": onset.stderr, "systematic": onset.systematic}
    return {name: share * RPM_PER_RAD_S for name, share in shares.items()}
