"""What the command line prints and writes: summary, tables, figures, all moved into the folder only when complete."""

from __future__ import annotations

import csv
import json
import math
import os
import tempfile
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit import datasets
from rotorfit.data.experiments import Experiment, PerturbationTest
from rotorfit.fitting.digits import interval, plus_minus, with_error
from rotorfit.fitting.quantities import FittedParameter
from rotorfit.fitting.result import FitResult
from rotorfit.studies.study import Outcome, StudyProgress
from rotorfit.studies.wording import spoken
from rotorfit.text_table import text_table
from rotorfit.uncertainty.budget import Budget
from rotorfit.units import RPM_PER_RAD_S

if TYPE_CHECKING:
    from rotorfit.data.findings import Finding
    from rotorfit.report.material import FigureFormat
    from rotorfit.uncertainty.bootstrap import Bootstrap
    from rotorfit.uncertainty.posterior import Posterior
    from rotorfit.uncertainty.profile import Profile

CHECKPOINT = "posterior.checkpoint.h5"
"""File in the folder for the results from which a sampling that was stopped goes on."""


@contextmanager
def complete_folder(out: Path) -> Iterator[Path]:
    """A temporary folder whose files move into ``out`` when the block ends well; otherwise nothing is left behind.

    Raises:
        OSError: ``out`` is a file, or its place cannot be written to.
    """
    for above in (out, *out.parents):
        if above.exists() and not above.is_dir():
            raise NotADirectoryError(f"{above} is a file; give a folder for the results")
    place = next(folder for folder in (out.absolute(), *out.absolute().parents) if folder.is_dir())
    try:  # on the file system of the folder itself, so that moving is renaming
        temporary = tempfile.TemporaryDirectory(prefix=".rotorfit-", dir=place)
    except OSError as reason:
        raise PermissionError(f"cannot write to {place}: {reason.strerror}; give another folder") from reason
    with temporary as name:
        yield Path(name)
        out.mkdir(parents=True, exist_ok=True)
        for file in sorted(Path(name).iterdir()):
            os.replace(file, out / file.name)


@contextmanager
def kept_checkpoint(out: Path) -> Iterator[Path]:
    """The sampler's checkpoint in ``out``: kept when the run is stopped, gone when it is complete.

    Raises:
        KeyboardInterrupt: as it came, with the words that tell how to go on.
        OSError: ``out`` cannot be made.
    """
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    out.mkdir(parents=True, exist_ok=True)
    path = out / CHECKPOINT
    try:
        yield path
        path.unlink(missing_ok=True)
    except KeyboardInterrupt as stop:
        if not path.exists():
            raise
        raise KeyboardInterrupt(f"the same command goes on from {path}") from stop
    finally:
        for folder in made:
            if not any(folder.iterdir()):
                folder.rmdir()


def write_outcome(
    outcome: Outcome, folder: Path, progress: StudyProgress, rig: str = "", figure_format: FigureFormat = "png"
) -> None:
    """Write report, tables, figures and files that read back, of a study, into a folder.

    Args:
        outcome: what the study gave.
        folder: an existing folder.
        progress: called with a few words for every step.
        rig: name of the data set whose truth is compared with.
        figure_format: of the figures' files.
    """
    from rotorfit.report.write import write_report

    best = outcome.best
    progress("writing tables")
    (folder / "summary.txt").write_text(summary(outcome, rig) + "\n", encoding="utf-8")
    _write_csv(folder / "parameters.csv", _parameter_rows(outcome))
    _write_csv(folder / "covariance.csv", _covariance_rows(best))
    _write_csv(folder / "responses.csv", _response_rows(best))
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
        refinement=outcome.ladder,
        findings=outcome.findings,
        posterior=outcome.posterior,
        profiles=outcome.profiles,
        bootstrap=outcome.bootstrap,
        figures=folder,
        figure_format=figure_format,
    )


