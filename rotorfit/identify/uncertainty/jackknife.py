"""Change of results when a run is left out: errors that assume nothing of how runs differ."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorfit.base.array_types import ROUND_OFF, Float
from rotorfit.base.digits import counted, interval, significant, with_error
from rotorfit.base.equality import ByValue
from rotorfit.base.names import unknown_name
from rotorfit.base.text_table import Printed, text_table
from rotorfit.estimators.inference.covariance import prior_curvature
from rotorfit.estimators.misfit.problem import robust_weights
from rotorfit.estimators.noise.run_effects import FEWEST_RUNS
from rotorfit.identify.fitting.quantities import Quantity
from rotorfit.identify.fitting.result import FitResult

_LARGEST_GROWTH = 100.0  # times by which an error grows without a run that alone determines the quantity


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Jackknife(ByValue, Printed):
    """Estimates without each run in turn (Efron 1982), one Gauss-Newton step from those with all."""

    fit: FitResult  # the fit of all runs
    runs: tuple[str, ...]  # those left out
    changes: Float  # of the fitted vector, one row a run, shape ``(G, p)``
    growth: Float  # error without a run over that with all, shape ``(G, p)``

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the standard errors: one less than runs."""
        return len(self.runs) - 1

    def parameter(self, name: str) -> Quantity:
        """A fitted parameter; infinitely uncertain where one run alone determines it."""
        if name not in self.fit.var_names:
            raise KeyError(unknown_name("fitted parameter", name, self.fit.problem.space.names))
        p, place = self.fit.params[name], self.fit.var_names.index(name)
        if not p.resolved or (self.growth[:, place] > _LARGEST_GROWTH).any():
            return Quantity(p.value, math.inf, p.unit, self.freedom)
        return self._spread(p.value, np.eye(self.fit.x.size)[place], p.unit)

    def threshold_speed(self, at: Mapping[str, Any] | None = None) -> Quantity:
        """Threshold speed, rad/s; NaN where the fitted rotor is stable at every speed searched."""
        fit, group = self.fit, self.fit.group(at)
        onset = fit.onset(group)
        if onset is None or not math.isfinite(fit.threshold_of(group).stderr):
            return Quantity(math.nan if onset is None else onset.speed, math.inf, "rad/s", self.freedom)
        slope = fit.problem.space.pull_back(onset.gradient, group)
        if (self.growth[:, slope != 0] > _LARGEST_GROWTH).any():
            return Quantity(onset.speed, math.inf, "rad/s", self.freedom)
        return self._spread(onset.speed, slope, "rad/s")

    def _spread(self, value: float, slope: Float, unit: str) -> Quantity:
        moved = self.changes @ slope
        variance = (1 - 1 / len(moved)) * float(np.sum((moved - moved.mean()) ** 2))
        return Quantity(value, math.sqrt(variance), unit, self.freedom)

    def table(self) -> str:
        """Parameters with their errors from leaving runs out, beside those of the fit."""
        low_high = f"95 % (t, {self.freedom} d.o.f.)"
        rows = [["parameter", "value", "jackknife", "stderr", low_high, "unit"]]
        for name in self.fit.problem.space.names:
            found, p = self.parameter(name), self.fit.params[name]
            known = math.isfinite(found.stderr)
            shown = interval(*found.interval()) if known else "rests on one run" if p.resolved else "not determined"
            rows.append([name, *with_error(found.value, found.stderr), significant(p.stderr, 2), shown, p.unit])
        return "\n".join(text_table(rows, "<22 >14 >12 >12 >28 <1"))

    def __str__(self) -> str:
        return self.table()


def _inverse(matrix: Float) -> Float:
    """Inverse of a curvature; what it leaves open is uncertain without bound, but not beyond the computer's."""
    size, directions = np.linalg.eigh(matrix)
    return np.asarray((directions / np.maximum(size, ROUND_OFF * size.max())) @ directions.T)


def jackknife(fit: FitResult) -> Jackknife:
    """Leave out run after run; see :meth:`FitResult.jackknife`."""
    problem = fit.problem
    if not fit.success:
        raise ValueError("the fit did not converge: what a run changes is not known")
    run = problem.run
    runs = tuple(dict.fromkeys(run.tolist()))
    if len(runs) < FEWEST_RUNS:
        raise ValueError(
            f"{counted(len(runs), 'run')}: what differs from run to run cannot be known from fewer than {FEWEST_RUNS}"
        )
    if any(block.force_spectra for block in problem.blocks):
        raise ValueError(
            "the spectrum of the flow's force is fitted inside to all readings, which leaving a run out would not fit "
            "again: fit without one of the recordings in place of it"
        )
    if not all(block.independent for block in problem.blocks):
        raise ValueError(
            "runs of this fit share errors, of a mounting, of measured forces or of a dry run, which its standard "
            "errors count already: leaving one run out does not show them"
        )
    residuals, jacobian = problem.jacobian(fit.x)
    root = np.sqrt(robust_weights(problem.loss, np.abs(residuals) ** 2)[1])
    r, J = residuals * root, jacobian * root[:, None]
    scale = np.sqrt(np.maximum(np.sum(np.abs(J) ** 2, axis=0), 1e-300))
    J = J / scale
    prior = np.diag(prior_curvature(problem, fit.x) / scale**2)
    whole = (J.conj().T @ J).real + prior
    error = np.sqrt(np.diag(_inverse(whole)))
    changes, growth = [], []
    for name in runs:
        rows = run == name
        rest = _inverse(whole - (J[rows].conj().T @ J[rows]).real)
        # The slope of the others' cost is minus that of this run's: all together they are at their minimum.
        changes.append(rest @ (J[rows].conj().T @ r[rows]).real / scale)
        growth.append(np.sqrt(np.diag(rest)) / error)
    return Jackknife(fit=fit, runs=runs, changes=np.array(changes), growth=np.array(growth))
