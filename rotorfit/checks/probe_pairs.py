"""What x and y of a pair of probes give away together: a gain, delay or filter of one, and anisotropy beyond the noise.

On an isotropic rotor y follows x by 90 degrees in the direction of the force, ``Y = -j X`` forward and ``Y = +j X``
backward, at every frequency. A wrong gain multiplies one side by one number, a delay turns it in proportion to the
frequency, a filter does what its corner asks; anisotropy, whose shares change across resonances, does none of these.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rotorfit.checks.orbits import ENOUGH, Orbits, total_power
from rotorfit.checks.probe_filters import FilteredProbe, filtered_probe
from rotorfit.data.findings import Finding, listed
from rotorfit.estimators.blocks.row_keys import combined, in_order, numbers
from rotorfit.estimators.noise.reading_noise import noise_from_smoothness
from rotorfit.models.array_types import ComplexArray, Float, Index

AGREES = 1.5
"""Misfit over noise below which a statement explains the readings: the estimate of the noise is uncertain itself."""

ESTABLISHED = 8.0
"""Departures from what is expected, over their standard error, that are no accident among many planes."""

SMALLEST_GAIN = 0.03
"""Departure of the gains' ratio from one that is worth a warning: it moves parameters by half of it."""

DYNAMIC = 6.0
"""Ratio of largest to smallest response across a band in which anisotropy could not look like a constant gain."""

_OTHERS = 0.55
"""Share of the power against the force from which probes or directions are exchanged, which others look for; a probe
that gives velocities makes it a half."""

_LEFT, _UP_TO = 0.1, 4.0
"""Misfit beyond the noise that a delay may leave where nothing explains all, over that which one factor leaves, and the
misfit up to which: readings of a sweep hold lines less exact than their neighbours tell, beside orders of the shaft."""

_PHASE_STEP = 0.2
"""Phase between neighbouring tried delays at the end of the band, rad; at most half a turn is looked for."""


def uneven_probes(orbits: Orbits) -> Iterator[Finding]:
    """Planes where x and y differ by more than their noise: by one factor, a delay, a filter, or as on an anisotropic
    rotor.
    """
    told = _pairs(orbits)
    good = [plane for plane, pair in told.items() if pair.even]
    uneven = []
    for plane, pair in told.items():
        if pair.even:
            continue
        sure = pair.dynamic or good
        if pair.constant and abs(pair.ratio - 1) >= SMALLEST_GAIN and sure:
            yield _gain(plane, pair)
        elif pair.delay and sure:
            yield _late(plane, pair)
        elif pair.filtered is not None and sure:
            yield _filtered(plane, pair.filtered, pair.rows)
        elif not pair.constant or abs(pair.ratio - 1) >= SMALLEST_GAIN:
            uneven.append(plane)
    if uneven:
        power = max(told[plane].share for plane in uneven) / 100
        part = 100 * (power / (1 - power)) ** 0.5
        static = [plane for plane in uneven if told[plane].constant]
        doubt = (
            f" At {listed(static)} one factor explains it, which a wrong gain and an anisotropic stiffness share as "
            "long as no resonance lies in the band: these data cannot tell."
            if static
            else ""
        )
        text = (
            f"At {listed(uneven)} the motion against the direction of the force has up to {part:.2g} % of the "
            "amplitude of that along it, and is no noise: anisotropy, probes that differ, or a force that does not "
            f"turn (force_direction).{doubt} Compare with the model Anisotropic before trusting an isotropic one."
        )
        yield Finding("note", "anisotropy", text)


def uneven_planes(orbits: Orbits) -> dict[str, FilteredProbe | None]:
    """Planes where y does not follow x by one factor, with the filter of one of the two that explains it."""
    return {plane: pair.filtered for plane, pair in _pairs(orbits).items() if not (pair.even or pair.constant)}


def _pairs(orbits: Orbits) -> dict[str, _Pair]:
    pairs = {plane: _pair(orbits, at) for (plane,), at in orbits.groups("plane")}
    return {plane: pair for plane, pair in pairs.items() if pair is not None}


@dataclass(frozen=True)
class _Pair:
    """How y follows x at one plane."""

    even: bool  # as on an isotropic rotor, to within the noise
    constant: bool  # by one factor at all frequencies, to within the noise
    ratio: complex  # that factor, forward, complex; 1 for a perfect pair
    mirrored: bool  # whether the factor of backward orbits is its conjugate, a mounting angle, rather than the same
    delay: float  # time by which y comes late, s, where that explains what no factor does; else zero
    filtered: FilteredProbe | None
    highest: float  # highest frequency, rad/s
    share: float  # part of the response's power against the force, %
    dynamic: bool  # the band holds enough dynamics to tell a gain from an anisotropic stiffness
    rows: tuple[int, ...]  # rows of the test


