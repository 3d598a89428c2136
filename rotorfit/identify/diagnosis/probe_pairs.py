"""Errors that a pair of probes shows by x and y, and a pair of planes by its answers to forces at the other.

On an isotropic rotor y follows x by 90 degrees in the direction of the force, ``Y = -j X`` forward and ``Y = +j X``
backward, at every frequency. A wrong gain multiplies one side by one number, a delay turns it in proportion to the
frequency, a filter does what its corner asks; anisotropy, whose shares change across resonances, does none of these.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.digits import significant
from rotorfit.estimators.blocks.row_keys import combined, in_order, numbers, rows_by
from rotorfit.estimators.noise.sweep_noise import noise_from_smoothness
from rotorfit.identify.diagnosis.orbits import FEWEST_READINGS, Orbits, enough, total_power
from rotorfit.identify.diagnosis.probe_filters import SAME_FACTOR, FilteredProbe, Pair, filtered_probe, likeness
from rotorfit.lab.data.findings import Finding, listed

UNEVEN = "anisotropy"
"""Code of the finding that x and y differ as on an anisotropic rotor."""

LARGEST_REDCHI = 1.5**2
"""Mean square of misfit over noise up to which a statement explains the readings; their noise is uncertain itself."""

_SIGNIFICANT_ERRORS = 8.0
"""Departures from what is expected, over their standard error, that are no accident among many planes."""


@dataclass(frozen=True, kw_only=True)
class _Relation:
    """How y follows x at one plane."""

    even: bool = False  # as on an isotropic rotor, to within the noise
    constant: bool = False  # by one factor at all frequencies, to within the noise
    ratio: complex = 1.0  # that factor, forward, complex; 1 for a perfect pair
    mirrored: bool = False  # whether the factor of backward orbits is its conjugate, a mounting angle
    delay: float = 0.0  # time by which y comes late, s, where that explains what no factor does
    filtered: FilteredProbe | None = None
    highest: float = 0.0  # highest frequency, rad/s
    share: float  # part of the response's power against the force
    dynamic: bool = False  # the band holds enough dynamics to tell a gain from an anisotropic stiffness
    rows: tuple[int, ...] = ()  # rows of the test

    @property
    def twice(self) -> bool:
        """True if one of the two reads twice the other."""
        # Departure of the gains' ratio from two, octaves, up to which one of them gives peak-to-peak amplitudes
        octaves_from_two = 0.12
        return abs(abs(math.log2(abs(self.ratio))) - 1) < octaves_from_two

    @property
    def same(self) -> bool:
        """True if one factor explains it that is hardly a gain."""
        return self.constant and abs(self.ratio - 1) < SAME_FACTOR


def uneven_probes(orbits: Orbits) -> Iterator[Finding]:
    """Planes where x and y differ beyond their noise: by a factor, a delay, a filter, or as on an anisotropic rotor."""
    relations = _relations(orbits)
    good = any(one.even for one in relations.values())
    uneven = []
    for plane, one in relations.items():
        if one.even or one.same:
            continue
        if one.constant and (one.dynamic or good or one.twice):
            yield _gain(plane, one)
        elif one.delay and (one.dynamic or good):
            yield _late(plane, one)
        elif one.filtered is not None and (one.dynamic or good):
            probe, (what, undo) = one.filtered.probe, one.filtered.words
            text = (
                f"The readings of the {probe} probe at {plane} are {what}: so it differs from the other probe at every "
                f"frequency, as no rotor does. Half of that is in every response there. To undo it: {undo}, or leave "
                "it out."
            )
            name = f"probe-filter ({plane} {probe})"
            yield Finding("warning", "probe-filter", text, one.rows, remedy=undo, correction=name)
        else:
            uneven.append(plane)
    if uneven:
        power = max(relations[plane].share for plane in uneven)
        part = 100 * (power / (1 - power)) ** 0.5
        static = [plane for plane in uneven if relations[plane].constant]
        unclear = (
            f" At {listed(static)} one factor explains it, which a wrong gain and an anisotropic stiffness share as "
            "long as no resonance lies in the band: these data cannot tell."
            if static
            else ""
        )
        text = (
            f"At {listed(uneven)} the motion against the direction of the force has up to {significant(part, 2)} % of "
            "the amplitude of that along it, and is no noise: anisotropy, probes that differ, or a force that does not "
            f"turn (force_direction).{unclear} Compare with the model Anisotropic before trusting an isotropic one."
        )
        yield Finding("note", UNEVEN, text)


def uneven_planes(orbits: Sequence[Orbits]) -> dict[str, FilteredProbe | None]:
    """Planes where y does not follow x by one factor, with the filter of one of the two that explains it."""
    relations = (pair for of_test in orbits for pair in _relations(of_test).items())
    return {plane: one.filtered for plane, one in relations if not (one.even or one.constant)}


def _relations(orbits: Orbits) -> dict[str, _Relation]:
    found = {plane: _relation(orbits, at) for (plane,), at in orbits.groups("plane")}
    return {plane: one for plane, one in found.items() if one is not None}


def _relation(orbits: Orbits, at: Index) -> _Relation | None:
    x, y = orbits.xy(at)
    at = at[np.isfinite(orbits.wrong[at]) & (np.abs(x) > 0) & (np.abs(y) > 0)]
    if at.size < FEWEST_READINGS:
        return None
    against, along = total_power(orbits.wrong[at]), total_power(orbits.right[at])
    share = against / (against + along)
    # Share of the power against the force from which probes or directions are exchanged, which others look for; a probe
    # that gives velocities makes it a half
    exchanged_share = 0.55
    if share > exchanged_share:
        return None
    x, y = orbits.xy(at)
    expected = np.where(orbits.frequency[at] < 0, 1j, -1j) * x
    if _differs_by_noise(orbits, at, expected, y):
        return _Relation(even=True, share=share)
    noise = _noise(orbits, at, x, y)
    known = np.isfinite(noise).all(axis=1)
    at, noise, expected = at[known], noise[known], expected[known]
    if at.size < FEWEST_READINGS:
        return None
    backward = orbits.frequency[at] < 0
    pair = Pair(w=np.abs(orbits.frequency[at]), expected=expected, seen=y[known], noise=noise)
    ratio, error, mirrored = _ratio_of_sides(pair, backward)
    even = _misfit(pair, expected, 1.0)
    constant = _misfit(pair, expected, np.where(backward & mirrored, np.conj(ratio), ratio))
    size = np.abs(orbits.right[at] / orbits.force[at])
    clear = size[np.abs(expected) > 10 * noise[:, 0]]
    certain = abs(ratio - 1) > _SIGNIFICANT_ERRORS * error
    neither = constant >= LARGEST_REDCHI and even >= LARGEST_REDCHI
    part = pair.part(enough(at.size))
    delay = _delay(part, LARGEST_REDCHI) if neither else 0.0
    filtered = filtered_probe(part, LARGEST_REDCHI) if neither and not delay else None
    # Misfit beyond the noise that a delay may leave where nothing explains all, over that which one factor leaves, and
    # the misfit up to which: readings of a sweep hold lines less exact than their neighbours tell, beside orders of the
    # shaft
    delay_misfit_share, largest_delay_misfit = 0.1, 4.0
    if neither and not delay and filtered is None:  # some lines are less exact than their neighbours tell
        delay = _delay(part, min(1 + delay_misfit_share * (constant - 1), largest_delay_misfit))
    # Ratio of largest to smallest response across a band in which anisotropy could not look like a constant gain
    dynamic_range = 6.0
    return _Relation(
        even=even < LARGEST_REDCHI and not (certain and constant < LARGEST_REDCHI and abs(ratio - 1) >= SAME_FACTOR),
        constant=constant < LARGEST_REDCHI and certain,
        ratio=ratio,
        mirrored=mirrored,
        delay=delay,
        filtered=filtered,
        highest=float(pair.w.max()),
        share=share,
        dynamic=clear.size >= FEWEST_READINGS and bool(clear.max() > dynamic_range * clear.min()),
        rows=orbits.rows_of(at),
    )


def _differs_by_noise(orbits: Orbits, at: Index, expected: ComplexArray, y: ComplexArray) -> bool:
    """True if what departs from an isotropic rotor jumps from line to line, as noise does, sweep by sweep."""
    for sweep in _sweeps(orbits, at, "run", "force_plane"):
        u, rest = expected[sweep], y[sweep] - expected[sweep]
        slope = np.vdot(u, rest) / np.vdot(u, u)  # what one factor more explains
        jumps = np.abs(np.diff(rest - slope * u)) ** 2 / 2
        level = float(np.mean(jumps)) if sweep.size > 1 else 0.0
        certain = abs(slope) > _SIGNIFICANT_ERRORS * np.sqrt(level / np.vdot(u, u).real)
        if total_power(rest) > LARGEST_REDCHI * level * sweep.size or (certain and abs(slope) >= SAME_FACTOR):
            return False
    return True


def _sweeps(orbits: Orbits, at: Index, *names: str) -> list[Index]:
    """Places among some orbits of those of one direction of whirl and of one value of columns, by frequency."""
    number = combined(orbits.number(*names)[at], (orbits.frequency[at] < 0).astype(np.intp))
    return rows_by(number, orbits.frequency[at])


def _noise(orbits: Orbits, at: Index, x: ComplexArray, y: ComplexArray) -> Float:
    """Noise of x and of y at each orbit, from the smoothness of their sweeps, NaN where those are too short."""
    noise = np.full((at.size, 2), np.nan)
    speeds = ["speed"] if np.unique(orbits.speed[at]).size <= FEWEST_READINGS else []
    for sweep in _sweeps(orbits, at, "run", *speeds, "force_plane"):
        if sweep.size >= FEWEST_READINGS:
            w = np.abs(orbits.frequency[at[sweep]])
            noise[sweep] = [noise_from_smoothness(w, readings[sweep]) for readings in (x, y)]
    return noise


def _misfit(pair: Pair, expected: ComplexArray, ratio: complex | ComplexArray) -> float:
    """Mean square of ``seen - ratio expected`` over its noise, 1 for noise alone."""
    variance = pair.noise[:, 1] ** 2 + np.abs(ratio) ** 2 * pair.noise[:, 0] ** 2
    return float(np.mean(np.abs(pair.seen - ratio * expected) ** 2 / (2 * variance)))


def _ratio_of_sides(pair: Pair, backward: NDArray[np.bool_]) -> tuple[complex, float, bool]:
    """Ratio of y to what is expected of forward orbits, its error, and whether backward ones have its conjugate."""
    sides = {side: _ratio(pair, pair.expected, backward == side) for side in (False, True) if (backward == side).any()}
    if False not in sides:
        return sides[True][0].conjugate(), sides[True][1], False
    ratio, error = sides[False]
    behind = sides[True][0] if True in sides else ratio
    return ratio, error, abs(behind - ratio.conjugate()) < abs(behind - ratio)


def _ratio(pair: Pair, expected: ComplexArray, some: NDArray[np.bool_]) -> tuple[complex, float]:
    """Ratio of two noisy readings and its standard error; the noise's own power is taken out of the denominator."""
    expected, seen, noise = expected[some], pair.seen[some], pair.noise[some]
    ratio, power = 1.0 + 0j, 1.0
    for _ in range(5):
        weight = 1 / (noise[:, 1] ** 2 + abs(ratio) ** 2 * noise[:, 0] ** 2)
        power = float(np.sum(weight * (np.abs(expected) ** 2 - 2 * noise[:, 0] ** 2)))
        if power <= 0:
            return 1.0 + 0j, np.inf
        ratio = complex(np.sum(weight * expected.conj() * seen) / power)
    return ratio, float(np.sqrt(2 / power))


