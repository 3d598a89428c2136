"""Points where a search may begin: inside the bounds, of typical size, at random."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rotorfit.estimators.misfit.parameter_space import DATUM, ParameterSpace
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models.array_types import Float

CLOSED_FORM = "closed form"  # eqs 5 to 9, weighted
SHORT_FIT = "short fit"  # the best end of a few steps from several closed forms
RANDOM = "random starts"  # the best end of a few steps from many typical rotors
RATIONAL_FIT = "rational fit"  # poles and residues of a modal model
SPECTRAL_LINES = "spectral lines"  # linear least squares, one kind of line after the other
GIVEN = "given"  # every value by the user
EARLIER_FIT = "earlier fit"  # the optimum of a fit that this one varies


@dataclass(frozen=True, eq=False, kw_only=True)
class Start:
    """Where a search begins."""

    x: Float  # parameters, or the whole vector with nuisance entries behind them, shape ``(p,)``
    kind: str  # which one was taken, one of the names above
    notes: tuple[str, ...] = ()  # what had to be assumed, or is in doubt, in sentences


def full_vector(problem: Problem, values: Float, datum: float = 0.0) -> Float:
    """Values of the parameters moved inside the bounds, nuisance entries behind them at zero."""
    nuisance = [datum if name == DATUM else 0.0 for name in problem.space.nuisance]
    return np.concatenate([inside_bounds(values, problem.space), nuisance])


def inside_bounds(values: Float, space: ParameterSpace) -> Float:
    """Values moved off the bounds, where Ipopt's barrier wants them."""
    lower, upper = space.lower[: values.shape[-1]], space.upper[: values.shape[-1]]
    margin = 1e-3 * np.where(np.isfinite(upper - lower), upper - lower, np.maximum(np.abs(values), 1e-3))
    margin = np.minimum(margin, 1e-3 * space.typical)
    return np.asarray(np.clip(values, lower + margin, upper - margin))


def search_scale(space: ParameterSpace, start: Float) -> Float:
    """Sizes by which a search is scaled."""
    typical = np.concatenate([space.typical, np.full(len(space.nuisance), 0.1)])
    return np.where(np.abs(start) > 1e-6 * typical, np.abs(start), typical)


def random_starts(problem: Problem, count: int) -> Iterator[Float]:
    """Starts spread over a decade around typical values, always the same ones."""
    rng = np.random.default_rng(0)
    scale = problem.space.typical
    deviation = 0.8  # standard deviation of the logarithm of random starts: most lie within a decade
    for _ in range(count):
        yield full_vector(problem, scale * np.exp(rng.normal(0.0, deviation, scale.size)))


def noise_limit(problem: Problem) -> float:
    """Cost that noise leaves, to six standard deviations of chi-squared."""
    return 0.5 * float(problem.n_data + 6 * np.sqrt(2 * problem.n_data))