def _pair(orbits: Orbits, at: Index) -> _Pair | None:
    at = at[np.isfinite(orbits.wrong[at]) & (np.abs(orbits.x[at]) > 0) & (np.abs(orbits.y[at]) > 0)]
    if at.size < ENOUGH:
        return None
    powers = [total_power(part[at]) for part in (orbits.wrong, orbits.right)]
    share = powers[0] / sum(powers)
    if share > _OTHERS:
        return None
    backward = orbits.frequency[at] < 0
    expected = np.where(backward, 1j, -1j) * orbits.x[at]
    seen = orbits.y[at]
    if _plainly_even(orbits, at, expected, seen):
        return _Pair(True, False, 1.0, False, 0.0, None, 0.0, 100 * share, False, ())
    noise = _noise(orbits, at)
    known = np.isfinite(noise).all(axis=1)
    at, noise, backward = at[known], noise[known], backward[known]
    expected, seen = expected[known], seen[known]
    if at.size < ENOUGH:
        return None
    even = _misfit(expected, seen, noise, 1.0)
    sides = {side: _ratio(expected[some], seen[some], noise[some]) for side, some in _sides(backward)}
    ratio, error = sides.get(False, sides.get(True, (1.0 + 0j, 1.0)))
    if False not in sides:
        ratio = ratio.conjugate()
    mirrored = False
    if len(sides) == 2:
        back = sides[True][0]
        mirrored = abs(back - ratio.conjugate()) < abs(back - ratio)
    of_line = np.where(backward & mirrored, np.conj(ratio), ratio)
    constant = _misfit(expected, seen, noise, of_line)
    size = np.abs(orbits.right[at] / orbits.force[at])
    clear = size[np.abs(orbits.x[at]) > 10 * noise[:, 0]]
    certain = abs(ratio - 1) > ESTABLISHED * error
    w = np.abs(orbits.frequency[at])
    neither = constant >= AGREES**2 and even >= AGREES**2
    delay = _delay(w, expected, seen, noise, AGREES**2) if neither else 0.0
    filtered = filtered_probe(w, expected, seen, noise, AGREES**2) if neither and not delay else None
    if neither and not delay and filtered is None:  # some lines are less exact than their neighbours tell
        delay = _delay(w, expected, seen, noise, min(1 + _LEFT * (constant - 1), _UP_TO))
    return _Pair(
        even=even < AGREES**2 and not (certain and constant < AGREES**2 and abs(ratio - 1) >= SMALLEST_GAIN),
        constant=constant < AGREES**2 and certain,
        ratio=ratio,
        mirrored=mirrored,
        delay=delay,
        filtered=filtered,
        highest=float(w.max()),
        share=100 * share,
        dynamic=clear.size >= ENOUGH and bool(clear.max() > DYNAMIC * clear.min()),
        rows=orbits.rows_of(at),
    )


def _plainly_even(orbits: Orbits, at: Index, expected: ComplexArray, seen: ComplexArray) -> bool:
    """Whether what departs from an isotropic rotor jumps from line to line, as noise does, sweep by sweep."""
    first, sweep = in_order(
        combined(
            numbers(orbits.run[at]), numbers(orbits.force_plane[at]), np.sign(orbits.frequency[at]).astype(int) + 1
        )
    )
    order = np.lexsort([orbits.frequency[at], sweep])
    for rows in np.split(order, np.cumsum(np.bincount(sweep, minlength=first.size))[:-1]):
        u, rest = expected[rows], seen[rows] - expected[rows]
        slope = np.vdot(u, rest) / np.vdot(u, u)  # what one factor more explains
        jumps = np.abs(np.diff(rest - slope * u)) ** 2 / 2
        level = float(np.mean(jumps)) if rows.size > 1 else 0.0
        certain = abs(slope) > ESTABLISHED * np.sqrt(level / np.vdot(u, u).real)
        if total_power(rest) > AGREES**2 * level * rows.size or (certain and abs(slope) >= SMALLEST_GAIN):
            return False
    return True


def _sides(backward: NDArray[np.bool_]) -> Iterator[tuple[bool, NDArray[np.bool_]]]:
    for side in (False, True):
        if (backward == side).any():
            yield side, backward == side


def _noise(orbits: Orbits, at: Index) -> Float:
    """Noise of x and of y at each orbit, from the smoothness of their sweeps, NaN where those are too short."""
    noise = np.full((at.size, 2), np.nan)
    place = {int(i): k for k, i in enumerate(at.tolist())}
    speeds = orbits.speed if np.unique(orbits.speed[at]).size <= ENOUGH else np.zeros(orbits.speed.size)
    sweeps: dict[tuple[str, float, str, bool], list[int]] = {}
    for i in at.tolist():
        key = (str(orbits.run[i]), float(speeds[i]), str(orbits.force_plane[i]), bool(orbits.frequency[i] < 0))
        sweeps.setdefault(key, []).append(i)
    for rows in sweeps.values():
        if len(rows) >= ENOUGH:
            w = np.abs(orbits.frequency[rows])
            where = [place[i] for i in rows]
            for k, readings in enumerate((orbits.x[rows], orbits.y[rows])):
                noise[where, k] = noise_from_smoothness(w, readings)
    return noise