def _delay(pair: Pair, most: float) -> float:
    """Time by which y is late, s; zero where all delays leave a misfit of so much or more."""
    product = pair.seen * pair.expected.conj() / np.sum(pair.noise**2, axis=1)
    # Phase between neighbouring tried delays at the end of the band, rad; at most half a turn is looked for.
    phase_step = 0.2
    step = phase_step / pair.w.max()
    count = int(np.ceil(np.pi / phase_step))
    best = 0.0
    for _ in range(4):  # each ten times as fine
        tried = best + step * np.arange(-count, count + 1)
        best = float(tried[np.argmax(np.real(np.exp(1j * np.multiply.outer(tried, pair.w)) @ product))])
        step, count = step / 10, 10
    late = pair.expected * np.exp(-1j * pair.w * best)
    ratio, _ = _ratio(pair, late, np.ones(late.size, dtype=bool))
    return best if _misfit(pair, late, ratio) < most else 0.0


def _late(plane: str, one: _Relation) -> Finding:
    late, early = ("y", "x") if one.delay > 0 else ("x", "y")
    lag, time = np.degrees(one.highest * abs(one.delay)), significant(abs(one.delay), 3)
    text = (
        f"The {late} probe at {plane} is {time} s late against the {early} probe: it lags in "
        f"proportion to the frequency, by {significant(lag, 2)} degrees at the highest, as no rotor does. Half of that "
        "is in every response there, and in the damping and lam that follow from it. Find out which probe is wrong: if "
        f"{early} is right, delays, {plane}.{late} = {time} s; if {late} is right, {plane}.{early} = -{time} s "
        "(of recordings delay_s of the probe in rig.toml)."
    )
    return Finding("warning", "probe-delay", text, one.rows, remedy=f"delays, {plane}.{late} = {time} s")


