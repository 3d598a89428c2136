"""Stability of a fitted rotor: each criterion with its interval and the probability that it is met."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from numbers import Real
from typing import Any

import numpy as np

from rotorfit.estimators.inference.identifiability import UNSEEN_CHANGE
from rotorfit.fitting.quantities import THRESHOLD
from rotorfit.fitting.result import FitResult
from rotorfit.models import eigenvalues
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.digits import significant
from rotorfit.models.motion.stability import counted, threshold_speeds, whirls_forward
from rotorfit.models.parameters import unknown_name
from rotorfit.models.shafts.plane_forces import loop_stiffness
from rotorfit.uncertainty.derived import DERIVED_DRAWS, SHAFT_DRAWS
from rotorfit.uncertainty.onsets import onsets_of
from rotorfit.uncertainty.prediction import extrapolation
from rotorfit.uncertainty.stability.record import SENSITIVITY, Criterion, Curve, ModeDamping, StabilityReport
from rotorfit.uncertainty.stability.rotors import (
    Rotors,
    drawn_rotors,
    fitted_rotor,
    has_planes,
    unseen_rotors,
)
from rotorfit.uncertainty.stability.unbalance import Peaks, margin, margin_asked, peaks_near, peaks_of
from rotorfit.units import RAD_S_PER_RPM, RPM_PER_RAD_S


@dataclass(frozen=True, kw_only=True)
class _Question:
    """A criterion before it is answered: values and limits of many rotors, each shape ``(W,)`` or a number."""

    name: str
    unit: str
    source: str
    ask: Callable[[Rotors], tuple[Float, Float | float]]
    at_least: bool = True
    left_open: bool = False  # what the data do not show moves it by more than itself


def stability_report(
    fit: FitResult,
    *,
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
    _refuse_limits(
        min_decrement=min_decrement,
        min_threshold_ratio=min_threshold_ratio,
        min_cross_coupling_ratio=min_cross_coupling_ratio,
        max_amplitude_um=max_amplitude_um,
        max_sensitivity=max_sensitivity,
    )
    group = fit.group(at)
    running = _running(fit, min_speed_rpm, max_speed_rpm, level)
    coupling = _at_planes(fit, cross_coupling, "cross-coupling")
    if coupling and not has_planes(fit.model):
        raise ValueError(f"{fit.model.name} is written in modes, where a cross-coupling at a plane has no place")
    unbalance = {where: mr * 1e-6 for where, mr in _at_planes(fit, unbalance_g_mm, "unbalance").items()}
    seen = _seen(fit, plane, unbalance, max_amplitude_um)
    _refuse_sensitivity(fit, sensitivity)
    one, unseen = fitted_rotor(fit, group), unseen_rotors(fit, group)
    many = drawn_rotors(fit, group, DERIVED_DRAWS if fit.model.shaft is None else SHAFT_DRAWS, thetas)

    def questions(rotor: Rotors) -> list[_Question]:
        """Critical speeds and resonances of a loop are looked for where the rotor of the case has them."""
        asked = [_decrement_question(fit, running[1], min_decrement, {}, "")]
        if fit.model.speed_dependent:
            asked.append(
                _Question(
                    name="threshold speed over running speed",
                    unit="",
                    source="",
                    ask=lambda rotors: (_thresholds(fit, group, rotors) / running[1], min_threshold_ratio),
                    left_open=bool(fit.moved_by(THRESHOLD)),
                )
            )
        if coupling:
            asked.append(
                _Question(
                    name="cross-coupling at onset over that expected, Q0/Qa",
                    unit="",
                    source="Q0/Qa",
                    ask=lambda rotors: (_ratio_to_onset(fit, rotors, running[1], coupling), min_cross_coupling_ratio),
                )
            )
            asked.append(_decrement_question(fit, running[1], min_decrement, coupling, " with Qa"))
        if unbalance:
            speeds = _speeds_of_curves(fit, group, rotor, running[1])
            asked += _unbalance_questions(rotor, speeds, running, seen, unbalance, max_amplitude_um)
        if sensitivity is not None:
            w = _frequencies_of_loop(fit, rotor, running[1])
            asked.append(
                _Question(
                    name=f"peak of the sensitivity function at {sensitivity}",
                    unit="",
                    source=SENSITIVITY,
                    ask=lambda rotors: (rotors.sensitivity(w, running[1], sensitivity).max(axis=1), max_sensitivity),
                    at_least=False,
                )
            )
        return asked

    def answers(case: str, factors: Mapping[str, float]) -> list[Criterion]:
        if not isinstance(factors, Mapping):
            raise TypeError(f"case {case!r} is {factors!r}; a case is factors by parameter, {{'K0': 1.3, 'D': 1.5}}")
        rotors = one.scaled(factors), many.scaled(factors), unseen.scaled(factors)
        try:
            return [_answer(question, case, *rotors, level) for question in questions(rotors[0])]
        except np.linalg.LinAlgError:
            who = f"case {case!r} leaves a rotor" if case else "the fit is a rotor"
            raise ValueError(f"{who} without stiffness, which cannot be judged") from None

    criteria = [one for case, factors in {"": {}, **(cases or {})}.items() for one in answers(case, factors)]
    # Rotors from which bands of curves are read: a limit of 95 % is known to a tenth of a standard deviation
    curve_draws = 300
    few = many.part(slice(curve_draws))
    return StabilityReport(
        criteria=tuple(criteria),
        modes=_modes(fit, one, many, running[1], level),
        running=running,
        level=level,
        draws=len(many.theta),
        curves={
            "decrement": partial(_decrement_curves, fit, one, few, running[1], level),
            "unbalance": partial(_unbalance_curves, fit, group, one, few, running[1], seen, unbalance, level),
            "cross_coupling": partial(_coupling_curve, fit, one, few, running[1], coupling, level),
            "sensitivity": partial(_sensitivity_curve, fit, one, few, running[1], sensitivity, level),
        },
        notes=_notes(fit, one, running),
        caution=_caution(fit),
    )


def _refuse_limits(**limits: float | None) -> None:
    for name, limit in limits.items():
        if limit is not None and not (isinstance(limit, Real) and 0 < limit < math.inf):
            raise ValueError(f"{name} is {limit!r}; a limit is a positive, finite number")


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
        highest = float(fit.speeds.max()) * RPM_PER_RAD_S
    lowest = highest if lowest is None else lowest
    if not (math.isfinite(lowest) and math.isfinite(highest) and 0 < lowest <= highest):
        raise ValueError(f"running speeds are positive, the lowest first: got {lowest:g} to {highest:g} rpm")
    return lowest * RAD_S_PER_RPM, highest * RAD_S_PER_RPM


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
    if plane is not None and plane not in fit.model.read_planes:
        raise ValueError(unknown_name("plane", plane, fit.model.read_planes))
    return seen


def _answer(question: _Question, case: str, one: Rotors, many: Rotors, unseen: Rotors, level: float) -> Criterion:
    values, limits = (np.asarray(part, dtype=float) for part in question.ask(one))
    value, limit = float(values[0]), float(limits.ravel()[0])
    drawn, asked = question.ask(many)
    met = drawn >= asked if question.at_least else drawn <= asked
    probability, ends = float(np.mean(met)), _quantiles(drawn, level)
    if question.left_open:
        probability, ends = math.nan, np.full(2, math.nan)
    if unseen.theta.size:
        other = question.ask(unseen)[0]
        moved = ~np.isclose(other, value, rtol=UNSEEN_CHANGE, atol=0.0)
        if moved.any():
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


def _quantiles(drawn: Float, level: float) -> Float:
    """Equal shares outside on both sides, along the first axis; infinities are in order."""
    drawn = np.where(np.isnan(drawn), np.inf, drawn)
    return np.asarray(np.quantile(drawn, [(1 - level) / 2, (1 + level) / 2], axis=0, method="inverted_cdf"))


# ---- free vibration ----------------------------------------------------------------------------------------------


def _decrement(s: ComplexArray) -> Float:
    """Logarithmic decrement of eigenvalues; that of overdamped motion without oscillation is infinite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(-2 * math.pi * s.real / np.abs(s.imag))