def _misfit(expected: ComplexArray, seen: ComplexArray, noise: Float, ratio: complex | ComplexArray) -> float:
    """Mean square of ``seen - ratio expected`` over its noise, 1 for noise alone."""
    variance = noise[:, 1] ** 2 + np.abs(ratio) ** 2 * noise[:, 0] ** 2
    return float(np.mean(np.abs(seen - ratio * expected) ** 2 / (2 * variance)))


def _ratio(expected: ComplexArray, seen: ComplexArray, noise: Float) -> tuple[complex, float]:
    """Ratio of two noisy readings and its standard error; the noise's own power is taken out of the denominator."""
    ratio, power = 1.0 + 0j, 1.0
    for _ in range(5):
        weight = 1 / (noise[:, 1] ** 2 + abs(ratio) ** 2 * noise[:, 0] ** 2)
        power = float(np.sum(weight * (np.abs(expected) ** 2 - 2 * noise[:, 0] ** 2)))
        if power <= 0:
            return 1.0 + 0j, np.inf
        ratio = complex(np.sum(weight * expected.conj() * seen) / power)
    return ratio, float(np.sqrt(2 / power))


def _delay(w: Float, expected: ComplexArray, seen: ComplexArray, noise: Float, most: float) -> float:
    """Time by which readings are late, s; zero where all delays leave a misfit of so much or more."""
    product = seen * expected.conj() / np.sum(noise**2, axis=1)

    def together(delays: Float) -> Float:
        return np.asarray(np.real(np.exp(1j * np.multiply.outer(delays, w)) @ product))

    step = _PHASE_STEP / w.max()
    tried = step * np.arange(-np.ceil(np.pi / _PHASE_STEP), np.ceil(np.pi / _PHASE_STEP) + 1)
    best = float(tried[np.argmax(together(tried))])
    for _ in range(3):  # each ten times as fine
        step /= 10
        near = best + step * np.arange(-10, 11)
        best = float(near[np.argmax(together(near))])
    late = expected * np.exp(-1j * w * best)
    ratio, _ = _ratio(late, seen, noise)
    return best if _misfit(late, seen, noise, ratio) < most else 0.0


def _late(plane: str, pair: _Pair) -> Finding:
    late, early = ("y", "x") if pair.delay > 0 else ("x", "y")
    lag = np.degrees(pair.highest * abs(pair.delay))
    text = (
        f"The {late} probe at {plane} is {abs(pair.delay):.3g} s late against the {early} probe: it lags in proportion "
        f"to the frequency, by {lag:.2g} degrees at the highest, as no rotor does. Half of that is in every response "
        f"there, and in the damping and lam that follow from it. Find out which probe is wrong: if {early} is right, "
        f"delays, {plane}.{late} = {abs(pair.delay):.3g} s; if {late} is right, {plane}.{early} = "
        f"-{abs(pair.delay):.3g} s (of recordings delay_s of the probe in rig.toml)."
    )
    return Finding("warning", "probe-delay", text, pair.rows)


def _filtered(plane: str, one: FilteredProbe, rows: tuple[int, ...]) -> Finding:
    other = "y" if one.probe == "x" else "x"
    text = (
        f"The readings of the {one.probe} probe at {plane} are {one.told}: so it differs from the {other} probe "
        f"at every frequency, as no rotor does. Half of that is in every response there. {one.mend}, or leave it out."
    )
    return Finding("warning", "probe-filter", text, rows)


def _gain(plane: str, pair: _Pair) -> Finding:
    g, phase = abs(pair.ratio), np.degrees(np.angle(pair.ratio))
    # Motion is seen (1 + ratio)/2 times as large where x is right, that over the ratio where y is.
    if_x, if_y = (1 - 1 / factor for factor in (abs(1 + pair.ratio) / 2, abs(1 + 1 / pair.ratio) / 2))
    if abs(np.radians(phase)) > abs(g - 1) and pair.mirrored:
        what = f"The probes at {plane} are {90 - phase:.1f} degrees apart instead of 90, at every frequency"
        cure = f"give their angles, probe_angles, {plane} at 0 and {90 - phase:.1f}"
    elif abs(np.radians(phase)) > abs(g - 1):
        what = f"The y probe at {plane} is {phase:+.1f} degrees off in phase against the x probe, at every frequency"
        cure = "correct it with a complex gain or a delay (gains, delays)"
    else:
        what = f"The y probe at {plane} reads {g:.3g} times what the x probe does, at every frequency"
        cure = f"if x is right, divide y by it: gains, {plane}.y = {g:.3g}; if y is right, {plane}.x = {1 / g:.3g}"
    effect = (
        "Every stiffness, damping and mass that is seen there (K, D, M, Mf) comes out some "
        f"{_bias(if_x)} if the y probe is wrong, {_bias(if_y)} if the x probe is; lam, a ratio, hardly changes"
        if max(abs(if_x), abs(if_y)) >= 0.01
        else "Stiffness, damping and mass hardly change, quadrature parts and small cross terms do"
    )
    return Finding(
        "warning",
        "probe-gain",
        f"{what}, as no rotor does. {effect}. Find out which probe is wrong: {cure}.",
        pair.rows,
    )


def _bias(share: float) -> str:
    return f"{100 * abs(share):.2g} % too {'small' if share > 0 else 'large'}"
