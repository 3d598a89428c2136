"""What is asked about the stability of a rotor: criteria, and curves beside them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from rotorfit.base.array_types import Bool, Float, Index
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.uncertainty.derived import onsets_of
from rotorfit.identify.uncertainty.stability.record import DIRECTIONS, SENSITIVITY, Curve, ModeDamping
from rotorfit.identify.uncertainty.stability.rotors import Rotors, decrement
from rotorfit.models.motion.stability import threshold_speeds, whirl_sense


@dataclass(frozen=True, kw_only=True)
class Question:
    """A criterion before it is answered: values and limits of many rotors, each shape ``(W,)`` or a number."""

    name: str
    ask: Callable[[Rotors], tuple[Float, Float | float]]
    unit: str = ""
    source: str = ""
    at_least: bool = True


class Limits(NamedTuple):
    """Limits of the answers, by the names under which a user gives them."""

    min_decrement: float
    min_threshold_ratio: float
    min_cross_coupling_ratio: float
    max_amplitude_um: float | None
    max_sensitivity: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """A fitted rotor, what it must stand, and the probability of bands."""

    fit: FitResult
    group: int  # of its parameters
    running: tuple[float, float]  # lowest and highest running speed, rad/s
    level: float
    coupling: Mapping[str, float]  # cross-coupled stiffness by plane, N/m
    unbalance: Mapping[str, float]  # by plane, kg m
    seen: str  # plane whose motion is judged
    loop: str | None  # plane of the bearing whose sensitivity function is judged
    limits: Limits

    def questions(self, rotor: Rotors) -> list[Question]:
        """All that is asked; critical speeds and resonances of a loop are looked for where this rotor has them."""
        limits = self.limits
        asked = [self.decrement_question(limits.min_decrement, {})]
        if self.fit.model.speed_dependent:
            asked.append(self.threshold_question(limits.min_threshold_ratio))
        if self.coupling:
            asked.append(self.coupling_question(limits.min_cross_coupling_ratio))
            asked.append(self.decrement_question(limits.min_decrement, self.coupling, " with Qa"))
        if self.unbalance:
            asked += self.unbalance_questions(rotor, limits.max_amplitude_um)
        if self.loop is not None:
            asked.append(self.loop_question(rotor, limits.max_sensitivity))
        return asked

    def quantiles(self, drawn: Float) -> Float:
        """Equal shares outside on both sides, along the first axis; infinities are in order."""
        drawn = np.where(np.isnan(drawn), np.inf, drawn)
        ends = [(1 - self.level) / 2, (1 + self.level) / 2]
        return np.asarray(np.quantile(drawn, ends, axis=0, method="inverted_cdf"))

    # ---- free vibration ------------------------------------------------------------------------------------------

    def decrement_question(self, limit: float, coupling: Mapping[str, float], words: str = "") -> Question:
        """Decrement of the least stable forward mode."""
        forward = "forward " * self.fit.model.speed_dependent

        def ask(rotors: Rotors) -> tuple[Float, float]:
            return (rotors.coupled(coupling) if coupling else rotors).least_decrement(self.running[1]), limit

        name = f"log. decrement of the least stable {forward}mode{words}"
        return Question(name=name, source="log. decrement", ask=ask)

    def threshold_question(self, limit: float) -> Question:
        """Threshold speed over running speed."""
        return Question(
            name="threshold speed over running speed",
            ask=lambda rotors: (self._thresholds(rotors) / self.running[1], limit),
        )

    def _thresholds(self, rotors: Rotors) -> Float:
        """Threshold speeds, infinite for rotors that are stable at every speed searched."""
        fit = self.fit
        if len(rotors.theta) == 1 and np.array_equal(rotors.theta[0], fit.thetas[self.group]):
            speed = np.array([fit.threshold_of(self.group).value])  # causes included
            return np.where(np.isnan(speed), np.inf, speed)
        if len(rotors.theta) == 1:
            speed = threshold_speeds(fit.model, rotors.theta, band=fit.stability_band)[0]
        else:
            speed = onsets_of(fit, rotors.theta, self.group, seed=0).speed
        if rotors.onset_shifts:
            speed = np.maximum(speed + rotors.sizes @ np.array(rotors.onset_shifts), 0.0)
        return np.where(np.isnan(speed), np.inf, speed)

    def coupling_question(self, limit: float) -> Question:
        """Cross-coupling at the onset over that expected."""
        name = "cross-coupling at onset over that expected, Q0/Qa"
        return Question(name=name, source="Q0/Qa", ask=lambda rotors: (self._ratio_to_onset(rotors), limit))

    def _ratio_to_onset(self, rotors: Rotors) -> Float:
        """Factor on the expected cross-coupling at which each rotor becomes unstable, infinite where none is found."""
        from scipy.optimize.elementwise import bracket_root, find_root

        def growth(factor: Float, at: Float) -> Float:
            driven = rotors.part(at.astype(np.intp).ravel()).coupled(self.coupling, factor)
            return driven.growth(self.running[1]).reshape(np.shape(factor))

        number = np.arange(len(rotors.theta), dtype=float)
        start = np.zeros(number.size)
        stable = growth(start, number) < 0
        doublings = 12  # of the expected cross-coupling, up to which an onset is searched
        bracket = bracket_root(growth, start, start + 1.0, xmin=start, args=(number,), maxiter=doublings)
        root = find_root(growth, bracket.bracket, args=(number,), tolerances={"xrtol": 1e-6})
        return np.where(stable, np.where(bracket.success & root.success, root.x, np.inf), 0.0)

    def modes(self, one: Rotors, many: Rotors) -> tuple[ModeDamping, ...]:
        """Modes at the highest running speed, the least damped first."""
        speed = self.running[1]
        reference = one.modes(speed)
        values = one.eigenvalues(speed, reference)[0]  # with the causes, as the bands
        bands = self.quantiles(decrement(many.eigenvalues(speed, reference))).T
        senses = whirl_sense(self.fit.model, one.theta[0], speed, reference)
        found = [
            ModeDamping(
                frequency=float(s.imag),
                decrement=float(decrement(np.array(s))),
                interval=(float(band[0]), float(band[1])),
                damping_ratio=float(-s.real / abs(s)),
                direction=DIRECTIONS[sense],
            )
            for s, band, sense in zip(values, bands, senses.tolist(), strict=True)
        ]
        return tuple(sorted(found, key=lambda mode: mode.decrement))

    def decrement_curves(self, one: Rotors, few: Rotors) -> tuple[Curve, ...]:
        """Decrement of the modes against speed, those that the highest running speed has."""
        top = self.running[1]
        margin_of_curves = 1.25  # highest speed of curves, over the highest running or tested speed
        speeds = np.linspace(0.1, 1.0, 28) * margin_of_curves * max(top, float(self.fit.speeds.max(initial=0.0)))
        start = one.modes(top)
        senses = whirl_sense(self.fit.model, one.theta[0], top, start)
        values, bands = np.zeros((speeds.size, start.size)), np.zeros((speeds.size, start.size, 2))
        first = int(np.argmin(np.abs(speeds - top)))
        for order in (range(first, speeds.size), range(first - 1, -1, -1)):
            last = start
            for k in order:
                last = one.eigenvalues(float(speeds[k]), last)[0]
                values[k] = decrement(last)
                bands[k] = self.quantiles(decrement(few.eigenvalues(float(speeds[k]), last))).T
        at = f"at {top * RPM_PER_RAD_S:.0f} rpm"
        names = [f"{DIRECTIONS[sense]} mode" if sense else "mode" for sense in senses.tolist()]
        labels = [f"{n}, {abs(s.imag) * RPM_PER_RAD_S:.0f} rpm {at}" for n, s in zip(names, start, strict=True)]
        return tuple(Curve(label=label, x=speeds, y=values[:, k], band=bands[:, k]) for k, label in enumerate(labels))

    def coupling_curve(self, one: Rotors, few: Rotors) -> tuple[Curve, ...]:
        """Decrement of the least stable forward mode against the cross-coupling, at Qa over one plane."""
        if not self.coupling:
            return ()
        onset, speed = float(self._ratio_to_onset(one)[0]), self.running[1]
        factors = np.linspace(0.0, 1.25 * max(onset if math.isfinite(onset) else 1.0, 1.0), 16)
        found = [[some.coupled(self.coupling, f).least_decrement(speed) for some in (one, few)] for f in factors]
        values = np.array([own[0] for own, _ in found])
        bands = np.array([self.quantiles(drawn) for _, drawn in found])
        label = f"cross-coupling at {', '.join(self.coupling)}"
        return (Curve(label=label, x=factors * sum(self.coupling.values()), y=values, band=bands),)

    # ---- loop of a bearing ---------------------------------------------------------------------------------------

    def loop_question(self, rotor: Rotors, limit: float) -> Question:
        """Peak of the sensitivity function, looked for where the rotor of the case has resonances."""
        w = self._frequencies_of_loop(rotor)
        return Question(
            name=f"peak of the sensitivity function at {self.loop}",
            source=SENSITIVITY,
            ask=lambda rotors: (rotors.sensitivity(w, self.running[1], str(self.loop)).max(axis=1), limit),
            at_least=False,
        )

    def _frequencies_of_loop(self, rotor: Rotors) -> Float:
        """Signed frequencies up to the tested ones and the modes', close to one another at resonances. What the model
        leaves out grows with powers of the frequency: further up it would be all there is."""
        modes = rotor.modes(self.running[1])
        modes = modes[np.abs(modes.imag) > 0]
        top = max([self.fit.band, *np.abs(modes.imag).tolist()])
        grid = [np.linspace(-top, top, 401)]
        grid += [s.imag + abs(s.real) * np.linspace(-4.0, 4.0, 81) for s in modes]
        every = np.unique(np.concatenate(grid))
        return np.asarray(every[np.abs(every) <= top])

    def sensitivity_curve(self, one: Rotors, few: Rotors) -> tuple[Curve, ...]:
        """Modulus of the sensitivity function against frequency."""
        if self.loop is None:
            return ()
        w, at = self._frequencies_of_loop(one), (self.running[1], self.loop)
        band = self.quantiles(few.sensitivity(w, *at)).T
        return (Curve(label=f"sensitivity at {self.loop}", x=w, y=one.sensitivity(w, *at)[0], band=band),)

    # ---- unbalance response --------------------------------------------------------------------------------------

    def _speeds_of_curves(self, one: Rotors) -> Float:
        """Speeds of unbalance responses, close to one another at resonances, below the threshold speed."""
        threshold = float(self._thresholds(one)[0]) if self.fit.model.speed_dependent else math.inf
        top = self.running[1]
        end = min(2.5 * top, threshold) if threshold > top else 2.5 * top
        grid = [np.linspace(0.02, 1.0, 240) * end]
        for speed in grid[0][::4].tolist():
            s = one.modes(speed)
            s = s[np.abs(s.imag - speed) < 0.02 * end]  # resonances, which the next of these speeds would find too
            grid += [z.imag + abs(z.real) * np.linspace(-4.0, 4.0, 41) for z in s if abs(z.real) < 0.02 * end]
        every = np.unique(np.concatenate(grid))
        return np.asarray(every[(every > 0.02 * end) & (every <= end)])

    def unbalance_questions(self, one: Rotors, max_amplitude_um: float | None) -> list[Question]:
        """Margins of the critical speeds that the rotor of the case has, and the largest amplitude."""
        from scipy.signal import find_peaks

        speeds, running = self._speeds_of_curves(one), self.running
        curve = one.response(speeds, self.seen, self.unbalance)[0]
        near = find_peaks(curve)[0]
        found = peaks_of(speeds, curve[None], near) if near.size else []

        @lru_cache(maxsize=8)
        def peaks(rotors: Rotors) -> list[Peaks]:
            return peaks_of(speeds, rotors.response(speeds, self.seen, self.unbalance), near)

        def separation(rotors: Rotors, number: int) -> tuple[Float, Float]:
            peak = peaks(rotors)[number]
            there = margin(np.where(np.isnan(peak.speed), np.inf, peak.speed), *running)
            return 100 * there, 100 * margin_asked(np.nan_to_num(peak.amplification), peak.speed < running[0])

        def words(peak: Peaks) -> str:
            factor = float(peak.amplification[0])
            damped = f"AF {significant(factor, 3)}" if factor else "AF not defined"
            return f"margin of critical speed {float(peak.speed[0]) * RPM_PER_RAD_S:.0f} rpm at {self.seen}, {damped}"

        questions = [
            Question(name=words(peak), unit="%", source="separation margin", ask=partial(separation, number=number))
            for number, peak in enumerate(found)
        ]
        if max_amplitude_um is None:
            return questions
        inside = np.unique([*running, *speeds[(speeds >= running[0]) & (speeds <= running[1])]])

        def largest(rotors: Rotors) -> tuple[Float, float]:
            return 1e6 * rotors.response(inside, self.seen, self.unbalance).max(axis=1), max_amplitude_um

        name = f"largest amplitude at {self.seen}"
        return [*questions, Question(name=name, unit="um", ask=largest, at_least=False)]

    def unbalance_curve(self, one: Rotors, few: Rotors) -> tuple[Curve, ...]:
        """Amplitude against speed."""
        if not self.unbalance:
            return ()
        speeds, at = self._speeds_of_curves(one), (self.seen, self.unbalance)
        band = self.quantiles(few.response(speeds, *at)).T
        weights = ", ".join(f"{significant(mr * 1e6, 3)} g mm at {where}" for where, mr in self.unbalance.items())
        return (Curve(label=f"{self.seen}, {weights}", x=speeds, y=one.response(speeds, *at)[0], band=band),)


# ---- critical speeds of unbalance responses: amplification factors and separation margins ----------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class Peaks:
    """One critical speed of many rotors."""

    speed: Float  # of the peak, shape ``(W,)``, NaN for rotors without a peak there
    amplification: Float  # ``N_c / (N_2 - N_1)``, zero where one side does not fall to 0.707 of the peak


def peaks_of(speed: Float, amplitudes: Float, near: Index) -> list[Peaks]:
    """The peaks of many curves ``(W, S)`` that belong to those of a reference curve."""
    middle = (near[1:] + near[:-1]) // 2
    edges = [0, *middle.tolist(), speed.size]
    found = []
    for low, high in pairwise(edges):
        pairs = np.array([_peak(speed, curve, low, high) for curve in amplitudes]).reshape(-1, 2)
        found.append(Peaks(speed=pairs[:, 0], amplification=pairs[:, 1]))
    return found


def _peak(speed: Float, curve: Float, low: int, high: int) -> tuple[float, float]:
    from scipy.signal import peak_widths

    at = low + int(np.argmax(curve[low:high]))
    if at in (0, speed.size - 1) or not curve[at - 1] < curve[at] >= curve[at + 1]:
        return np.nan, np.nan
    half_power = 1 / np.sqrt(2.0)  # share of a peak's amplitude between whose speeds the amplification factor is read
    places = np.array([at])
    whole = (curve[places], np.array([0]), np.array([speed.size - 1]))  # down to zero, not to the next valley
    _, _, left, right = peak_widths(curve, places, rel_height=1 - half_power, prominence_data=whole)
    ends = np.interp([left[0], right[0]], np.arange(speed.size), speed)
    reached = curve[[int(np.floor(left[0])), int(np.ceil(right[0]))]] <= half_power * curve[at]
    x, y = speed[at - 1 : at + 2], curve[at - 1 : at + 2]  # the top is that of the parabola through three points
    rise, fall = np.diff(y) / np.diff(x)
    top = float((x[0] + x[1]) / 2 + rise / (rise - fall) * (x[2] - x[0]) / 2)
    return top, float(top / (ends[1] - ends[0])) if reached.all() else 0.0


def margin(critical: Float, lowest: float, highest: float) -> Float:
    """Distance of critical speeds from a range of running speeds, as a share of its nearer end; zero inside."""
    below, above = 1 - critical / lowest, critical / highest - 1
    return np.asarray(np.maximum(np.maximum(below, above), 0.0))


def margin_asked(amplification: Float, is_below: Bool) -> Float:
    """Separation margin that API 617 and 684 are said to ask for; shares of the running speed."""
    well_damped = 2.5  # amplification factor up to which no margin is asked for, as API 617 and 684 are cited
    damped = amplification <= well_damped
    rise = 1 - 1 / (np.where(damped, well_damped, amplification) - 1.5)
    asked = np.where(is_below, np.minimum(0.16, 0.17 * rise), np.minimum(0.26, 0.10 + 0.17 * rise))
    return np.asarray(np.where(damped, 0.0, asked))
