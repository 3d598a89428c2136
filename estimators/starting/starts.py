"""Where an optimisation begins: the closed form, polished; several random starts where there is none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from numbers import Real

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.names import unknown_name
from rotorfit.estimators.blocks.observations import Block
from rotorfit.estimators.minimisation.least_squares import Options, Solution, Status, minimise
from rotorfit.estimators.misfit.parameter_space import DATUM, ParameterSpace
from rotorfit.estimators.misfit.problem import LOSS_SCALE, Problem
from rotorfit.estimators.starting.closed_form import ClosedForm, ClosedFormError, closed_form, closed_forms
from rotorfit.estimators.starting.many_starts import FEW_STARTS, best_beside, best_of_many
from rotorfit.estimators.starting.modal_start import modal_start
from rotorfit.estimators.starting.pole_starts import start_by_poles
from rotorfit.estimators.starting.shaft_line_starts import has_lines, line_start, round_part, support_starts
from rotorfit.estimators.starting.start_points import (
    CLOSED_FORM,
    GIVEN,
    RANDOM,
    RATIONAL_FIT,
    SHORT_FIT,
    SPECTRAL_LINES,
    Start,
    full_vector,
    noise_limit,
    random_starts,
    short_fits,
)
from rotorfit.models import Modal, RotorModel

_PASSES = (2, 4, 8, 16, 32)  # of the closed form; more than two only where these end far from the optimum
_EXPLICIT_MISFIT = 4.0  # mean squared misfit that noise in measured eccentricities may leave
_LINEAR_ECCENTRICITY = 0.3  # eccentricity up to which the linear rotor is taken to hold for a start
_SHORT = Options(max_iterations=40, tolerance=1e-3, acceptable=1e-3)
"""Costs a millionth above their minimum rank starts; the fit that follows finds the last digits."""


def find_start(problem: Problem, given: Mapping[str, float]) -> Start:
    """Start of the search, nuisance entries included; given values replace what is found."""
    space = problem.space
    for name in given:
        if name not in space.names and name not in space.base:
            raise KeyError(unknown_name("fitted parameter", name, space.names))
    values = np.full(len(space.names), np.nan)
    for i, (name, base) in enumerate(zip(space.names, space.base, strict=True)):
        value = given.get(name, given.get(base))
        if value is None:
            continue
        low, high = float(space.lower[i]), float(space.upper[i])
        if not (isinstance(value, Real) and low <= float(value) <= high and np.isfinite(value)):
            raise ValueError(f"start {name} = {value!r} is not a finite number within its bounds [{low:g}, {high:g}]")
        values[i] = value
    if not np.isnan(values).any():
        return Start(x=full_vector(problem, values), kind=GIVEN)
    found, datum = _guess_with_datum(problem)
    whole = [full_vector(problem, np.where(np.isnan(values), x, values), datum) for x in (found.x, *found.others)]
    return replace(found, x=whole[0], others=tuple(whole[1:]))


def _guess_with_datum(problem: Problem) -> tuple[Start, float]:
    """Start values and the common datum angle, rad; zero where none is fitted."""
    model, space = problem.space.model, problem.space
    if isinstance(model, Modal):
        unknown = {name for name in model.parameter_names if name.startswith("wn")} <= set(space.base)
        has_datum = DATUM in space.nuisance
        values, datum = modal_start(model, problem.responses, turned=has_datum, unknown=unknown)
        typical = np.array([values.get(name, model.parameter(name).scale) for name in space.base])
        return Start(x=typical, kind=RATIONAL_FIT), datum if has_datum else 0.0
    uncorrelated = problem  # the same object where nothing changes: it keeps what it evaluated last
    if not all(block.independent for block in problem.blocks):
        uncorrelated = replace(problem, blocks=tuple(block.uncorrelated for block in problem.blocks))
    if DATUM not in space.nuisance:
        return _guess(uncorrelated), 0.0
    count = 12  # datum angles tried where no model of modes gives it: one is within 15 degrees
    angles = np.arange(count) * 2 * np.pi / count
    angle = min(angles.tolist(), key=lambda a: _explained(_turned(uncorrelated, a)))
    turned = _guess(_turned(uncorrelated, angle))
    best = _short_fit(uncorrelated, full_vector(uncorrelated, turned.x, angle)).x
    found = replace(turned, x=best[: len(space.names)], kind=SHORT_FIT)
    return found, float(best[len(space.names) + space.nuisance.index(DATUM)])


def _explained(problem: Problem) -> float:
    """Cost that one closed form leaves, infinite where there is none."""
    if not are_linear_responses(problem):
        return np.inf
    try:
        return _cost(problem, closed_form(problem.space, problem.blocks, passes=_PASSES[0]).x)
    except ClosedFormError:
        return np.inf


def _turned(problem: Problem, datum: float) -> Problem:
    """The problem with its readings turned back by a datum angle, rad."""
    entry = problem.space.nuisance.index(DATUM)
    blocks: list[Block] = []
    for block, factor in zip(problem.blocks, problem.factors, strict=True):
        turned = None if factor is None else np.exp(-factor[:, entry] * datum)
        blocks.append(block if turned is None else block.with_measured(block.measured * turned))
    return replace(problem, blocks=tuple(blocks))


def _guess(problem: Problem) -> Start:
    if has_lines(problem):
        return Start(x=line_start(problem), kind=SPECTRAL_LINES)
    if not all(block.normal for block in problem.blocks):
        return start_by_poles(problem, linear_starts(problem))
    as_if_round = round_part(problem)
    if as_if_round is None:
        return _linear_guess(problem) if are_linear_responses(problem) else _nonlinear_guess(problem)
    found = _guess(as_if_round)
    whole = np.concatenate([found.x, np.zeros(len(problem.space.names) - found.x.size)])
    starts = support_starts(problem, whole)
    if len(starts) == 1:
        return replace(found, x=whole)
    ends = short_fits(problem, np.array([full_vector(problem, start) for start in starts]))
    return replace(found, x=ends.best[: whole.size], kind=SHORT_FIT)


def _linear_guess(problem: Problem) -> Start:
    """The closed form; where it is not near an optimum that explains the data, the best of those after more passes.
    Sharp resonances between coarse lines leave local minima right beside the global one. There the passes wander, and
    the best end of short fits from all of them, and from beside it, is taken."""
    found: list[tuple[float, ClosedForm]] = []
    settled = True
    try:
        blocks = problem.blocks if problem.loss == "linear" else without_outliers(problem)
        steady = 8  # passes after which round-off decides beside which of some minima they end
        for passes, estimate in zip(_PASSES, closed_forms(problem.space, blocks, passes=_PASSES), strict=False):
            cost, step = _remaining(problem, estimate.x)
            if cost < noise_limit(problem) and step < 1 and passes <= steady:
                return Start(x=estimate.x, kind=CLOSED_FORM, notes=estimate.notes)
            settled = settled and step < max(1.0, 2 * cost / problem.n_data)
            found.append((cost, estimate))
    except ClosedFormError as reason:
        return best_of_many(problem, str(reason))
    if settled:  # no rotor of this model explains the data: the noise is larger than given, or the model wrong
        best = min(found, key=lambda pair: pair[0])[1]
        return Start(x=best.x, kind=CLOSED_FORM, notes=best.notes)
    x = best_beside(problem, np.array([full_vector(problem, estimate.x) for _, estimate in found]))
    return Start(x=x[: len(problem.space.names)], kind=SHORT_FIT, notes=found[0][1].notes)


def _remaining(problem: Problem, values: Float) -> tuple[float, float]:
    """Cost, and the square of the step that leads to the optimum, in standard errors; infinite where there is none. The
    derivatives that come with the cost are those that the search asks for first."""
    cost, gradient, matrix = problem.gauss_newton(full_vector(problem, values))
    size = np.sqrt(np.maximum(matrix.diagonal(), 0.0))  # less what a prior leaves to round-off
    if not (np.isfinite(cost) and size.all()):
        return np.inf, np.inf
    along = gradient / size
    try:
        length = float(along @ np.linalg.solve(matrix / np.outer(size, size), along))
    except np.linalg.LinAlgError:
        return cost, np.inf
    return cost, length if length >= 0 else np.inf


def _nonlinear_guess(problem: Problem) -> Start:
    """Closed form at small eccentricity, then a fit with the measured eccentricities taken as given. Measured
    eccentricities carry noise, so that what they give is checked, and improved, against the orbits that the rotor
    itself would run on."""
    explicit = replace(problem, blocks=tuple(block.frozen for block in problem.blocks))  # without branches and jumps
    size = len(problem.space.names)
    starts = [full_vector(problem, x) for x in linear_starts(problem)]
    found: Solution | None = None
    if starts:
        ends = short_fits(explicit, np.array(starts))
        found = _short_fit(problem, full_vector(problem, ends.best[:size]))
        if found.status not in (Status.CONVERGED, Status.SINGULAR):
            # Data that leave a combination open: Ipopt follows a flat valley to its end, damped steps creep along it.
            along = min((_short_fit(explicit, start) for start in starts), key=lambda fit: fit.cost)
            other = _short_fit(problem, full_vector(problem, along.x[:size]))
            found = min(found, other, key=lambda fit: (not fit.success, fit.cost))
        if found.cost < noise_limit(problem):
            return Start(x=found.x[:size], kind=SHORT_FIT)
    random = full_vector(problem, _explicit_multistart(explicit_with_sense(explicit)))
    cost = _cost(problem, random[:size])
    if found is not None and found.cost <= cost:
        return Start(x=found.x[:size], kind=SHORT_FIT)
    explained = 2 * cost < _EXPLICIT_MISFIT * problem.n_data
    note = f"no closed form explains these data; the best of {FEW_STARTS} random starts was taken"
    return Start(x=random[:size], kind=RANDOM, notes=() if explained else (note,))


def _cost(problem: Problem, values: Float) -> float:
    cost = problem.cost(full_vector(problem, values))
    return cost if np.isfinite(cost) else np.inf


def _explicit_multistart(problem: Problem) -> Float:
    """The same for explicit observations, many at once; the first that the data hardly contradict will do."""
    best, least = np.zeros(0), np.inf
    at_once = 8  # random starts fitted together
    for group in np.split(np.array(list(random_starts(problem, FEW_STARTS))), range(at_once, FEW_STARTS, at_once)):
        ends = short_fits(problem, group)
        if not best.size or ends.cost.min() < least:
            best, least = ends.best, float(ends.cost.min())
        if 2 * least < _EXPLICIT_MISFIT * problem.n_data:
            break
    return best[: len(problem.space.names)]


def _short_fit(problem: Problem, start: Float) -> Solution:
    space = problem.space
    size = np.abs(start) + (start == 0)
    return minimise(problem, start, lower=space.lower, upper=space.upper, scale=size, options=_SHORT)


def without_outliers(problem: Problem) -> tuple[Block, ...]:
    """Blocks whose gross outliers carry a larger sigma, by closed forms that discount what the last one missed, over
    the residuals' median: a start that is far off does not take all for outliers."""
    blocks = problem.blocks
    before = np.zeros(0)
    tolerance = 0.05  # relative change of all values between rounds from which more of them make no better start
    for number in range(8):
        values = closed_form(problem.space, blocks, passes=32).x
        if number and np.all(np.abs(values - before) <= tolerance * np.abs(values)):
            break
        before = values
        size = np.abs(problem.residuals(full_vector(problem, values)))
        # The median modulus of pure noise is sqrt(2 ln 2) sigma.
        scale = max(1.0, float(np.median(size)) / np.sqrt(2 * np.log(2)))
        widening = np.maximum(1.0, size / (LOSS_SCALE * scale)) ** 2
        blocks = problem.with_noise(widening).blocks
    return blocks