def _gain(plane: str, one: _Relation) -> Finding:
    g, phase = abs(one.ratio), np.degrees(np.angle(one.ratio))
    # Motion is seen (1 + ratio)/2 times as large where x is right, that over the ratio where y is.
    if_x, if_y = (1 - 1 / factor for factor in (abs(1 + one.ratio) / 2, abs(1 + 1 / one.ratio) / 2))
    if abs(np.radians(phase)) > abs(g - 1) and one.mirrored:
        what = f"The probes at {plane} are {90 - phase:.1f} degrees apart instead of 90, at every frequency"
        undo = f"probe_angles, {plane} at 0 and {90 - phase:.1f}"
    elif abs(np.radians(phase)) > abs(g - 1):
        what = f"The y probe at {plane} is {phase:+.1f} degrees off in phase against the x probe, at every frequency"
        undo = "correct it with a complex gain or a delay (gains, delays)"
    else:
        what = f"The y probe at {plane} reads {significant(g, 3)} times what the x probe does, at every frequency"
        undo = (
            f"if x is right, divide y by it: gains, {plane}.y = {significant(g, 3)}; if y is right, "
            f"{plane}.x = {significant(1 / g, 3)}"
        )
    effect = (
        "Every stiffness, damping and mass that is seen there (K, D, M, Mf) comes out some "
        f"{_bias(if_x)} if the y probe is wrong, {_bias(if_y)} if the x probe is; lam, a ratio, hardly changes"
        if max(abs(if_x), abs(if_y)) >= 0.01
        else "Stiffness, damping and mass hardly change, quadrature parts and small cross terms do"
    )
    like = " Amplitudes of one of them may be peak-to-peak: name their unit, amplitude_um_pp." if one.twice else ""
    text = f"{what}, as no rotor does. {effect}. Find out which probe is wrong: {undo}.{like}"
    return Finding("warning", "peak-to-peak" if one.twice else "probe-gain", text, one.rows, remedy=undo)


