"""Stability of a fitted rotor: each criterion with its interval and the probability that it is met."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from numbers import Real
from typing import Any

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant
from rotorfit.base.names import unknown_name
from rotorfit.base.units import RPM_PER_RAD_S, in_rad_s
from rotorfit.estimators.inference.identifiability import UNSEEN_CHANGE
from rotorfit.identify.fitting.headline import rig_name
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.uncertainty.derived import DERIVED_DRAWS, SHAFT_DRAWS
from rotorfit.identify.uncertainty.predict import check_forced, check_read, check_rotor, extrapolation
from rotorfit.identify.uncertainty.stability.record import Criterion, StabilityReport
from rotorfit.identify.uncertainty.stability.rotors import Rotors, drawn_rotors, has_planes, rotors_of, unseen_rotors
from rotorfit.identify.uncertainty.stability.task import Limits, Question, Task
from rotorfit.models.coefficient_tables import loop_stiffness


def stability_report(
    fit: FitResult,
    *,
    max_speed: float | None = None,
    min_speed: float | None = None,
    max_speed_rpm: float | None = None,
    min_speed_rpm: float | None = None,
    min_decrement: float = 0.1,
    min_threshold_ratio: float = 1.0,
    cross_coupling: Mapping[str, float] | None = None,
    min_cross_coupling_ratio: float = 2.0,
    unbalance_g_mm: Mapping[str, float] | None = None,
    plane: str | None = None,
    max_amplitude_um: float | None = None,
    sensitivity: str | None = None,
    max_sensitivity: float = 3.0,
    cases: Mapping[str, Mapping[str, float]] | None = None,
    level: float = 0.95,
    at: Mapping[str, Any] | None = None,
    thetas: Float | None = None,
) -> StabilityReport:
    """Judge a fitted rotor, by the fit's covariance or over parameter vectors of draws, shape ``(W, P)``."""
    limits = Limits(min_decrement, min_threshold_ratio, min_cross_coupling_ratio, max_amplitude_um, max_sensitivity)
    for name, limit in limits._asdict().items():
        if limit is not None and not (isinstance(limit, Real) and 0 < float(limit) < math.inf):
            raise ValueError(f"{name} is {limit!r}; a limit is a positive, finite number")
    check_rotor(fit)
    group = fit.group(at)
    lowest = in_rad_s("min_speed", min_speed, needed=False, rpm=min_speed_rpm)
    highest = in_rad_s("max_speed", max_speed, needed=False, rpm=max_speed_rpm)
    running = _running(fit, lowest, highest, level)
    coupling = _at_planes(fit, cross_coupling, "cross-coupling")
    if coupling and not has_planes(fit.model):
        raise ValueError(f"{fit.model.name} is written in modes, where a cross-coupling at a plane has no place")
    unbalance = {where: mr * 1e-6 for where, mr in _at_planes(fit, unbalance_g_mm, "unbalance").items()}
    seen = _seen(fit, plane, unbalance, max_amplitude_um)
    _refuse_sensitivity(fit, sensitivity)
    task = Task(
        fit=fit,
        group=group,
        running=running,
        level=level,
        coupling=coupling,
        unbalance=unbalance,
        seen=seen,
        loop=sensitivity,
        limits=limits,
    )
    one, unseen = rotors_of(fit, fit.thetas[group][None], group), unseen_rotors(fit, group)
    many = drawn_rotors(fit, group, DERIVED_DRAWS if fit.model.shaft is None else SHAFT_DRAWS, thetas)
    judged = {"": {}, **(cases or {})}
    criteria = [
        found for case, factors in judged.items() for found in _criteria(task, case, factors, one, many, unseen)
    ]
    # Rotors from which bands of curves are read: a limit of 95 % is known to a tenth of a standard deviation
    curve_draws = 300
    few = many.part(slice(curve_draws))
    caution = (
        f"CAUTION: the model misses the data beyond their noise (redchi {significant(fit.redchi, 3)}). The rotor "
        "judged here may be another one, intervals too narrow and probabilities too sure."
    )
    return StabilityReport(
        criteria=tuple(criteria),
        modes=task.modes(one, many),
        running=running,
        level=level,
        draws=len(many.theta),
        curves={
            "decrement": partial(task.decrement_curves, one, few),
            "unbalance": partial(task.unbalance_curve, one, few),
            "cross_coupling": partial(task.coupling_curve, one, few),
            "sensitivity": partial(task.sensitivity_curve, one, few),
        },
        notes=_notes(fit, one, running),
        caution=caution if fit.model_limited else "",
        rig=rig_name(fit),
    )


