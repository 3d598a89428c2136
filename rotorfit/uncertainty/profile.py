"""Profile-likelihood intervals of a fit: how far a parameter may move before the data object."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.estimators.blocks.correlated import freedom_of, quantile
from rotorfit.estimators.inference.covariance import standard_error
from rotorfit.estimators.inference.log_posterior import box
from rotorfit.estimators.inference.profile_curve import (
    Condition,
    Curve,
    End,
    HeldEntry,
    HeldQuantity,
    ValueAndGradient,
    limits,
)
from rotorfit.estimators.minimisation.least_squares import minimise
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.fitting.digits import interval, with_error
from rotorfit.fitting.result import FitResult
from rotorfit.models import threshold_speed
from rotorfit.models.array_types import Float
from rotorfit.models.parameters import bare_name, unknown_name
from rotorfit.models.stability import Threshold, least_stable, threshold_speed_near
from rotorfit.units import RPM_PER_RAD_S

if TYPE_CHECKING:
    from matplotlib.figure import Figure


THRESHOLD = "threshold_speed"
_LOWER_MINIMUM = 1e-4  # fall of the scaled curve below its minimum that is more than round-off


@dataclass(frozen=True, eq=False, kw_only=True)
class Profile:
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

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end."""
        return self.lower, self.upper

    @property
    def goal(self) -> float:
        """Rise at the ends of the interval: quantile of chi-squared, of F where few differences tell the noise."""
        return quantile(self.level, self.freedom) ** 2

    def plot(self) -> Figure:
        """The curve with the level and the ends, beside the parabola that the standard error stands for."""
        from rotorfit.plots.uncertainty import plot_profile

        factor, unit = self._shown
        return plot_profile(
            self.values * factor,
            self.rise,
            label=self.name.replace("_", " ") + ("" if unit == "1" else f" ({unit})"),
            estimate=self.value * factor,
            stderr=self.stderr * factor,
            goal=self.goal,
            ends=[end * factor for end in self.interval],
        )

    @property
    def _shown(self) -> tuple[float, str]:
        """Factor and unit for readers: speeds in rpm, as the summary has them."""
        return (RPM_PER_RAD_S, "rpm") if self.unit == "rad/s" else (1.0, self.unit)

    def __str__(self) -> str:
        factor, unit = self._shown
        value, ends = (
            with_error(factor * self.value, factor * self.stderr)[0],
            interval(factor * self.lower, factor * self.upper),
        )
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

    Args:
        fit: the result.
        name: a fitted parameter, or "threshold_speed" (rad/s).
        level: probability of the interval.
        points: number of values at which the curve is given, from a little below the interval to a little above.
        at: group of parameters that the threshold speed belongs to.

    Raises:
        KeyError: no such parameter.
        ValueError: a known parameter, a level outside 0 to 1, or a rotor without a threshold.
    """
    if not 0 < level < 1:
        raise ValueError(f"level is {level}; it must be between 0 and 1, for instance 0.95")
    if points < 3:
        raise ValueError(f"points is {points}; a curve needs at least 3")
    problem, x, scale = _settled(fit, name)
    value, unit, curve, step, reach = _curve(fit, problem, x, name, at)
    known = fit.threshold_speed(at) if name == THRESHOLD else fit.params[name]
    goal = quantile(level, known.freedom) ** 2 * scale
    ends = curve.ends(goal, math.sqrt(goal) * step, reach)
    values, rise = _grid(curve, value, ends, points)
    return Profile(
        name=name,
        unit=unit,
        value=value,
        level=level,
        lower=ends[0].value,
        upper=ends[1].value,
        values=values,
        rise=rise / scale,
        message=_message(curve, ends, scale, unit, goal, _beyond_tests(fit, at) if name == THRESHOLD else ""),
        stderr=known.stderr,
        freedom=known.freedom,
    )


def _settled(fit: FitResult, name: str) -> tuple[Problem, Float, float]:
    """The problem with its noise as widened, its minimum, and the factor on the quantile."""
    problem, x = fit.problem, fit.x
    if fit.method == "closed form":
        raise ValueError("a closed form is not a minimum, so it has no profile; use the result of rf.fit")
    if problem.loss != "linear" or math.isfinite(freedom_of(problem.blocks)):
        return problem, x, _robust_scale(fit, name)
    if fit.widening == 1:
        return problem, x, 1.0
    if not problem.priors:
        return problem, x, fit.widening
    root = math.sqrt(fit.widening)
    blocks = [block.with_noise(np.full(block.measured.size, root)) for block in problem.blocks]
    widened = replace(problem, blocks=tuple(blocks))
    lower, upper = box(problem)
    return widened, minimise(widened, np.clip(x, lower, upper), lower=lower, upper=upper).x, 1.0


def _robust_scale(fit: FitResult, name: str) -> float:
    """Variance as reported over that of the cost's own curvature: the rise then has mean one (Kent 1982)."""
    if name not in fit.var_names:
        return 1.0
    i = fit.var_names.index(name)
    curvature = fit.problem.hessian(fit.x)
    size = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    inverse = np.linalg.pinv(curvature / np.outer(size, size), hermitian=True) / np.outer(size, size)
    return float(fit.covar[i, i] / inverse[i, i])