def _reference(fit: FitResult, rotor: Rotors, speed: float) -> ComplexArray:
    """Modes of one rotor that count, in order of frequency."""
    model = fit.model
    found = eigenvalues(model, rotor.theta[0], speed)
    found = found[counted(model, found, fit.stability_band)]
    if model.frame == "xy":
        found = found[found.imag >= 0]
    return np.asarray(found[np.argsort(found.imag)])


def _least_decrement(fit: FitResult, rotors: Rotors, speed: float) -> Float:
    """Logarithmic decrement of the least stable forward mode of each rotor, shape ``(W,)``."""
    reference = _reference(fit, rotors.part(slice(1)), speed)
    forward = whirls_forward(fit.model, rotors.theta[0], speed, reference)
    if not fit.model.speed_dependent:  # the sense of rotation is not known
        forward = np.full(reference.size, True)
    if not forward.any():
        return np.full(len(rotors.theta), np.inf)
    return np.asarray(_decrement(rotors.eigenvalues(speed, reference)[:, forward]).min(axis=1))


def _decrement_question(
    fit: FitResult, speed: float, limit: float, coupling: Mapping[str, float], words: str
) -> _Question:
    def ask(rotors: Rotors) -> tuple[Float, float]:
        driven = rotors.coupled({where: np.array(q) for where, q in coupling.items()}) if coupling else rotors
        return _least_decrement(fit, driven, speed), limit

    name = f"log. decrement of the least stable forward mode{words}"
    return _Question(name=name, unit="", source="log. decrement", ask=ask)


