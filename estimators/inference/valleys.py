"""A check of error bars along long valleys, where the curvature at the lowest point says little of their length.

Residuals of lines of the twist hold terms in proportion to the inertia J and others in proportion to 1/J, eccentricity
and side load over J being settled. Where J is too large for the second and too small for the first to be seen the
misfit is flat, over decades. Noise makes a dent as often where the second begin to be seen, at a J far below the true
one, as where the first do, and from the curvature there J would be known to be next to nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorfit.estimators.inference.constrained_minima import EntryConstraint
from rotorfit.estimators.inference.identifiability import Combination, Identifiability
from rotorfit.estimators.inference.log_posterior import box
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.significance import OPEN_ERRORS
from rotorfit.models.array_types import Float
from rotorfit.models.digits import significant

_TOLERATED_ERROR_RATIO = 2.0  # factor by which the error bar may be too short for that
_LARGEST_CHANGE = 0.5  # change of a parameter, over its value, from which it has none of its own


def along_valley(problem: Problem, x: Float, covar: Float, scales: Float, verdict: Identifiability) -> Identifiability:
    """The verdict, with parameters not determined that go together farther than their standard errors tell. A parameter
    that others are estimated as ratios to is held at six standard errors from its estimate, all else being fitted
    again: chi-squared is to rise by nine there at least, a quarter of what the curvature promises."""
    space = problem.space
    for denominator, over in space.model.ratios.items():
        numerators = [i for i, base in enumerate(space.base) if base in over]
        for entry, base in enumerate(space.base):
            if base == denominator and space.names[entry] not in verdict.unresolved and x[entry] > 0:
                verdict = _along(problem, x, covar[entry, entry], scales, verdict, entry, numerators)
    return verdict


def _along(
    problem: Problem,
    x: Float,
    variance: float,
    scales: Float,
    verdict: Identifiability,
    entry: int,
    numerators: Sequence[int],
) -> Identifiability:
    lower, upper = box(problem)
    reach = _TOLERATED_ERROR_RATIO * OPEN_ERRORS * float(np.sqrt(max(variance, 0.0)))
    cost, held = problem.cost(x), EntryConstraint(problem, np.where(x == 0, 1.0, np.abs(x)))
    for end in (float(x[entry]) + reach, float(x[entry]) - reach):
        if not max(0.0, lower[entry]) < end < upper[entry]:
            continue
        start = x.copy()
        start[[entry, *numerators]] *= end / x[entry]
        there, found, _ = held.alone(entry, end, np.clip(start, lower, upper))
        rise = 2 * (there - cost)
        if rise < OPEN_ERRORS**2:
            chosen = [i for i in (entry, *numerators) if abs(found[i] - x[i]) > _LARGEST_CHANGE * abs(x[i])]
            return _with(
                verdict, problem.space.names, chosen, (found - x) / scales, _message(problem, x, chosen, end, rise)
            )
    return verdict


def _with(
    verdict: Identifiability, names: Sequence[str], chosen: Sequence[int], moved: Float, message: str
) -> Identifiability:
    """The verdict with one more combination that is open, reached within so many standard errors."""
    length = float(np.linalg.norm(moved[chosen]))
    combination = Combination(
        names=tuple(names[i] for i in chosen),
        direction=tuple((moved[chosen] / length).tolist()),
        stderr=length / OPEN_ERRORS,
        message=message,
    )
    unresolved = {*verdict.unresolved, *combination.names}
    others = [other for other in verdict.combinations if not set(other.names) <= set(combination.names)]
    return replace(
        verdict,
        rank=verdict.rank + len(verdict.combinations) - len(others) - 1,
        combinations=(*others, combination),
        unresolved=tuple(name for name in names if name in unresolved),
    )


def _message(problem: Problem, x: Float, chosen: Sequence[int], end: float, rise: float) -> str:
    """The warning of a valley that is longer than the curvature at its lowest point says."""
    names, entry = problem.space.names, chosen[0]
    unit = problem.space.model.parameter(problem.space.base[entry]).unit
    together = f"{', '.join(names[i] for i in chosen)} only as ratios" if len(chosen) > 1 else f"{names[entry]} is open"
    return (
        f"{together}: at {names[entry]} = {significant(end, 2)} {unit} chi-squared is {significant(abs(rise), 2)} "
        f"{'higher' if rise > 0 else 'lower'} than at {significant(x[entry], 2)}. Fix one or give a prior."
    )
