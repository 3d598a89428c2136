"""Amplitudes that are peak-to-peak, or in another unit, in some channels or runs, where others give that away."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.checks.orbits import ENOUGH, Orbits, Receptances, mirrored
from rotorfit.data.channel_filters import likeness
from rotorfit.data.findings import Finding
from rotorfit.models.array_types import ComplexArray, Float, Index
from rotorfit.units import RPM_PER_RAD_S

TURN = 0.25
"""Departure from circular motion, rad, that is anisotropy rather than noise or a probe a few degrees off."""

BETTER = 0.5
"""Share of the misfit that is left when one direction of whirl is halved, if that is the explanation."""

_NEAR_TWO = 0.12  # departure of the median ratio from two, octaves (about 9 %)
_ALIKE = 0.3  # octaves between the quartiles of ratios that one factor explains
_UNEVEN = 0.4  # departure of the median ratio of planes from one, octaves, that stations of probes do not explain
_JUMP = 0.15  # departure of a jump across zero frequency from two, octaves: about twice what its own error may be
_KNOWN = 0.08  # standard deviation of a jump, octaves, up to which it is well determined
_FEWEST = 8  # ratios from which quartiles, or a line, say anything
_NEAR_ZERO = 0.5, 0.2  # shares of the speed, and of the highest frequency, within which w counts as near zero


def peak_to_peak(orbits: Orbits) -> Iterator[Finding]:
    """Ratios of two between readings that should agree: x and y, forward and backward at w -> 0, H_ab and H_ba."""
    for (plane,), at in orbits.groups("plane"):
        strong = at[np.isfinite(orbits.wrong[at])]
        strong = (
            strong[np.abs(orbits.right[strong]) >= np.median(np.abs(orbits.right[strong]))] if strong.size else strong
        )
        if _is_two(_log_ratio(orbits.x[strong], orbits.y[strong])) and _turns(orbits, strong):
            yield _twice(f"The x and y probes at {plane} differ by a factor of two", orbits, at)
    for ((speed,), at), measured in zip(orbits.groups("speed"), orbits.receptances(), strict=True):
        rpm = f"{float(speed) * RPM_PER_RAD_S:.6g} rpm"
        kappa = _stiffness_matrices(orbits, measured)
        if kappa is not None:
            if larger := _larger_side(*kappa):
                what = f"Responses at {rpm} are twice as large under {larger} forces as the rest makes one expect"
                yield _twice(what, orbits, at)
            continue
        for (force_plane, plane), some in orbits.groups("force_plane", "plane"):
            here = np.intersect1d(some, at)
            if abs(abs(_jump_at_zero(orbits, here)) - 1) < _JUMP:
                where = f"at {plane} under a force at {force_plane} ({rpm})"
                yield _twice(
                    f"Forward and backward responses {where} differ by a factor of two near zero", orbits, here
                )
    for a, b, logs, here in _reciprocities(orbits):
        if _is_two(logs):
            yield _twice(f"Reciprocal responses between {a} and {b} differ by a factor of two", orbits, here)


def reciprocity(orbits: Orbits) -> Iterator[Finding]:
    """Planes of which one answers the other by more than the other way round, by one factor that is not two."""
    for a, b, logs, here in _reciprocities(orbits):
        if (factor := _other_factor(logs)) and not _is_two(logs):
            larger, other = (a, b) if factor > 1 else (b, a)
            yield _uneven_planes(larger, other, max(factor, 1 / factor), orbits, here)


def _reciprocities(orbits: Orbits) -> Iterator[tuple[str, str, Float, Index]]:
    """Two planes, log2 of how much more the first answers the second than the other way round, and their orbits."""
    pairs = {tuple(sorted(pair)) for pair, _ in orbits.groups("force_plane", "plane") if pair[0] != pair[1]}
    for a, b in sorted(pairs):
        here = np.flatnonzero(np.isin(orbits.plane, (a, b)) & np.isin(orbits.force_plane, (a, b)))
        yield a, b, _log_ratio(*_reciprocal(orbits, orbits.names.index(b), orbits.names.index(a))), here


def _twice(what: str, orbits: Orbits, at: Index) -> Finding:
    text = f"{what}: some amplitudes may be peak-to-peak. Name their unit (amplitude_um_pp) or correct them with gains."
    return Finding("warning", "peak-to-peak", text, orbits.rows_of(at))


def _uneven_planes(a: str, b: str, factor: float, orbits: Orbits, at: Index) -> Finding:
    """Of planes of which the first answers the second so many times as much as the other way round."""
    text = (
        f"{a} answers forces at {b} {factor:.3g} times as much as {b} answers forces at {a}, at every frequency; on a "
        f"rotor the two are alike. Either the readings at {a} are told {factor:.3g} times too large{likeness(factor)}, "
        f"or those at {b} as many times too small{likeness(1 / factor)}, or so are the forces at {b}, or those at {a} "
        "are too large. No fit can tell which: it goes into sigma, or into every mass and stiffness of one plane."
    )
    return Finding("warning", "reciprocity", text, orbits.rows_of(at))


def _other_factor(logs: Float) -> float:
    """The one factor by which all ratios differ from one; zero where they do not, or by more than one."""
    if logs.size < _FEWEST:
        return 0.0
    low, middle, high = _quartiles(logs)
    return float(2**middle) if abs(middle) > _UNEVEN and high - low < _ALIKE else 0.0


def _log_ratio(a: NDArray[Any], b: NDArray[Any]) -> Float:
    some = (np.abs(a) > 0) & (np.abs(b) > 0)
    return np.asarray(np.log2(np.abs(a[some]) / np.abs(b[some])))


def _is_two(logs: Float) -> bool:
    """Whether ratios are two (or a half) throughout; anisotropy and noise spread them."""
    if logs.size < _FEWEST:
        return False
    low, middle, high = _quartiles(logs)
    return bool(abs(abs(middle) - 1) < _NEAR_TWO and high - low < _ALIKE)


def _quartiles(values: Float) -> list[float]:
    """First, second and third quartile; a tenth of the time of the general quantile."""
    ranks = np.array([0.25, 0.5, 0.75]) * (values.size - 1)
    found: list[float] = np.interp(ranks, np.arange(values.size), np.sort(values)).tolist()
    return found


def _turns(orbits: Orbits, at: Index) -> bool:
    """Whether y follows x by 90 degrees in the direction of the force, as on an isotropic rotor, whatever the gains."""
    turn = orbits.y[at] / orbits.x[at] * np.where(orbits.frequency[at] < 0, -1j, 1j)
    return bool(_quartiles(np.abs(np.angle(turn)))[2] < TURN)


def _reciprocal(orbits: Orbits, a: int, b: int) -> tuple[ComplexArray, ComplexArray]:
    """Responses at one plane to forces at another, and the other way round, in conditions where both were measured."""
    last = np.full((2, int(orbits.conditions.max(initial=0)) + 1), -1, dtype=np.intp)
    for found, (force_place, place) in zip(last, ((a, b), (b, a)), strict=True):
        at = np.flatnonzero((orbits.force_place == force_place) & (orbits.place == place))
        found[orbits.conditions[at]] = at
    there, back = last[:, (last >= 0).all(axis=0)]
    return orbits.right[there] / orbits.force[there], orbits.right[back] / orbits.force[back]


def _stiffness_matrices(orbits: Orbits, found: Receptances | None) -> tuple[Float, ComplexArray, Float] | None:
    """Frequencies, matrices of eq. (7) and their weights; None unless each measured plane was forced, either way."""
    if found is None:
        return None
    w = found.frequency[found.regular]
    if min((w < 0).sum(), (w > 0).sum()) < ENOUGH:
        return None
    force = np.abs(orbits.force[found.at]).min(axis=1)[found.regular]
    return w, found.kappa, force / np.linalg.norm(found.kappa, axis=(1, 2)) ** 2  # d kappa = -kappa dH kappa


def _larger_side(w: Float, kappa: ComplexArray, weight: Float) -> str:
    """Direction of whirl whose responses are twice too large: dynamic stiffness is one parabola through w = 0."""
    design = np.column_stack([np.ones_like(w), w, w**2]) * weight[:, None]
    design = design / np.linalg.norm(design, axis=0)
    values = np.ascontiguousarray(kappa.reshape(w.size, -1) * weight[:, None]).view(float)
    halved = np.where((w > 0) == np.array([[True], [False]]), 0.5, 1.0)  # forward ones, or backward ones
    span, _ = np.linalg.qr(np.stack([design, *(halved[:, :, None] * design)]))
    misfit, *halves = np.linalg.norm(values - span @ (np.swapaxes(span, 1, 2) @ values), axis=(1, 2)).tolist()
    best = int(np.argmin(halves))
    return ("forward", "backward")[best] if halves[best] < BETTER * misfit else ""


def _jump_at_zero(orbits: Orbits, at: Index) -> float:
    """log2 of |H(0+)| / |H(0-)|, zero unless it is well determined.

    H is smooth across w = 0, so the logarithm of forward over backward is odd in w: any constant in it is a jump.
    """
    w = np.abs(orbits.frequency[at])
    limit = np.maximum(_NEAR_ZERO[0] * np.abs(orbits.speed[at]), _NEAR_ZERO[1] * w.max(initial=0.0))
    both = mirrored(orbits, at[(w < limit) & (np.abs(orbits.right[at]) > 0)])
    if len(both) < _FEWEST:
        return 0.0
    forward, backward = both.T
    h = orbits.right / orbits.force
    log = np.log2(np.abs(h[forward]) / np.abs(h[backward]))
    w = orbits.frequency[forward] / orbits.frequency[forward].max()
    weight = np.minimum(np.abs(orbits.right[forward]), np.abs(orbits.right[backward]))  # noise is even, signals are not
    design = np.column_stack([np.ones_like(w), w, w**3])
    scaled = design * weight[:, None]
    solution, *_ = np.linalg.lstsq(scaled, log * weight, rcond=None)
    residual = (log - design @ solution) * weight
    variance = float(residual @ residual) / (w.size - 3) * np.linalg.pinv(scaled.T @ scaled)[0, 0]
    return float(solution[0]) if np.sqrt(variance) < _KNOWN else 0.0
