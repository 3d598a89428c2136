"""A study in words for a terminal: data, check, fit and refinement, and the truth of a simulated rig."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

from rotorfit import datasets
from rotorfit.apps.study_files.study import Outcome
from rotorfit.base.array_types import Float
from rotorfit.base.digits import interval, plus_minus, significant, with_error
from rotorfit.base.text_table import text_table
from rotorfit.base.units import RPM_PER_RAD_S, shown_units
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.structure.coefficients import of_a_rig
from rotorfit.identify.fitting.summary import fit_table
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.data.rows import Experiment, short_source


def summary(outcome: Outcome, rig: str = "") -> str:
    """Data, check, fit and refinement as text for a terminal, and the truth of a simulated rig if one is named."""
    best = outcome.best
    errors = [f"ERROR in the data, no number below can be relied on: {message}" for message in outcome.data_errors]
    parts = ["\n".join([*errors, fit_table(best, [one for some in outcome.findings for one in some])])]
    parts.append("\n".join(map(describe_test, outcome.experiments, outcome.findings)))
    if isinstance(outcome.closed, str):
        parts.append(f"no closed form: {outcome.closed}")
    elif not of_a_rig(outcome.fit):  # whose coefficients stand above
        parts.append(_comparison(outcome.closed, outcome.fit))
    if outcome.ranking is not None:
        parts.append(f"laws of eccentricity\n{outcome.ranking}")
    if outcome.refinement is not None:
        parts.append(f"structural refinement\n{outcome.refinement}")
    if best.settings.calibration is not None:
        parts.append(str(best.budget()))
    if outcome.profiles:
        parts.append("profile likelihoods\n" + "\n".join(map(str, outcome.profiles)))
    parts += [str(more) for more in (outcome.bootstrap, outcome.posterior) if more is not None]
    if outcome.posterior is not None and best.model.speed_dependent and len(best.problem.space.index) == 1:
        onset = outcome.posterior.threshold_speed()
        ends = interval(*(float(end) * RPM_PER_RAD_S for end in onset.interval(0.95)))
        note = f"; {onset.note}" if onset.note else ""
        parts.append(f"threshold speed in rpm, 95 % of the posterior: {ends}{note}")
    if rig:
        parts.append(_truth_table(outcome, rig))
    return "\n\n".join(parts)


def test_values(test: Experiment, findings: Sequence[Finding]) -> dict[str, Any]:
    """What :func:`describe_test` says, for JSON."""
    return {
        "source": test.source,
        "kind": test.kind,
        "readings": len(test),
        "runs": test.runs,
        "planes": test.planes,
        "speed_rpm": sorted({round(v, 3) for v in (test.set_speed * RPM_PER_RAD_S).tolist()}),
        "findings": finding_values(findings),
    }


def finding_values(findings: Sequence[Finding]) -> list[dict[str, str]]:
    """Findings for JSON."""
    return [{"severity": one.severity, "code": one.code, "message": one.message} for one in findings]


def describe_test(test: Experiment, findings: Sequence[Finding]) -> str:
    """Contents of a file, in a few lines, and the findings of the data check."""
    speeds = np.unique(np.round(test.set_speed * RPM_PER_RAD_S, 3))
    span = f"{speeds[0]:g} to {speeds[-1]:g} rpm" if speeds.size > 4 else ", ".join(f"{s:g}" for s in speeds) + " rpm"
    w = test.frequencies
    lines = [f"{short_source(test.source) or 'data'}: {test.kind}, {test.size_in_words}"]
    lines += [f"  forced at    {', '.join(test.forces)}"] if test.forces else []
    lines += [f"  measured at  {', '.join(test.probes)}"] if test.probes else []
    lines.append(f"  speed        {span}")
    if w.size:
        turning = "" if (w > 0).all() or (w < 0).all() else " (negative: backward whirl)"
        lines.append(f"  frequency    {shown_units().rates(w.min(), w.max())}{turning}")
    lines += [_range(*one) for one in test.sizes]
    if test.attributes:
        lines.append(f"  attributes   {', '.join(test.attributes)}")
    lines += [f"  check: {finding}" for finding in findings] or ["  check: nothing found"]
    return "\n".join(lines)


def _range(name: str, values: Float, unit: str) -> str:
    known = values[np.isfinite(values)]
    if not known.size:
        return f"  {name:<12} not known"
    low, high = significant(known.min(), 3), significant(known.max(), 3)
    return f"  {name:<12} {low} {unit}" if low == high else f"  {name:<12} {low} to {high} {unit}"


def _comparison(closed: FitResult, fit: FitResult) -> str:
    rows = [["", "closed form", "optimised", ""]]
    for p in fit.params.values():
        if p.vary and p.resolved and p.name in closed.params:
            first = closed.params[p.name]
            cells = with_error(first.value, first.stderr)[0], with_error(p.value, p.stderr)[0]
            rows.append([p.name, *cells, p.unit])
    rows.append(["redchi", f"{closed.redchi:.6g}", f"{fit.redchi:.6g}"])
    return "\n".join(text_table(rows, "<22 >14 >14 <1"))


def _truth_table(outcome: Outcome, rig: str) -> str:
    """The fluid's parameters and the threshold speed beside those a simulated rig was made with."""
    truth = datasets.truth(rig)
    results = {"closed form": outcome.closed, "optimised": outcome.fit}
    if outcome.refinement is not None:
        results["refined"] = outcome.refinement.best
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