def are_linear_responses(problem: Problem) -> bool:
    """True if all observations are responses of a linear rotor."""
    return all(block.linear is block for block in problem.blocks)


def explicit_with_sense(problem: Problem) -> Problem:
    """The problem with velocity ratios kept positive where only free vibrations were seen: these tell no sense."""
    if any(block.tells_sense for block in problem.blocks):
        return problem
    space = problem.space
    forward = np.isin([*space.base, *space.nuisance], ("lam", "lam_D", "lam_M")) & (space.upper > 0)
    return replace(problem, space=replace(space, lower=np.where(forward, np.maximum(space.lower, 0.0), space.lower)))


def linear_starts(problem: Problem) -> list[Float]:
    """Starts from closed forms at small eccentricity, with the law at its own start values; empty without any."""
    space = problem.space
    typical = {q.name: q.scale for q in space.model.parameters}
    begin = space.model.orbit_start(typical)
    _check_start(space.model, {**typical, **begin}, begin)
    reduced = space.holding({entry: begin[base] for entry, base in enumerate(space.base) if base in begin})
    parts = (block.at_small_orbits(_LINEAR_ECCENTRICITY) for block in problem.blocks)
    small = tuple(part for part in parts if part is not None)
    try:
        candidates = list(dict.fromkeys(closed_forms(reduced, small, passes=_PASSES)))
    except ClosedFormError:
        return []
    return [_with_orbit(space, reduced, found.x) for found in candidates]


def _check_start(model: RotorModel, values: Mapping[str, float], begin: Mapping[str, float]) -> None:
    """Refuse a law that is no number where a fit begins, as one that divides by a parameter which starts at zero."""
    with np.errstate(all="ignore"):
        found = model.coefficients([values[name] for name in model.parameter_names], 100.0, _LINEAR_ECCENTRICITY)
    if not np.isfinite(found).all():
        said = ", ".join(f"{name} = {value:g}" for name, value in begin.items())
        raise ValueError(
            f"{model.name} has no finite coefficients where a fit begins, at {said} and eccentricity "
            f"{_LINEAR_ECCENTRICITY:g}: give its parameters a scale, or its law a start(), at which it has"
        )


def _with_orbit(space: ParameterSpace, reduced: ParameterSpace, x: Float) -> Float:
    """A full start from one of the linear rotor."""
    linear, bases = (dict(zip(names, x.tolist(), strict=True)) for names in (reduced.names, reduced.base))
    begin = space.model.orbit_start({q.name: q.scale for q in space.model.parameters} | bases)
    pairs = zip(space.names, space.base, strict=True)
    return np.array([linear[name] if name in linear else begin[base] for name, base in pairs])
