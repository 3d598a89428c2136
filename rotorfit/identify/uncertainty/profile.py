"""Profile-likelihood intervals of a fit: how far a parameter may move before the data object."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from rotorfit.base.accessors import Accessor
from rotorfit.base.array_types import Float
from rotorfit.base.digits import interval, significant, with_error
from rotorfit.base.equality import ByValue
from rotorfit.base.executors import carry_out
from rotorfit.base.names import unknown_name
from rotorfit.base.significance import quantile
from rotorfit.base.text_table import Printed
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.blocks.correlated import freedom_of
from rotorfit.estimators.inference.caused_problem import CausedProblem
from rotorfit.estimators.inference.constrained_minima import (
    Condition,
    EntryConstraint,
    QuantityConstraint,
    ValueAndGradient,
    bounds_of,
)
from rotorfit.estimators.inference.covariance import standard_error
from rotorfit.estimators.inference.log_posterior import box
from rotorfit.estimators.inference.profile_curve import Curve, End, Search, find_ends, find_rises, limits
from rotorfit.estimators.minimisation.least_squares import minimise
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.misfit.ratios import LogRatioProblem, Ratios, ratios_of
from rotorfit.identify.fitting.fit_file import fit_from_json, fit_to_json
from rotorfit.identify.fitting.onset import onset_by_causes, onset_note
from rotorfit.identify.fitting.quantities import THRESHOLD, FittedParameter, Quantity
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.uncertainty.target import caused_problem
from rotorfit.models import threshold_speed
from rotorfit.models.motion.stability import least_stable
from rotorfit.models.parameters import bare_name


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Profile(ByValue, Printed):
    """Profile of one parameter or of the threshold speed.

    Attributes:
        name, unit: what was profiled.
        value: its estimate.
        level: probability of the interval.
        lower, upper: ends of the interval; infinite where the data set none, see ``message``.
        values: where the curve was evaluated, ascending, shape ``(N,)``.
        rise: rise of chi-squared there, everything else at its best, in units of the noise as widened for ``stderr``;
            its square root is linear for a linear model.
        message: what is to be known of the ends, empty if there is nothing.
        stderr: its standard error, for comparison; infinite where the data do not determine it, NaN if not given.
        freedom: degrees of freedom behind that standard error.
    """

    name: str
    unit: str
    value: float
    level: float
    lower: float
    upper: float
    values: Float
    rise: Float
    message: str
    stderr: float = math.nan
    freedom: float = math.inf

    plot = Accessor()

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end."""
        return self.lower, self.upper

    @property
    def goal(self) -> float:
        """Rise at the ends of the interval: quantile of chi-squared, of F where few differences tell the noise."""
        return quantile(self.level, self.freedom) ** 2

    def __str__(self) -> str:
        factor, unit = (RPM_PER_RAD_S, "rpm") if self.unit == "rad/s" else (1.0, self.unit)
        value, _ = with_error(factor * self.value, factor * self.stderr)
        ends = interval(factor * self.lower, factor * self.upper)
        text = f"{self.name}: {value}, {100 * self.level:g} % {ends}" + ("" if unit == "1" else f" {unit}")
        return f"{text}; {self.message}" if self.message else text


def profile(
    fit: FitResult, name: str, *, level: float = 0.95, points: int = 21, at: Mapping[str, Any] | None = None
) -> Profile:
    """Profile-likelihood interval of a parameter, asymmetric where the model is curved.

    The value is held, all the others are fitted again, and the ends are where chi-squared has risen by the quantile of
    its distribution with one degree of freedom, times redchi where that exceeds one (as ``stderr`` is widened; priors
    keep their weight). With a robust loss, and where readings of one mounting err together, the rise is scaled to agree
    with ``stderr`` for small changes.
    """
    return profiles(fit, (name,), level=level, points=points, at=at)[0]