def _thresholds(fit: FitResult, group: int, rotors: Rotors) -> Float:
    """Threshold speeds, infinite for rotors that are stable at every speed searched."""
    if len(rotors.theta) == 1 and np.array_equal(rotors.theta[0], fit.thetas[group]):
        speed = np.array([fit.threshold_of(group).value])
    elif len(rotors.theta) == 1:
        speed = threshold_speeds(fit.model, rotors.theta, band=fit.stability_band)[0]
    else:
        speed = onsets_of(fit, rotors.theta, group, seed=0).speed
    if rotors.onset_shifts:
        speed = np.maximum(speed + rotors.sizes @ np.array(rotors.onset_shifts), 0.0)
    return np.where(np.isnan(speed), np.inf, speed)


def _ratio_to_onset(fit: FitResult, rotors: Rotors, speed: float, coupling: Mapping[str, float]) -> Float:
    """Factor on the expected cross-coupling at which each rotor becomes unstable, infinite where none is found."""
    from scipy.optimize.elementwise import bracket_root, find_root

    def growth(factor: Float, at: Float) -> Float:
        some = rotors.part(at.astype(np.intp).ravel())
        driven = some.coupled({where: q * np.ravel(factor) for where, q in coupling.items()})
        return driven.growth(speed, fit.stability_band).reshape(np.shape(factor))

    number = np.arange(len(rotors.theta), dtype=float)
    start = np.zeros(number.size)
    stable = growth(start, number) < 0
    doublings = 12  # of the expected cross-coupling, up to which an onset is searched
    bracket = bracket_root(growth, start, start + 1.0, xmin=start, args=(number,), maxiter=doublings)
    root = find_root(growth, bracket.bracket, args=(number,), tolerances={"xrtol": 1e-6})
    return np.where(stable, np.where(bracket.success & root.success, root.x, np.inf), 0.0)


def _modes(fit: FitResult, one: Rotors, many: Rotors, speed: float, level: float) -> tuple[ModeDamping, ...]:
    reference = _reference(fit, one, speed)
    bands = _quantiles(_decrement(many.eigenvalues(speed, reference)), level).T
    forward = whirls_forward(fit.model, one.theta[0], speed, reference)
    found = [
        ModeDamping(
            frequency=float(s.imag),
            decrement=float(_decrement(np.array(s))),
            interval=(float(band[0]), float(band[1])),
            damping_ratio=float(-s.real / abs(s)),
            direction=_direction(ahead),
        )
        for s, band, ahead in zip(reference, bands, forward, strict=True)
    ]
    return tuple(sorted(found, key=lambda mode: mode.decrement))


def _direction(ahead: bool) -> str:
    return "forward" if ahead else "backward"