def _running(fit: FitResult, lowest: float | None, highest: float | None, level: float) -> tuple[float, float]:
    """Lowest and highest running speed, rad/s, with the refusals."""
    if not 0 < level < 1:
        raise ValueError(f"level is {level!r}; an interval has a probability between 0 and 1")
    if not fit.success:
        raise ValueError(f"the fit did not converge, its rotor is not judged: {fit.message}")
    if fit.model.turns:
        raise ValueError(f"{fit.model.name} turns with the shaft; see its unstable bands in fit.summary()")
    if highest is None:
        if not fit.speeds.any():
            raise ValueError(
                "give the highest running speed (max_speed_rpm=, --max-speed): the tests were at rest or name no speeds"
            )
        highest = float(fit.speeds.max())
    lowest = highest if lowest is None else lowest
    if not (math.isfinite(lowest) and math.isfinite(highest) and 0 < lowest <= highest):
        ends = f"{lowest * RPM_PER_RAD_S:g} to {highest * RPM_PER_RAD_S:g} rpm"
        raise ValueError(f"running speeds are positive, the lowest first: got {ends}")
    return float(lowest), float(highest)


def _at_planes(fit: FitResult, given: Mapping[str, float] | None, what: str) -> dict[str, float]:
    if not isinstance(given, Mapping | None):
        raise TypeError(f"{what} is {given!r}; it is given by plane, {{{fit.model.planes[0]!r}: 30.0}}")
    for where, size in (given or {}).items():
        if where not in fit.model.planes:
            raise ValueError(unknown_name(f"plane of {what}", where, fit.model.planes))
        if not (isinstance(size, Real) and 0 < size < math.inf):
            raise ValueError(f"{what} at {where} is {size!r}; it is positive and finite")
    return dict(given or {})


def _seen(fit: FitResult, plane: str | None, unbalance: Mapping[str, float], limit: float | None) -> str:
    """Plane whose motion is judged."""
    if not unbalance and (plane is not None or limit is not None):
        raise ValueError(
            "the plane and its largest amplitude are of the unbalance response: give the unbalance too "
            "(unbalance_g_mm=, --unbalance)"
        )
    seen = next(iter(unbalance), "") if plane is None else plane
    for where in unbalance:
        check_forced(fit.model, where)
    if seen:
        check_read(fit.model, seen, "")
    return seen


def _refuse_sensitivity(fit: FitResult, plane: str | None) -> None:
    """Refuse a sensitivity function at a plane without a force that could be opened as a loop."""
    if plane is None:
        return
    model = fit.model
    if plane not in model.planes:
        raise ValueError(unknown_name("plane of sensitivity", plane, model.planes))
    if model.frame != "z":
        raise ValueError(f"{model.name} keeps x and y apart; a sensitivity function is that of one loop")
    if not loop_stiffness(model, fit.thetas[:1], np.array([1j]), 1.0, plane).any():
        raise ValueError(f"{model.name} has no bearing or seal at {plane} whose loop could be opened")


def _criteria(
    task: Task, case: str, factors: Mapping[str, float], one: Rotors, many: Rotors, unseen: Rotors
) -> list[Criterion]:
    """Answers about the rotor with some parameters times factors."""
    if not isinstance(factors, Mapping):
        raise TypeError(f"case {case!r} is {factors!r}; a case is factors by parameter, {{'K0': 1.3, 'D': 1.5}}")
    rotors = one.scaled(factors), many.scaled(factors), unseen.scaled(factors)
    try:
        return [_answer(question, case, *rotors, task) for question in task.questions(rotors[0])]
    except np.linalg.LinAlgError:
        who = f"case {case!r} leaves a rotor" if case else "the fit is a rotor"
        raise ValueError(f"{who} without stiffness, which cannot be judged") from None


def _answer(question: Question, case: str, one: Rotors, many: Rotors, unseen: Rotors, task: Task) -> Criterion:
    values, limits = (np.asarray(part, dtype=float) for part in question.ask(one))
    value, limit = float(values[0]), float(limits.ravel()[0])
    drawn, asked = question.ask(many)
    met = drawn >= asked if question.at_least else drawn <= asked
    probability, ends = float(np.mean(met)), task.quantiles(drawn)
    unlike = ~np.isclose(question.ask(unseen)[0], value, rtol=UNSEEN_CHANGE, atol=0.0) if unseen.theta.size else None
    if unlike is not None and unlike.any():
        probability, ends = math.nan, np.full(2, math.nan)
    return Criterion(
        name=question.name,
        case=case,
        value=value,
        interval=(float(ends[0]), float(ends[1])),
        unit=question.unit,
        limit=limit,
        at_least=question.at_least,
        probability=probability,
        source=question.source,
    )


def _notes(fit: FitResult, one: Rotors, running: tuple[float, float]) -> tuple[str, ...]:
    known = [fit.speeds] if fit.speeds.size else []
    found = extrapolation("running speeds", np.unique(running), known) if known else []
    least = [s for s in one.modes(running[1]) if s.imag > fit.band]
    if least:
        found.append(f"{len(least)} of the modes lie above the tested frequencies: they are extrapolated.")
    if fit.model.eccentricity_dependent:
        found.append("The rotor is judged for small motion about the centre of its bearings.")
    if fit.causes.rows:
        found.append("Intervals hold the causes beside the model (fit.causes).")
    return tuple(found)