def profiles(
    fit: FitResult,
    names: Sequence[str] | None = None,
    *,
    level: float = 0.95,
    points: int = 21,
    at: Mapping[str, Any] | None = None,
    executor: Executor | None = None,
) -> tuple[Profile, ...]:
    """Profiles of several quantities, found together: a fraction of the time that they take one after the other; or
    each by a worker, for nonlinear rotors."""
    if not 0 < level < 1:
        raise ValueError(f"level is {level}; it must be between 0 and 1, for instance 0.95")
    if points < 3:
        raise ValueError(f"points is {points}; a curve needs at least 3")
    if fit.method == "closed form":
        raise ValueError("a closed form is not a minimum, so it has no profile; use the result of rf.fit")
    if executor is not None:
        work = partial(_profiled, fit_to_json(fit), level, points, at)
        return tuple(carry_out(work, tuple(fit.problem.space.names if names is None else names), executor))
    base = _settled(fit)
    problem, x = base.problem, base.x
    held = EntryConstraint(problem, np.maximum(np.abs(x), 1e-6 * _sizes(problem, x)))
    lines = [
        _threshold(fit, base, level, at) if name == THRESHOLD else _parameter(fit, held, base, name, level)
        for name in (fit.problem.space.names if names is None else names)
    ]
    curves = [line.curve for line in lines]
    ends = find_ends(curves, [line.searches for line in lines])
    values = [_grid(line.value, found, points) for line, found in zip(lines, ends, strict=True)]
    find_rises(curves, values)
    return tuple(line.profile(found, some) for line, found, some in zip(lines, ends, values, strict=True))