def _decrement_curves(fit: FitResult, one: Rotors, few: Rotors, top: float, level: float) -> tuple[Curve, ...]:
    """Decrement of the modes against speed, those that the highest running speed has."""
    tested = float(fit.speeds.max(initial=0.0))
    margin_of_curves = 1.25  # highest speed of curves, over the highest running or tested speed
    speeds = np.linspace(0.1, 1.0, 28) * margin_of_curves * max(top, tested)
    start = _reference(fit, one, top)
    forward = whirls_forward(fit.model, one.theta[0], top, start)
    values, bands = np.zeros((speeds.size, start.size)), np.zeros((speeds.size, start.size, 2))
    first = int(np.argmin(np.abs(speeds - top)))
    for order in (range(first, speeds.size), range(first - 1, -1, -1)):
        last = start
        for k in order:
            last = one.eigenvalues(float(speeds[k]), last)[0]
            values[k] = _decrement(last)
            bands[k] = _quantiles(_decrement(few.eigenvalues(float(speeds[k]), last)), level).T
    return tuple(
        Curve(
            label=f"{_direction(ahead)} mode, {abs(s.imag) * RPM_PER_RAD_S:.0f} rpm at {top * RPM_PER_RAD_S:.0f} rpm",
            x=speeds,
            y=values[:, k],
            band=bands[:, k],
        )
        for k, (s, ahead) in enumerate(zip(start, forward, strict=True))
    )


def _coupling_curve(
    fit: FitResult, one: Rotors, few: Rotors, speed: float, coupling: Mapping[str, float], level: float
) -> tuple[Curve, ...]:
    """Decrement of the least stable forward mode against the cross-coupling, at Qa over one plane."""
    if not coupling:
        return ()
    onset = float(_ratio_to_onset(fit, one, speed, coupling)[0])
    factors = np.linspace(0.0, 1.25 * max(onset if math.isfinite(onset) else 1.0, 1.0), 16)
    total = sum(coupling.values())
    values, bands = np.zeros(factors.size), np.zeros((factors.size, 2))
    for k, factor in enumerate(factors.tolist()):
        driven = {where: np.array(q * factor) for where, q in coupling.items()}
        values[k] = _least_decrement(fit, one.coupled(driven), speed)[0]
        bands[k] = _quantiles(_least_decrement(fit, few.coupled(driven), speed), level)
    return (Curve(label=f"cross-coupling at {', '.join(coupling)}", x=factors * total, y=values, band=bands),)


# ---- loop of a bearing ------------------------------------------------------------------------------------------


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


def _frequencies_of_loop(fit: FitResult, rotor: Rotors, speed: float) -> Float:
    """Signed frequencies up to the tested ones and the modes', close to one another at resonances. What the model
    leaves out grows with powers of the frequency: further up it would be all there is."""
    modes = _reference(fit, rotor, speed)
    modes = modes[np.abs(modes.imag) > 0]
    top = max([fit.band, *np.abs(modes.imag).tolist()])
    grid = [np.linspace(-top, top, 401)]
    grid += [s.imag + abs(s.real) * np.linspace(-4.0, 4.0, 81) for s in modes]
    every = np.unique(np.concatenate(grid))
    return np.asarray(every[np.abs(every) <= top])


def _sensitivity_curve(
    fit: FitResult, one: Rotors, few: Rotors, speed: float, plane: str | None, level: float
) -> tuple[Curve, ...]:
    if plane is None:
        return ()
    w = _frequencies_of_loop(fit, one, speed)
    band = _quantiles(few.sensitivity(w, speed, plane), level).T
    return (Curve(label=f"sensitivity at {plane}", x=w, y=one.sensitivity(w, speed, plane)[0], band=band),)


# ---- unbalance response ------------------------------------------------------------------------------------------


