"""One run that does not go with the others: what a fit would leave without it, by one step of Gauss-Newton."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorfit.estimators.noise.reading_noise import SMOOTH_CORRELATION
from rotorfit.estimators.noise.run_effects import real_rows
from rotorfit.models.array_types import ComplexArray, Float, Index

FEWEST_RUNS = 3
"""Of two runs either may be the odd one."""
_MISFIT_FALLS = 3.0
"""Times by which the misfit must fall without the run: far beyond the scatter of redchi."""
_MISFIT_FALLS_WITHOUT_ANOTHER = 1.5
"""Times by which it may fall without any other."""


def misfit_without(r: ComplexArray, J: ComplexArray, prior: Float, runs: Sequence[Index]) -> Float:
    """Mean squared residual, real and imaginary part, of a fit to all runs but one, run by run."""
    rows = real_rows(J)
    information, gradient = rows @ rows.T + np.diag(prior), rows @ r.view(float)
    square = float(np.vdot(r, r).real)
    found = []
    for own in runs:
        mine = real_rows(J[own])
        left, slope = information - mine @ mine.T, gradient - mine @ r[own].view(float)
        size = np.sqrt(np.maximum(np.diag(left), np.finfo(float).tiny))
        step = np.linalg.lstsq(left / np.outer(size, size), slope / size, rcond=1e-10)[0] / size
        rest = square - float(np.vdot(r[own], r[own]).real) - float(slope @ step)
        found.append(max(rest, 0.0) / max(2 * (r.size - own.size) - prior.size, 1))
    return np.array(found)


def odd_run(
    r: ComplexArray, J: ComplexArray, prior: Float, runs: Sequence[Index], sweeps: Sequence[Index]
) -> tuple[int, float] | None:
    """Number of the one run without which a fit would be another, and what it would then leave; None where none is."""
    if len(runs) < FEWEST_RUNS:
        return None
    now = float(np.vdot(r, r).real) / max(2 * r.size - prior.size, 1)
    left = misfit_without(r, J, prior, runs)
    first, second = np.argsort(left)[:2].tolist()
    if left[first] * _MISFIT_FALLS > now or left[second] * _MISFIT_FALLS_WITHOUT_ANOTHER < now:
        return None
    # An error of a whole run leaves residuals that follow one another; one that jitters more than others is but noisy.
    own = [sweep for sweep in sweeps if np.isin(sweep[0], runs[first])]
    along = sum(float(np.vdot(r[sweep[:-1]], r[sweep[1:]]).real) for sweep in own)
    power = sum(float(np.vdot(r[sweep], r[sweep]).real) for sweep in own)
    return (first, float(left[first])) if along > SMOOTH_CORRELATION * power else None