def _curve(
    fit: FitResult, problem: Problem, x: Float, name: str, at: Mapping[str, Any] | None
) -> tuple[float, str, Curve, float, tuple[tuple[float, bool], ...]]:
    """Value, unit and curve of what is profiled, its guessed standard error, and how far it can go."""
    covar = fit.covar / fit.widening
    if name == THRESHOLD:
        group = fit.group(at)

        speed = _speed(fit, group)
        value, slope = speed(x)
        if not math.isfinite(value):
            if math.isfinite(fit.stability_band):
                raise ValueError(f"there is no threshold to profile: {fit.onset_note(group)}")
            raise ValueError("the fitted rotor is stable at every speed searched: there is no threshold to profile")
        error = float(standard_error(slope, covar))
        direction = covar @ slope / error**2 if error > 0 else np.zeros_like(x)
        held = HeldQuantity(problem, speed, _condition(fit, group))
        curve = Curve(held, value, x, problem.cost(x), direction)
        return value, "rad/s", curve, *_reach(0.0, math.inf, value, value, error)
    if name not in fit.var_names:
        if name in fit.params:
            raise ValueError(f"{name} is known here, so nothing is fitted that could have a profile")
        raise KeyError(unknown_name("fitted parameter", name, (*fit.var_names, THRESHOLD)))
    i = fit.var_names.index(name)
    p = fit.params[name]
    error = math.sqrt(max(float(covar[i, i]), 0.0)) if p.resolved else 0.0
    direction = covar[:, i] / covar[i, i] if error > 0 else np.zeros_like(x)
    lower, upper = box(problem)
    typical = problem.space.model.parameter(bare_name(name)).scale if i < len(problem.space.names) else 0.1
    size = max(abs(float(x[i])), typical)
    scale = np.maximum(np.abs(x), 1e-6 * size)
    curve = Curve(HeldEntry(problem, i, scale), float(x[i]), x, problem.cost(x), direction)
    return float(x[i]), p.unit, curve, *_reach(lower[i], upper[i], float(x[i]), size, error)


def _speed(fit: FitResult, group: int) -> ValueAndGradient:
    """Threshold speed of a fitted vector and its gradient, each found from the one before."""
    space, model, band = fit.problem.space, fit.model, fit.stability_band
    last: Threshold | None = fit.onset(group)

    def speed(vector: Float) -> tuple[float, Float]:
        nonlocal last
        theta = space.theta(vector)[group]
        found = threshold_speed_near(model, theta, last, band=band) if last else None
        last = found or threshold_speed(model, theta, band=band)
        if last is None:
            return math.inf, np.zeros_like(vector)
        return last.speed, space.pull_back(last.gradient, group)

    return speed


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


def _reach(
    low: float, high: float, value: float, size: float, error: float
) -> tuple[float, tuple[tuple[float, bool], ...]]:
    step = error if error > 0 else 0.1 * size
    return step, limits(float(low), float(high), value, size, step)


def _grid(curve: Curve, value: float, ends: list[End], points: int) -> tuple[Float, Float]:
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
    # outwards on either side: every point starts from its neighbour
    places = [*below.tolist(), *above.tolist()]
    rises = dict(zip(places, curve(places), strict=True))
    values = np.array(sorted(rises))
    return values, np.array([rises[v] for v in values.tolist()])


def _beyond_tests(fit: FitResult, at: Mapping[str, Any] | None) -> str:
    """What to say of a threshold beyond what was tested: an interval of one model knows nothing of its neighbours."""
    group = fit.group(at)
    note = fit.onset_note(group)
    if not note or not fit.settings.onsets:
        return note
    difference = fit.settings.onsets[group].difference * RPM_PER_RAD_S
    return (
        f"the onset lies beyond the tests, and the interval is that of this model alone: the models beside it on the "
        f"ladder differ by {difference:.2g} rpm, which the standard error includes"
    )


def _message(curve: Curve, ends: list[End], scale: float, unit: str, goal: float, beyond: str) -> str:
    unit = "" if unit == "1" else f" {unit}"
    parts = []
    for word, end in zip(("below", "above"), ends, strict=True):
        if math.isinf(end.value):
            where = "its bound" if end.at_bound else "far beyond any sensible value,"
            parts.append(
                f"open {word}: up to {where} {end.limit:.6g}{unit} chi-squared rises by {end.rise / scale:.3g} only, "
                f"{goal / scale:.3g} would end the interval"
            )
        elif not end.exact:
            parts.append(f"the end {word} was not found to full precision")
    if curve.unsettled:
        parts.append(f"{curve.unsettled} points of the curve are not at a minimum to full precision")
    if curve.lowest / scale < -_LOWER_MINIMUM:
        parts.append(
            f"chi-squared falls {-curve.lowest / scale:.3g} below that of the fit on the way: the fit did not end in "
            "the lowest minimum, fit again from other start values"
        )
    return "; ".join([*parts, *([beyond] if beyond else [])])