def _write_csv(path: Path, rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows(rows)


def _status(p: FittedParameter) -> str:
    if not p.vary:
        return "known"
    if not p.resolved:
        return "not determined"
    return "at its bound" if p.at_bound else "fitted"


def _closed_value(outcome: Outcome, name: str) -> float | None:
    if isinstance(outcome.closed, str) or name not in outcome.closed.params:
        return None
    p = outcome.closed.params[name]
    return p.value if p.resolved else None


def _parameter_rows(outcome: Outcome) -> Iterator[Sequence[Any]]:
    yield "parameter", "value", "stderr", "stderr_noise", "unit", "status", "closed_form", "meaning"
    for p in outcome.best.params.values():
        numbers = ("", "", "") if not p.resolved else (p.value, p.stderr, p.stderr_noise)
        closed = _closed_value(outcome, p.name)
        yield p.name, *numbers, p.unit, _status(p), "" if closed is None else closed, p.meaning


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


# ---- text -------------------------------------------------------------------------------------


def summary(outcome: Outcome, rig: str = "") -> str:
    """Data, check, fit and refinement as text for a terminal, and the truth of a simulated rig if one is named."""
    best = outcome.best
    parts = [f"ERROR in the data, no number below can be relied on: {message}" for message in outcome.data_errors]
    parts += [
        "\n".join(
            describe_test(experiment, findings)
            for experiment, findings in zip(outcome.experiments, outcome.findings, strict=True)
        )
    ]
    if isinstance(outcome.closed, str):
        parts.append(f"no closed form: {outcome.closed}")
    else:
        parts.append(_comparison(outcome.closed, outcome.fit))
    parts.append(outcome.fit.summary())
    if outcome.ladder is not None:
        parts.append("structural refinement\n" + outcome.ladder.table())
        if outcome.ladder.best is not outcome.fit:
            parts.append(outcome.ladder.best.summary())
    if best.settings.calibration is not None:
        parts.append(str(Budget(best, best.settings.calibration)))
    if outcome.profiles:
        parts.append("profile likelihoods\n" + "\n".join(map(str, outcome.profiles)))
    parts += [str(more) for more in (outcome.bootstrap, outcome.posterior) if more is not None]
    if outcome.posterior is not None and best.model.speed_dependent and len(best.problem.space.index) == 1:
        onset = outcome.posterior.threshold_speed()
        ends = interval(*(float(end) * RPM_PER_RAD_S for end in onset.interval(0.95)))
        note = f"; {onset.note}" if onset.note else ""
        parts.append(f"threshold speed in rpm, 95 % of the posterior: {ends}{note}")
    if rig:
        parts.append(truth_table(outcome, rig))
    return spoken("\n\n".join(parts))


def describe_test(test: Experiment, findings: Sequence[Finding]) -> str:
    """What a file holds, in a few lines, and what the data check found."""
    speeds = np.unique(np.round(test.speed * RPM_PER_RAD_S, 3))
    span = f"{speeds[0]:g} to {speeds[-1]:g} rpm" if speeds.size > 4 else ", ".join(f"{s:g}" for s in speeds) + " rpm"
    w = test.frequencies * RPM_PER_RAD_S
    kind = test.title
    lines = []
    if isinstance(test, PerturbationTest):
        kind = "synchronous test" if test.synchronous else kind
        lines.append(f"  forced at    {', '.join(test.forces)}")
        lines.append(f"  measured at  {', '.join(_channels(test))}")
    elif test.planes:
        lines.append(f"  measured at  {', '.join(test.planes)}")
    lines = [
        f"{test.source or 'data'}: {kind}, {test.size_in_words}",
        *lines,
        f"  speed        {span}",
    ]
    if w.size:
        turning = "" if (w > 0).all() or (w < 0).all() else " (negative: backward whirl)"
        lines.append(f"  frequency    {w.min():.5g} to {w.max():.5g} rpm{turning}")
    if test.attributes:
        lines.append(f"  attributes   {', '.join(test.attributes)}")
    lines += [f"  check: {finding}" for finding in findings] or ["  check: nothing found"]
    return spoken("\n".join(lines))


def _channels(test: PerturbationTest) -> list[str]:
    pairs = dict.fromkeys(zip(test.plane.tolist(), test.direction.tolist(), strict=True))
    return [f"{plane} {direction}" for plane, direction in pairs]


def _comparison(closed: FitResult, fit: FitResult) -> str:
    rows = [["", "closed form", "optimised", ""]]
    for p in fit.params.values():
        if p.vary and p.resolved and p.name in closed.params:
            first = closed.params[p.name]
            cells = with_error(first.value, first.stderr)[0], with_error(p.value, p.stderr)[0]
            rows.append([p.name, *cells, p.unit])
    rows.append(["redchi", f"{closed.redchi:.6g}", f"{fit.redchi:.6g}"])
    return "\n".join(text_table(rows, "<22 >14 >14 <1"))


def truth_table(outcome: Outcome, rig: str) -> str:
    """The fluid's parameters and the threshold speed beside those a simulated rig was made with."""
    truth = datasets.truth(rig)
    results = {"closed form": outcome.closed, "optimised": outcome.fit}
    if outcome.ladder is not None:
        results["refined"] = outcome.ladder.best
    fits = {name: fit for name, fit in results.items() if not isinstance(fit, str)}
    rows = [["", "truth", *fits, ""]]
    for name in ("D", "lam", "Mf", "K0"):
        cells = [plus_minus(fit.params[name].value, fit.params[name].stderr) for fit in fits.values()]
        unit = outcome.fit.params[name].unit
        rows.append([name, f"{truth['params'][name]:g}", *cells, unit])
    onsets = [fit.threshold_speed() for fit in fits.values()]
    cells = [plus_minus(onset.value * RPM_PER_RAD_S, onset.stderr * RPM_PER_RAD_S) for onset in onsets]
    rows.append(["threshold speed", f"{truth['threshold_rpm']:.1f}", *cells, "rpm"])
    columns = " ".join(["<17 >10", *[">21"] * len(fits), "<1"])
    why = ["", *textwrap.wrap(_WHY_NOT_K0, 100)] if rig == "rig_open" else []  # the others are chains themselves
    return "\n".join(["against the rig's truth", *text_table(rows, columns), *why])


_WHY_NOT_K0 = (
    "K0 misses the truth in every column, and is no defect of the data: the shaft of this rig is finite elements, the "
    "model a chain of two masses, whose K0 takes up stiffness of the shaft that K1 and K2 have no place for. D, lam, "
    "Mf and the threshold hardly depend on how stiffness is shared out. With the shaft's matrices known "
    "(KnownStructure) K0 comes out right."
)


# ---- JSON -------------------------------------------------------------------------------------


def outcome_json(outcome: Outcome) -> str:
    """The numbers of a study as one JSON object; what the data do not determine is null."""
    best = outcome.best
    onset = _threshold(best)
    return json.dumps(
        {
            "model": best.model.name,
            "files": [str(path) for file in outcome.study.files for path in getattr(file, "paths", (file.path,))],
            "out": None if outcome.study.out is None else str(outcome.study.out),
            "success": best.success,
            "message": best.message,
            "redchi": _finite(best.redchi),
            "aic": _finite(best.aic),
            "bic": _finite(best.bic),
            "blocks": list(getattr(best.model, "blocks", ())),
            "parameters": {
                p.name: {
                    "value": _finite(p.value) if p.resolved else None,
                    "stderr": _finite(p.stderr) if p.resolved else None,
                    "stderr_noise": _finite(p.stderr_noise) if p.resolved else None,
                    "unit": p.unit,
                    "status": _status(p),
                    "closed_form": _closed_value(outcome, p.name),
                }
                for p in best.params.values()
            },
            "threshold_rpm": onset,
            "profiles": {
                p.name: {"lower": _finite(p.lower), "upper": _finite(p.upper), "level": p.level, "message": p.message}
                for p in outcome.profiles
            },
            "bootstrap": _bootstrap_json(outcome.bootstrap),
            "posterior": _posterior_json(outcome.posterior),
            "unresolved": list(best.identifiability.unresolved),
            "findings": [[str(f) for f in found] for found in outcome.findings],
            "warnings": list(best.warnings),
        },
        indent=1,
        allow_nan=False,
    )


def _bootstrap_json(bootstrap: Bootstrap | None) -> dict[str, Any] | None:
    if bootstrap is None:
        return None
    return {
        "seed": bootstrap.seed,
        "failures": bootstrap.failures,
        "stderr": {name: _finite(error) for name, error in bootstrap.stderr.items()},
    }


def _posterior_json(posterior: Posterior | None) -> dict[str, Any] | None:
    if posterior is None:
        return None
    return {
        "converged": posterior.converged,
        "message": posterior.message,
        "treatment": posterior.treatment,
        "seed": posterior.seed,
        "interval_95": {name: posterior.interval(name) for name in posterior.names},
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _threshold(fit: FitResult) -> dict[str, float | None] | None:
    if not fit.model.speed_dependent or fit.problem.space.index.shape[0] > 1:
        return None
    onset = fit.threshold_speed()
    if not (math.isfinite(onset.value) and math.isfinite(onset.stderr)):
        return None
    return {"value": onset.value * RPM_PER_RAD_S, "stderr": onset.stderr * RPM_PER_RAD_S}