def _bias(share: float) -> str:
    return f"{significant(100 * abs(share), 2)} % too {'small' if share > 0 else 'large'}"


def reciprocity(orbits: Orbits) -> Iterator[Finding]:
    """Pairs of planes whose responses to each other's forces differ by one factor."""
    planes = {tuple(sorted(pair)) for pair, _ in orbits.groups("force_plane", "plane") if pair[0] != pair[1]}
    # Departure of the median ratio of planes from one, octaves, that stations of probes do not explain
    largest_median = 0.4
    largest_spread = 0.3  # octaves between the quartiles of ratios that one factor explains
    fewest_ratios = 8  # ratios from which quartiles say anything
    condition = in_order(combined(orbits.number("speed"), numbers(np.round(orbits.frequency, 6))))[1]
    size = np.abs(orbits.right / orbits.force)
    for one, other in sorted(planes):
        # log2 of how much more one plane answers a force at the other than the other way round, by condition.
        last = np.full((2, int(condition.max()) + 1), -1, dtype=np.intp)
        for found, (forced, plane) in zip(last, ((other, one), (one, other)), strict=True):
            at: Index = np.flatnonzero((orbits.force_plane == forced) & (orbits.plane == plane) & (size > 0))
            found[condition[at]] = at
        there, back = last[:, (last >= 0).all(axis=0)]
        logs = np.log2(size[there] / size[back])
        if logs.size < fewest_ratios:
            continue
        low, middle, high = np.quantile(logs, [0.25, 0.5, 0.75]).tolist()
        if abs(middle) <= largest_median or high - low >= largest_spread:
            continue
        between = np.isin(orbits.plane, (one, other)) & np.isin(orbits.force_plane, (one, other))
        factor, (a, b) = float(2 ** abs(middle)), (one, other) if middle > 0 else (other, one)
        times = significant(factor, 3)
        text = (
            f"Plane {a} answers forces at {b} {times} times as much as {b} answers forces at {a}, at every frequency; "
            f"on a rotor the two are alike. Either the readings at {a} are {times} times too large{likeness(factor)}, "
            f"or those at {b} as many times too small{likeness(1 / factor)}, or so are the forces at {b}, or those at "
            f"{a} are too large. No fit can tell which: it goes into sigma, or into every mass and stiffness of one "
            "plane."
        )
        undo = "name the unit of the amplitudes, or correct with gains"
        yield Finding("warning", "reciprocity", text, orbits.rows_of(np.flatnonzero(between)), remedy=undo)