def _speeds_of_curves(fit: FitResult, group: int, one: Rotors, top: float) -> Float:
    """Speeds of unbalance responses, close to one another at resonances, below the threshold speed."""
    threshold = float(_thresholds(fit, group, one)[0]) if fit.model.speed_dependent else math.inf
    end = 2.5 * top
    if threshold > top:
        end = min(end, threshold)
    grid = [np.linspace(0.02, 1.0, 240) * end]
    for speed in grid[0][::4].tolist():
        s = _reference(fit, one, speed)
        s = s[np.abs(s.imag - speed) < 0.02 * end]  # resonances, which the next of these speeds would find too
        grid += [z.imag + abs(z.real) * np.linspace(-4.0, 4.0, 41) for z in s if abs(z.real) < 0.02 * end]
    every = np.unique(np.concatenate(grid))
    return np.asarray(every[(every > 0.02 * end) & (every <= end)])


def _unbalance_questions(
    one: Rotors,
    speeds: Float,
    running: tuple[float, float],
    seen: str,
    unbalance: Mapping[str, float],
    max_amplitude_um: float | None,
) -> list[_Question]:
    curve = one.response(speeds, seen, unbalance)[0]
    near = peaks_near(curve)
    found = peaks_of(speeds, curve[None], near) if near.size else []

    @lru_cache(maxsize=8)
    def peaks(rotors: Rotors) -> list[Peaks]:
        return peaks_of(speeds, rotors.response(speeds, seen, unbalance), near)

    def separation(rotors: Rotors, number: int) -> tuple[Float, Float]:
        peak = peaks(rotors)[number]
        there = margin(np.where(np.isnan(peak.speed), np.inf, peak.speed), *running)
        return 100 * there, 100 * margin_asked(np.nan_to_num(peak.amplification), peak.speed < running[0])

    questions = [
        _Question(
            name=f"margin of critical speed {float(peak.speed[0]) * RPM_PER_RAD_S:.0f} rpm at {seen}, "
            + (f"AF {significant(float(peak.amplification[0]), 3)}" if peak.amplification[0] else "AF not defined"),
            unit="%",
            source="separation margin",
            ask=partial(separation, number=number),
        )
        for number, peak in enumerate(found)
    ]
    if max_amplitude_um is not None:
        inside = np.unique([*running, *speeds[(speeds >= running[0]) & (speeds <= running[1])]])
        questions.append(
            _Question(
                name=f"largest amplitude at {seen}",
                unit="um",
                source="",
                ask=lambda rotors: (1e6 * rotors.response(inside, seen, unbalance).max(axis=1), max_amplitude_um),
                at_least=False,
            )
        )
    return questions


def _unbalance_curves(
    fit: FitResult,
    group: int,
    one: Rotors,
    few: Rotors,
    top: float,
    seen: str,
    unbalance: Mapping[str, float],
    level: float,
) -> tuple[Curve, ...]:
    if not unbalance:
        return ()
    speeds = _speeds_of_curves(fit, group, one, top)
    band = _quantiles(few.response(speeds, seen, unbalance), level).T
    weights = ", ".join(f"{significant(mr * 1e6, 3)} g mm at {where}" for where, mr in unbalance.items())
    return (Curve(label=f"{seen}, {weights}", x=speeds, y=one.response(speeds, seen, unbalance)[0], band=band),)


def _caution(fit: FitResult) -> str:
    """A warning where the model misses the data."""
    if not fit.model_limited:
        return ""
    return (
        f"CAUTION: the model misses the data beyond their noise (redchi {significant(fit.redchi, 3)}). The "
        "rotor judged here may "
        "be another one, intervals too narrow and probabilities too sure."
    )


def _notes(fit: FitResult, one: Rotors, running: tuple[float, float]) -> tuple[str, ...]:
    known = [fit.speeds] if fit.speeds.size else []
    found = extrapolation("running speeds", np.unique(running), known) if known else []
    least = [s for s in _reference(fit, one, running[1]) if s.imag > fit.band]
    if least:
        found.append(f"{len(least)} of the modes lie above the tested frequencies: they are extrapolated.")
    if fit.model.eccentricity_dependent:
        found.append("The rotor is judged for small motion about the centre of its bearings.")
    if fit.moved_by(THRESHOLD):
        found.append(f"The threshold speed is not determined: {fit.moved_by(THRESHOLD)}.")
    if len(fit.thetas) > 1:
        found.append("Intervals hold the statistical errors only: parameters were fitted per attribute.")
    elif fit.assumed.entries:
        found.append("Intervals hold the systematic share of fit.assumptions() too.")
    return tuple(found)