def _profiled(text: str, level: float, points: int, at: Mapping[str, Any] | None, name: str) -> Profile:
    """One of them on a worker, to which a fit goes as text."""
    return profile(fit_from_json(text), name, level=level, points=points, at=at)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Line:
    """A quantity on its way to a profile."""

    known: FittedParameter | Quantity  # its estimate with error and unit
    name: str  # what is profiled
    value: float  # where the curve is lowest
    curve: Curve  # its curve
    step: float  # its guessed standard error
    reach: tuple[tuple[float, bool], ...]  # how far it can go downwards and upwards, and whether that is a bound
    scale: float  # factor on the quantile
    level: float  # probability of the interval
    beyond: str = ""  # what to say of it in any case
    shown: Callable[[float], float] = float

    @property
    def goal(self) -> float:
        """Rise at the ends."""
        return quantile(self.level, self.known.freedom) ** 2 * self.scale

    @property
    def searches(self) -> tuple[Search, ...]:
        """For the lower and the upper end."""
        step = math.sqrt(self.goal) * self.step
        return tuple(
            self.curve.search(side, self.goal, step, limit, bound)
            for side, (limit, bound) in zip((-1, 1), self.reach, strict=True)
        )

    def profile(self, ends: list[End], values: list[float]) -> Profile:
        """The profile with the ends and the values of its curve."""
        places = sorted(set(values), key=self.shown)
        falls = self.shown(1.0) < self.shown(0.0)  # along the curve, as negative ones do along their logarithm
        found = [self.shown(e.value) if math.isfinite(e.value) else -e.value if falls else e.value for e in ends]
        ends = [replace(end, value=at, limit=self.shown(end.limit)) for end, at in zip(ends, found, strict=True)]
        if falls:
            ends.reverse()
        return Profile(
            name=self.name,
            unit=self.known.unit,
            value=self.shown(self.value),
            level=self.level,
            lower=ends[0].value,
            upper=ends[1].value,
            values=np.array([self.shown(place) for place in places]),
            rise=np.array([self.curve.rises[place] for place in places]) / self.scale,
            message=_message(self.curve, ends, self.scale, self.known.unit, self.goal, self.beyond),
            stderr=self.known.stderr,
            freedom=self.known.freedom,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Base:
    """What curves start from."""

    problem: Problem | CausedProblem  # with its noise as widened where priors keep their weight
    x: Float  # its minimum: the fitted vector, the sizes of causes after it
    covar: Float  # at the noise of the problem


def _settled(fit: FitResult) -> _Base:
    """The problem of a fit and its minimum, near which the fit is."""
    problem, x = fit.problem, fit.x
    caused = caused_problem(fit)
    if caused is not None:
        y, _ = caused.minimum()
        return _Base(problem=caused, x=y, covar=_inverse(caused.gauss_newton(y)[2]))
    covar = fit.covar / fit.widening
    if _is_scaled(problem) or fit.widening == 1 or not problem.priors:
        return _Base(problem=problem, x=x, covar=covar)
    widened = problem.with_noise(math.sqrt(fit.widening))
    lower, upper = box(problem)
    x = minimise(widened, np.clip(x, lower, upper), lower=lower, upper=upper).x
    return _Base(problem=widened, x=x, covar=covar)


def _inverse(curvature: Float) -> Float:
    size = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    return np.asarray(np.linalg.pinv(curvature / np.outer(size, size), hermitian=True) / np.outer(size, size))


def _is_scaled(problem: Problem) -> bool:
    """True if the cost's own curvature is not the variance."""
    return problem.loss != "linear" or math.isfinite(freedom_of(problem.blocks))


def _sizes(problem: Problem | CausedProblem, x: Float) -> Float:
    """Sizes of the entries: their own, or what is typical of the parameter."""
    if isinstance(problem, CausedProblem):
        own = x[: problem.count]
        return np.concatenate([_sizes(problem.problem, own), np.ones(x.size - own.size)])
    model, names = problem.space.model, problem.space.names
    typical = [model.parameter(bare_name(name)).scale for name in names] + [0.1] * len(problem.space.nuisance)
    return np.maximum(np.abs(x), typical)


def _scale(fit: FitResult, base: _Base, name: str) -> float:
    """Factor on the quantile; where the cost's own curvature is not the variance, that as reported over that of the
    curvature: the rise then has mean one (Kent 1982)."""
    if not _is_scaled(fit.problem):
        return 1.0 if fit.problem.priors or fit.settings.solved is not None else fit.widening
    if name not in fit.var_names:
        return 1.0
    i = fit.var_names.index(name)
    inverse = _inverse(fit.problem.hessian(fit.x) if fit.settings.solved is None else base.problem.hessian(base.x))
    return float(fit.covar[i, i] / inverse[i, i])


def _threshold(fit: FitResult, base: _Base, level: float, at: Mapping[str, Any] | None) -> _Line:
    """The threshold speed of a group."""
    group, problem, x = fit.group(at), base.problem, base.x
    speed, condition, onset = _speed(fit, group), _condition(fit, group), fit.onset(group)
    if isinstance(problem, CausedProblem):
        speed, condition, onset = *_beside_causes(fit, group, problem, speed, condition), None
    if onset is not None and np.array_equal(x, fit.x):
        value, slope = onset.speed, fit.problem.space.pull_back(onset.gradient, group)
    else:
        value, slope = speed(x)
    if not math.isfinite(value):
        if math.isfinite(fit.stability_band):
            raise ValueError(f"there is no threshold to profile: {onset_note(fit, group)}")
        raise ValueError("the fitted rotor is stable at every speed searched: there is no threshold to profile")
    covar = base.covar
    error = float(standard_error(slope, covar))
    direction = covar @ slope / error**2 if error > 0 else np.zeros_like(x)
    curve = Curve(QuantityConstraint(problem, speed, condition), value, x, problem.cost(x), direction)
    step = error if error > 0 else 0.1 * value
    given: dict[str, Any] = {
        "known": fit.threshold_speed(at),
        "name": THRESHOLD,
        "scale": _scale(fit, base, THRESHOLD),
        "level": level,
    }
    reach = limits(0.0, math.inf, value, value, step)
    return _Line(value=value, curve=curve, step=step, reach=reach, beyond=_beyond_tests(fit, at), **given)


def _parameter(fit: FitResult, held: EntryConstraint, base: _Base, name: str, level: float) -> _Line:
    """A fitted parameter."""
    if name not in fit.var_names:
        if name in fit.params:
            raise ValueError(f"{name} is known here, so nothing is fitted that could have a profile")
        raise KeyError(unknown_name("fitted parameter", name, (*fit.var_names, THRESHOLD)))
    i, problem, x, covar = fit.var_names.index(name), base.problem, base.x, base.covar
    known, value = fit.params[name], float(x[i])
    given: dict[str, Any] = {"known": known, "name": name, "scale": _scale(fit, base, name), "level": level}
    error = math.sqrt(max(float(covar[i, i]), 0.0)) if known.resolved else 0.0
    ratios = None if isinstance(problem, CausedProblem) else _leading(ratios_of(problem), i, x, known, covar)
    if ratios is not None and isinstance(problem, Problem):
        return _along_ratios(problem, ratios, x, error, given)
    direction = covar[:, i] / covar[i, i] if error > 0 else np.zeros_like(x)
    lower, upper = bounds_of(problem)
    size = float(_sizes(problem, x)[i])
    step = error if error > 0 else 0.1 * size
    curve = Curve(held, value, x, problem.cost(x), direction, i)
    reach = limits(float(lower[i]), float(upper[i]), value, size, step)
    return _Line(value=value, curve=curve, step=step, reach=reach, **given)


def _leading(ratios: Ratios | None, i: int, x: Float, known: FittedParameter, covar: Float) -> Ratios | None:
    """Coordinates in which a parameter is followed by its logarithm, None where it is followed as it is."""
    if ratios is None or ratios.entry == i:
        return ratios
    if known.resolved or i not in ratios.numerators:
        return None
    # Not determined, it goes with the others as far as that may be, if its ratio is known not to be zero.
    relative = covar / np.outer(x, x)
    error = math.sqrt(max(relative[i, i] - 2 * relative[i, ratios.entry] + relative[ratios.entry, ratios.entry], 0.0))
    largest_ratio_error = 0.2  # error of a ratio, over its value, up to which zero is five standard errors away
    return ratios.led_by(i, x) if error < largest_ratio_error else None


def _along_ratios(problem: Problem, ratios: Ratios, x: Float, error: float, given: Mapping[str, Any]) -> _Line:
    """Profile of a parameter to which others are ratios, by its logarithm: they stay the same, over four decades."""
    y = ratios.of(x)
    held = EntryConstraint(LogRatioProblem(problem, ratios), np.where(y == 0, 1.0, np.abs(y)))
    value, (lower, upper) = float(y[ratios.entry]), (float(bound[ratios.entry]) for bound in held.bounds)
    inertia_decades = 4  # that an inertia is followed to either side
    low, high = value - inertia_decades * math.log(10), value + inertia_decades * math.log(10)
    return _Line(
        value=value,
        curve=Curve(held, value, y, problem.cost(x), np.zeros_like(y), ratios.entry),
        step=min(error / abs(float(x[ratios.entry])), 1.0) if error > 0 else 1.0,
        reach=((max(low, lower), lower >= low), (min(high, upper), upper <= high)),
        shown=lambda place: ratios.size * math.exp(place),
        **given,
    )


def _speed(fit: FitResult, group: int) -> ValueAndGradient:
    """Threshold speed of a fitted vector and its gradient."""
    space = fit.problem.space

    def speed(vector: Float) -> tuple[float, Float]:
        try:
            found = threshold_speed(fit.model, space.theta(vector)[group], band=fit.stability_band)
        except np.linalg.LinAlgError:  # so far astray that the equations of motion overflow
            found = None
        if found is None:
            return math.inf, np.zeros_like(vector)
        return found.speed, space.pull_back(found.gradient, group)

    return speed


def _beside_causes(
    fit: FitResult, group: int, problem: CausedProblem, speed: ValueAndGradient, condition: Condition | None
) -> tuple[ValueAndGradient, Condition | None]:
    """The threshold speed of a vector with the sizes of causes after it, which move it by their slopes."""
    first, slopes = onset_by_causes(fit, group)
    slopes, count = slopes * problem.causes.size, problem.count

    def moved(y: Float) -> tuple[float, Float]:
        value, gradient = speed(y[:count])
        return value + first + float(slopes @ y[count:]), np.concatenate([gradient, slopes])

    if condition is None:
        return moved, None

    def held(y: Float, values: Float) -> tuple[Float, Float, Float]:
        missing, slope, by_value = condition(y[:, :count], values - first - y[:, count:] @ slopes)
        return missing, np.hstack([slope, -by_value[:, None] * slopes]), by_value

    return moved, held


def _condition(fit: FitResult, group: int) -> Condition | None:
    """The threshold speed as a condition: the least stable eigenvalue at that speed lies on the imaginary axis.

    It asks for the eigenvalues at one speed, not for a search along speeds. Other modes are stable there; what happens
    at lower speeds is taken to be as for the fitted rotor. ``None`` for rotors with undamped modes, of which the least
    stable one says nothing.
    """
    space, model, band = fit.problem.space, fit.model, fit.stability_band
    if model.turns or model.shaft is not None:
        return None

    def condition(x: Float, values: Float) -> tuple[Float, Float, Float]:
        s, by_speed, by_theta = least_stable(model, space.theta(x)[:, group], values, band=band)
        growing = np.where(by_speed.real > 0, by_speed.real, np.nan)
        return -s.real, space.pull_back(by_theta.real, group), growing

    return condition


def _grid(value: float, ends: list[End], points: int) -> list[float]:
    """Values a tenth beyond the interval (or up to the bound, or twice the other side where an end is open)."""
    width = [abs(end.value - value) for end in ends]
    finite = [w for w in width if math.isfinite(w)]
    spare = 2 * max(finite) if finite else max(abs(end.limit - value) for end in ends)
    outer = []
    for side, end, w in zip((-1, 1), ends, width, strict=True):
        way = 1.1 * w if math.isfinite(w) else spare
        outer.append(value + side * min(way, abs(end.limit - value)))
    below = np.linspace(value, outer[0], points // 2 + 1)
    above = np.linspace(value, outer[1], points - points // 2)
    return [*below.tolist(), *above.tolist()]  # outwards on either side: what is followed starts from its neighbour


def _beyond_tests(fit: FitResult, at: Mapping[str, Any] | None) -> str:
    """Warning of a threshold beyond the tests: an interval of one model knows nothing of its neighbours."""
    group = fit.group(at)
    note = onset_note(fit, group)
    if not note or not fit.settings.onsets:
        return note
    difference = fit.settings.onsets[group].difference * RPM_PER_RAD_S
    return (
        f"the onset lies beyond the tests, and the interval is that of this model alone: the candidates beside it "
        f"differ by {significant(difference, 2)} rpm, which the standard error includes"
    )


def _message(curve: Curve, ends: list[End], scale: float, unit: str, goal: float, beyond: str) -> str:
    unit = "" if unit == "1" else f" {unit}"

    def rise(size: float) -> str:
        return significant(size / scale, 3)

    parts = []
    for word, end in zip(("below", "above"), ends, strict=True):
        where = f"open {word}: beyond {end.limit:.6g}{unit}"
        if math.isinf(end.value) and not end.exact:
            found = f"where chi-squared has risen by {rise(end.rise)}, no minimum was found"
            parts.append(f"{where}, {found}; {rise(goal)} would end the interval")
        elif math.isinf(end.value):
            limit = "its bound" if end.at_bound else "far beyond any sensible value,"
            risen = f"chi-squared rises by {rise(end.rise)} only, {rise(goal)} would end the interval"
            parts.append(f"open {word}: up to {limit} {end.limit:.6g}{unit} {risen}")
        elif not end.exact:
            parts.append(f"the end {word} was not found to full precision")
    if curve.unsettled:
        parts.append(f"{curve.unsettled} points of the curve are not at a minimum to full precision")
    round_off_fall = 1e-4  # fall of the scaled curve below its minimum that is more than round-off
    if curve.lowest / scale < -round_off_fall:
        parts.append(
            f"chi-squared falls {rise(-curve.lowest)} below that of the fit on the way: the fit did not end in the "
            "lowest minimum, fit again from other start values"
        )
    return "; ".join([*parts, *([beyond] if beyond else [])])
