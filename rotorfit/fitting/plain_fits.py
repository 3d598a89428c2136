"""Fits of many runs of one plan at once, as far as they are plain: what is worth a look is left to a fit by itself.

Each stage of :func:`rotorfit.fit` is done for all runs as arrays, by the same formulas, and asks its own first
questions. A run that any of them leaves a doubt of has no result here: its verdict, its sentences and its numbers come
from :func:`rotorfit.fit`, which therefore holds all rules.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real

import numpy as np

from rotorfit.checks.plain import keep_clean, surely_clean
from rotorfit.data.alike import AlikeTests, alike
from rotorfit.data.experiments import Experiment
from rotorfit.estimators.inference import covariance
from rotorfit.estimators.inference.identifiability import covariances
from rotorfit.estimators.minimisation.descent_of_many import smooth_descents
from rotorfit.estimators.minimisation.least_squares import Options, Solution, Status
from rotorfit.estimators.misfit.parameter_space import ParameterSpace, parameter_space
from rotorfit.estimators.misfit.run_stack import RunStack
from rotorfit.estimators.noise.robust_covariance import scatter_by_line
from rotorfit.estimators.starting.start_points import given_starts, search_scale
from rotorfit.estimators.starting.starts import starts_of_many
from rotorfit.fitting.fit_warnings import NOISE_FLOOR, growth, too_quiet
from rotorfit.fitting.noise.judging import UNEVEN
from rotorfit.fitting.noise.plain import plain_noise
from rotorfit.fitting.parameter_table import parameter_table
from rotorfit.fitting.quantities import FittedParameter
from rotorfit.fitting.settings import FitSettings
from rotorfit.models import Modal, RotorModel
from rotorfit.models.array_types import Bool, Float, Index
from rotorfit.observing.alike import AlikeResponses, observe_alike

_TOGETHER = 16384  # readings evaluated together, which stay in the processor's cache


@dataclass(frozen=True, eq=False, kw_only=True)
class PlainFit:
    """Result of one run, a :class:`~rotorfit.fitting.result.FitResult` in little: it has no warnings."""

    params: Mapping[str, FittedParameter]  # as of a result
    var_names: tuple[str, ...]  # as of a result
    covar: Float  # as of a result
    chisqr: float  # as of a result
    redchi: float  # as of a result
    ndata: int  # as of a result
    nfev: int  # as of a result
    message: str  # as of a result
    still: float  # chi-squared of no motion at all


@dataclass(frozen=True, eq=False, kw_only=True)
class SolvedRun:
    """A run whose search ended plainly, but whose residuals or errors have to be looked at by themselves."""

    begin: Float  # where the search began, shape ``(p,)``
    solution: Solution  # how it ended


def plain_fits(
    model: RotorModel, tests: Sequence[Experiment], settings: FitSettings, starts: Sequence[Mapping[str, float]]
) -> dict[int, PlainFit | SolvedRun]:
    """What fits of many runs come to as far as they are plain, by the number of the run.

    Runs that are not in the answer are to be fitted one by one; what was worked out of their data is kept with these.
    """
    if not is_plain(model, settings):
        return {}
    try:
        space = parameter_space(model, known=settings.known, bounds=settings.bounds, groups=({},))
    except (ValueError, KeyError):
        return {}  # what is wrong with the settings is told where a run is fitted
    found: dict[int, PlainFit | SolvedRun] = {}
    for names in (set(), set(space.names)):
        some = [number for number, start in enumerate(starts) if set(start) == names and _are_numbers(start)]
        for group in alike([tests[number] for number in some]):
            own = [starts[some[number]] for number in group.numbers.tolist()]
            begin = np.array([[start[name] for name in space.names] for start in own]) if names else None
            found |= {some[number]: fit for number, fit in _fits(space, group, begin).items()}
    return found


def _are_numbers(start: Mapping[str, float]) -> bool:
    return all(isinstance(value, Real) for value in start.values())


def is_plain(model: RotorModel, settings: FitSettings) -> bool:
    """Whether a fit is one of linear responses in complex coordinates, by squares, with nothing known of its values."""
    linear = model.frame == "z" and not model.eccentricity_dependent and not model.turns
    simple = model.shaft is None and not isinstance(model, Modal)
    return linear and simple and settings == FitSettings(known=settings.known, bounds=settings.bounds)


def _fits(space: ParameterSpace, group: AlikeTests, given: Float | None) -> dict[int, PlainFit | SolvedRun]:
    """Results by the number of the run; ``given`` are start values, shape ``(W, p)``."""
    clean = surely_clean(group)
    try:
        seen = observe_alike(space.model, group)
    except (ValueError, KeyError):
        return {}  # what is wrong with the data is told where a run is fitted
    found: dict[int, PlainFit | SolvedRun] = {}
    for some, stack in stacks_of(space, seen, clean):
        own = None if given is None else given[some]
        try:
            with np.errstate(all="ignore"):  # of a run that goes astray nothing is sure, and comparisons say so
                solved = dict(_solved(stack, own))
        except np.linalg.LinAlgError:
            continue  # of one run at least: a fit of each by itself tells of which
        found |= {int(some[member]): fit for member, fit in solved.items()}
    for member, test in enumerate(group.tests):
        if isinstance(found.get(member), PlainFit):
            continue
        if seen.told[member]:
            seen.keep(member)
        if clean[member]:
            keep_clean(test)
    return {int(group.numbers[member]): fit for member, fit in found.items()}


def stacks_of(space: ParameterSpace, seen: AlikeResponses, wanted: Bool) -> Iterator[tuple[Index, RunStack]]:
    """Runs of one plan in stacks that are evaluated together, with their numbers in the group."""
    good = np.flatnonzero(wanted & seen.told & (seen.measured != 0).all(axis=1))
    readings = seen.measured.shape[1]
    for some in np.split(good, range(0, good.size, max(1, _TOGETHER // readings))[1:]):
        if some.size and 2 * readings > space.size:
            stack = RunStack(
                space=space,
                layout=seen.layout,
                speed=seen.group.speed[some],
                measured=seen.measured[some],
                sigma=seen.sigma[some],
            )
            yield some, stack


def _solved(stack: RunStack, given: Float | None) -> Iterator[tuple[int, PlainFit | SolvedRun]]:
    """Results by the number of the run in the stack."""
    space = stack.space
    begin, settled = starts_of_many(stack) if given is None else given_starts(space, given)
    if not settled.any():
        return
    scale = search_scale(space, np.where(np.isfinite(begin), begin, 0.0))
    ends = smooth_descents(stack.gauss_newton, begin, scale, space.lower, space.upper, Options())
    # What exact data leave is round-off, of which no two ways of summing leave the same.
    noisy = 2 * ends.normal[0] > NOISE_FLOOR * stack.n_data
    smooth = np.flatnonzero(settled & ends.smooth & noisy)
    if not smooth.size:
        return
    x = ends.x[smooth]
    judged = dict(_judged(stack.part(smooth, ends.x), x, begin[smooth], ends.n_evaluations[smooth]))
    for member, run in enumerate(smooth.tolist()):
        yield run, judged[member] if member in judged else SolvedRun(begin=begin[run], solution=ends.solution(run))


def _judged(stack: RunStack, x: Float, begin: Float, n_evaluations: Index) -> Iterator[tuple[int, PlainFit]]:
    """The same from solutions, as :func:`rotorfit.fitting.judge.judge` makes them."""
    space, layout = stack.space, stack.layout
    r, rows = stack.jacobian(x)
    chisqr = np.sum(np.abs(r) ** 2, axis=1)
    nfree = stack.n_data - space.size
    redchi = chisqr * covariance.per_freedom("linear", nfree)
    widening = np.array([covariance.widening(value, "linear", nfree=nfree) for value in redchi.tolist()])
    noise, freedom = plain_noise(stack, x)
    speed = stack.speed if space.model.speed_dependent else np.zeros_like(stack.speed)
    plain = noise & ~too_quiet(redchi, nfree) & ~growth(space.model, stack.theta(x), speed, layout.frequency)[1]
    roots = np.asarray(np.linalg.qr(np.swapaxes(rows.view(float), -1, -2), mode="r"))
    scales = covariance.parameter_scales_of_many(stack, x)
    scattered, determined = covariances(roots, scales)
    plain &= determined
    uneven = scatter_by_line(r, rows.view(float), scattered, layout.line, widening).excess
    plain &= (uneven < UNEVEN).all(axis=1)
    covar = scattered * widening[:, None, None]
    still = np.sum(np.abs(stack.measured / stack.sigma) ** 2, axis=1)
    for member in np.flatnonzero(plain).tolist():
        degrees = (max(float(freedom[member]), 1.0),) * space.size
        params = parameter_table(space, x[member], begin[member], scattered[member], covar[member], degrees, ())
        if not any(parameter.at_bound for parameter in params.values()):
            found = PlainFit(
                params=params,
                var_names=space.names,
                covar=covar[member],
                chisqr=float(chisqr[member]),
                redchi=float(redchi[member]),
                ndata=stack.n_data,
                nfev=int(n_evaluations[member]),
                message=Status.CONVERGED.value,
                still=float(still[member]),
            )
            yield member, found
