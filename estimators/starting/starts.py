"""Where an optimisation begins: the closed form, polished; several random starts where there is none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.blocks.correlated import CorrelatedResponses
from rotorfit.estimators.blocks.nonlinear import responses_of
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.blocks.row_keys import combined, in_order
from rotorfit.estimators.minimisation.least_squares import Options, Solution, Status, minimise
from rotorfit.estimators.misfit.parameter_space import DATUM, ParameterSpace
from rotorfit.estimators.misfit.priors import Prior
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.closed_form import (
    ClosedFormError,
    closed_form,
    closed_forms,
)
from rotorfit.estimators.starting.many_starts import best_of_many
from rotorfit.estimators.starting.modal_start import modal_start
from rotorfit.estimators.starting.nonlinear_starts import (
    explicit_with_sense,
    frozen,
    is_plain_linear,
    linear_starts,
)
from rotorfit.estimators.starting.outliers import without_outliers
from rotorfit.estimators.starting.shaft_line_starts import has_lines, line_start, round_part, support_starts
from rotorfit.estimators.starting.short_fits import LOOSE
from rotorfit.estimators.starting.start_points import (
    CLOSED_FORM,
    GIVEN,
    RANDOM,
    RATIONAL_FIT,
    SHORT_FIT,
    SPECTRAL_LINES,
    Start,
    full_vector,
    loose_fits,
    noise_limit,
    random_starts,
)
from rotorfit.models import Modal
from rotorfit.models.array_types import Float
from rotorfit.models.parameters import unknown_name

_PASSES = (2, 4, 6, 8, 12, 16, 24, 32, 64)  # passes after which closed forms are looked at; good data settle in four
_FEW_READINGS = 1000  # readings that a start takes at least; more with many readings, which tell a worse one apart
_WORTH = 8  # share of the lines, one in so many, from which a start from some of them is tried first
_MULTISTARTS = 24
_ANGLES = 12  # datum angles tried where no model of modes tells it: one is within 15 degrees
_EXPLICIT_MISFIT = 4.0  # mean squared misfit that noise in measured eccentricities may leave
_TRIED = 4  # linear starts from which a short fit is tried
_SAME = 1e-3  # relative difference of starts that are one
_TOGETHER = 8  # random starts fitted together
_ROUNDS = (10, 15, 15)
"""Steps from each start that is left, each time from half of those before."""
_SHORT = Options(max_iterations=40, tolerance=1e-3, acceptable=1e-3)
"""Costs a millionth above their minimum rank starts; the fit that follows finds the last digits."""


def find_start(problem: Problem, given: Mapping[str, float]) -> Start:
    """Start of the search, nuisance entries included; given values replace what is found."""
    space = problem.space
    for name in given:
        if name not in space.names and name not in space.base:
            raise KeyError(unknown_name("fitted parameter", name, space.names))
    _check_given(space, given)
    values = np.array(
        [given.get(n, given.get(b, np.nan)) for n, b in zip(space.names, space.base, strict=True)], dtype=float
    )
    if not np.isnan(values).any():
        return Start(x=full_vector(problem, values), kind=GIVEN)
    found, datum = _guess_with_datum(problem)
    return replace(found, x=full_vector(problem, np.where(np.isnan(values), found.x, values), datum))


def _guess_with_datum(problem: Problem) -> tuple[Start, float]:
    """Start values and the common datum angle, rad; zero where none is fitted."""
    model, space = problem.space.model, problem.space
    if isinstance(model, Modal):
        blocks = [block for block in map(responses_of, problem.blocks) if block is not None]
        values, datum = modal_start(model, blocks)
        typical = np.array([values.get(name, model.parameter(name).scale) for name in space.base])
        return Start(x=typical, kind=RATIONAL_FIT), datum if DATUM in space.nuisance else 0.0
    plain = problem  # the same object where nothing changes: it keeps what it evaluated last
    if any(isinstance(block, CorrelatedResponses) for block in problem.blocks):
        without = (b.base if isinstance(b, CorrelatedResponses) else b for b in problem.blocks)
        plain = replace(problem, blocks=tuple(without))
    if DATUM not in space.nuisance:
        return _guess(plain), 0.0
    angles = np.arange(_ANGLES) * 2 * np.pi / _ANGLES
    angle = min(angles.tolist(), key=lambda a: _explained(_turned(plain, a)))
    turned = _guess(_turned(plain, angle))
    best = _short_fit(plain, full_vector(plain, turned.x, angle)).x
    found = Start(x=best[: len(space.names)], kind=SHORT_FIT, notes=turned.notes)
    return found, float(best[len(space.names) + space.nuisance.index(DATUM)])


def _explained(problem: Problem) -> float:
    """Cost that one closed form leaves, infinite where there is none."""
    if not is_plain_linear(problem):
        return np.inf
    try:
        return _cost(problem, closed_form(problem.space, problem.blocks, passes=_PASSES[1]).x)
    except ClosedFormError:
        return np.inf


def _turned(problem: Problem, datum: float) -> Problem:
    """The problem with its readings turned back by a datum angle, rad."""
    entry = problem.space.nuisance.index(DATUM)
    blocks: list[Block] = []
    for block, factor in zip(problem.blocks, problem.factors, strict=True):
        if isinstance(block, Responses) and factor is not None:
            blocks.append(replace(block, measured=block.measured * np.exp(-factor[:, entry] * datum)))
        else:
            blocks.append(block)
    return replace(problem, blocks=tuple(blocks))


def _check_given(space: ParameterSpace, given: Mapping[str, float]) -> None:
    limits = zip(space.lower.tolist(), space.upper.tolist(), strict=True)
    for name, base, (low, high) in zip(space.names, space.base, limits, strict=False):  # nuisance entries follow
        value = given.get(name, given.get(base))
        if value is not None and not (isinstance(value, Real) and low <= float(value) <= high and np.isfinite(value)):
            raise ValueError(f"start {name} = {value!r} is not a finite number within its bounds [{low:g}, {high:g}]")


def _guess(problem: Problem) -> Start:
    """The best of the closed forms that further linear passes lead to, from the closed form proper until they settle.

    Sharp resonances between coarse lines leave local minima right beside the global one: a start has to be near. Where
    none of the closed forms explains the data, the one from which a short optimisation gets furthest is taken.
    """
    if has_lines(problem):
        return Start(x=line_start(problem), kind=SPECTRAL_LINES)
    as_if_round = round_part(problem)
    if as_if_round is not None:
        return _from_round(problem, _guess(as_if_round))
    if not is_plain_linear(problem):
        return _nonlinear_guess(problem)
    few = _few_lines(problem)
    if few is not None:
        found = _guess(few)
        if _explains(problem, found.x):
            return found
    try:
        blocks = problem.blocks if problem.loss == "linear" else without_outliers(problem)
        enough = partial(_settled, problem)
        candidates = list(dict.fromkeys(closed_forms(problem.space, blocks, passes=_PASSES, enough=enough)))
    except ClosedFormError as reason:
        return best_of_many(problem, str(reason))
    best = candidates[0]
    if len(candidates) > 1:
        best = min(candidates, key=lambda estimate: _cost(problem, estimate.x))
    if not _explains(problem, best.x):
        best = candidates[_furthest(problem, [full_vector(problem, estimate.x) for estimate in candidates])]
    return Start(x=best.x, kind=CLOSED_FORM, notes=best.notes)


def _furthest(problem: Problem, starts: Sequence[Float]) -> int:
    """Number of the start from which a short search gets furthest: a few steps from all, more from the better half.

    Where no start leads anywhere, as with data of another rotor, steps are all that the time goes into.
    """
    ends = dict(enumerate(starts))
    for steps in _ROUNDS:
        fits = {k: _short_fit(problem, end, replace(_SHORT, max_iterations=steps)) for k, end in ends.items()}
        best = sorted(fits, key=lambda k: fits[k].cost)[: (len(fits) + 1) // 2]
        ends = {k: fits[k].x for k in best}
        if len(ends) == 1:
            break
    return next(iter(ends))


def _few_lines(problem: Problem) -> Problem | None:
    """The problem with every so many of its lines, where it has more than a start needs."""
    wanted = max(_FEW_READINGS, int(problem.space.size * np.sqrt(problem.n_data)))
    step = problem.n_data // (2 * wanted)
    responses = [block for block in problem.blocks if isinstance(block, Responses)]
    turned = any(factor is not None for factor in problem.factors)
    if step < _WORTH or turned or len(responses) < len(problem.blocks):
        return None
    return replace(problem, blocks=tuple(_every(block, step) for block in responses))


def _every(block: Responses, step: int) -> Responses:
    """Every so many lines of each speed, group, force plane and sense of whirl, from one end to the other."""
    plane = np.argmax(np.abs(block.force), axis=1)
    number = in_order(combined(block.condition[0], plane, (block.frequency < 0).astype(np.intp)))[1]
    order = np.lexsort([block.frequency, number])
    size = np.bincount(number)
    rank = np.arange(order.size) - np.repeat(np.cumsum(size) - size, size)
    keep = np.zeros(order.size, dtype=bool)
    keep[order] = (rank % step == step // 2) | (np.repeat(size, size) < 2 * step)
    return block.lines(keep)


def _from_round(problem: Problem, found: Start) -> Start:
    """Start of a rotor with a turning element from that of the round one."""
    whole = np.concatenate([found.x, np.zeros(len(problem.space.names) - found.x.size)])
    starts = support_starts(problem, whole)
    if len(starts) == 1:
        return replace(found, x=whole)
    fits = [_short_fit(problem, full_vector(problem, start)) for start in starts]
    best = min(fits, key=lambda fit: fit.cost).x[: whole.size]
    return Start(x=best, kind=SHORT_FIT, notes=found.notes)


def _nonlinear_guess(problem: Problem) -> Start:
    """Closed form at small eccentricity, then a fit with the measured eccentricities taken as given.

    Measured eccentricities carry noise, so that what they give is checked, and improved, against the orbits that the
    rotor itself would run on.
    """
    explicit = frozen(problem)
    size = len(problem.space.names)
    starts = [full_vector(problem, x) for x in linear_starts(problem, _PASSES)]
    found: Solution | None = None
    if starts:
        apart = _apart(np.array(starts))
        promising = apart[np.argsort(_costs(explicit, apart), kind="stable")[:_TRIED]]
        ends = loose_fits(explicit, promising)
        found = _short_fit(problem, _inside_full(problem, ends.x[np.argmin(ends.cost)]))
        if found.status not in (Status.CONVERGED, Status.SINGULAR):
            # Data that leave a combination open: Ipopt follows a flat valley to its end, damped steps creep along it.
            along = min((_quick_fit(explicit, start) for start in promising), key=lambda fit: fit.cost)
            other = _short_fit(problem, _inside_full(problem, along.x))
            found = min(found, other, key=lambda fit: (not fit.success, fit.cost))
        if found.cost < noise_limit(problem):
            return Start(x=found.x[:size], kind=SHORT_FIT)
    random = full_vector(problem, _explicit_multistart(explicit_with_sense(explicit)))
    if found is not None and found.cost <= _cost(problem, random):
        return Start(x=found.x[:size], kind=SHORT_FIT)
    note = f"no closed form explains these data; the best of {_MULTISTARTS} random starts was taken"
    return Start(x=random[:size], kind=RANDOM, notes=(note,))


def _apart(starts: Float) -> Float:
    """The starts that differ: once they have settled, further passes of a closed form bring nothing new."""
    kept: list[Float] = []
    for start in starts:
        size = np.abs(start) + np.finfo(float).tiny
        if not any((np.abs(start - other) <= _SAME * size).all() for other in kept):
            kept.append(start)
    return np.array(kept)


def _inside_full(problem: Problem, x: Float) -> Float:
    return full_vector(problem, x[: len(problem.space.names)])


def _explains(problem: Problem, values: Float) -> bool:
    """Whether the misfit is what the noise makes it.

    The derivatives that come with it are those that the search asks for first.
    """
    return bool(problem.gauss_newton(full_vector(problem, values))[0] < noise_limit(problem))


def _settled(problem: Problem, values: Float) -> bool:
    """Whether values explain the data and a step to the optimum would be short of a standard error."""
    return bool(_settled_at(*problem.gauss_newton(full_vector(problem, values)), noise_limit(problem)))


def _settled_at(cost: Float | float, gradient: Float, matrix: Float, limit: float) -> NDArray[np.bool_]:
    """The same by cost, gradient and Gauss-Newton matrix there, of one problem or of many, shape ``(...)``."""
    size = np.sqrt(np.diagonal(matrix, axis1=-2, axis2=-1))
    good = np.asarray((cost < limit) & (size > 0).all(axis=-1))
    if not good.any():
        return good
    if not good.all():  # the others are not to be solved
        gradient, size = np.where(good[..., None], gradient, 0.0), np.where(good[..., None], size, 1.0)
        matrix = np.where(good[..., None, None], matrix, np.eye(size.shape[-1]))
    along = gradient / size
    try:
        step = np.linalg.solve(matrix / (size[..., :, None] * size[..., None, :]), along[..., None])[..., 0]
    except np.linalg.LinAlgError:
        return np.zeros_like(good)
    length = np.sum(step * along, axis=-1)
    return np.asarray(good & (length >= 0) & (length < 1))


def _costs(problem: Problem, x: Float) -> Float:
    with np.errstate(all="ignore"):  # a start may well be absurd
        cost = problem.costs(x)
    return np.where(np.isfinite(cost), cost, np.inf)


def _cost(problem: Problem, values: Float) -> float:
    cost = problem.cost(full_vector(problem, values))
    return cost if np.isfinite(cost) else np.inf


def _explicit_multistart(problem: Problem) -> Float:
    """The same for explicit observations, many at once; the first that the data hardly contradict will do."""
    starts = np.array(list(random_starts(problem, _MULTISTARTS)))
    best, least = starts[0], np.inf
    for group in np.split(starts, range(_TOGETHER, len(starts), _TOGETHER)):
        ends = loose_fits(problem, group)
        if ends.cost.min() < least:
            best, least = ends.x[np.argmin(ends.cost)], float(ends.cost.min())
        if 2 * least < _EXPLICIT_MISFIT * problem.n_data:
            break
    return np.asarray(best[: len(problem.space.names)])


def _quick_fit(problem: Problem, start: Float) -> Solution:
    """A short fit by Ipopt, held loosely at its start as those of many are."""
    from scipy.stats import norm

    count = len(problem.space.names)
    size = np.maximum(np.abs(start[:count]), problem.space.typical)
    held = tuple(Prior(i, norm(value, LOOSE * size[i])) for i, value in enumerate(start[:count].tolist()))
    problem = replace(problem, priors=(*problem.priors, *held))
    return _short_fit(problem, start, Options(max_iterations=25, hessian="gauss-newton"))


def _short_fit(problem: Problem, start: Float, options: Options = _SHORT) -> Solution:
    space = problem.space
    size = np.abs(start) + (start == 0)
    return minimise(problem, start, lower=space.lower, upper=space.upper, scale=size, options=options)
