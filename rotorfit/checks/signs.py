"""Slips of sign and direction: conjugated FRFs, exchanged probes, a reversed sense of rotation.

The local physics behind it (conventions as in :mod:`rotorfit.data.experiments`): at a drive point, where the force acts
and is measured, ``kappa = F / A`` and ``Im kappa`` is what the rotor dissipates. It is negative under any backward
force, positive under a forward force faster than the rotor, and negative under a slower one only as far as the fluid
drives the rotor (``D (w - lam Omega)``, eq. 13). A conjugated FRF turns all these signs round; a reversed sense of
rotation moves the drive of the fluid to the backward side.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from rotorfit.checks.orbits import ENOUGH, NEAR_1X, Orbits, mirrored
from rotorfit.checks.probes import pose_in_words
from rotorfit.data.findings import Finding, listed
from rotorfit.models.array_types import ComplexArray, Float, Index

CERTAIN = 3.5
"""Sum of signs over its standard deviation under random signs, beyond which a sign is taken as established."""

SMALL_SINE = 0.1
"""Sine of the phase of kappa below which its sign says little."""

SLOW = (0.1, 0.2, 0.3, 0.5)
"""Fractions of the speed below which whirl may be slower than the fluid; the largest is more than any lam."""

_MOSTLY = 0.8  # share of the energy against the force that is an error; short of that it may be strong anisotropy
_MONOTONIC = 0.8  # rank correlation with frequency from which quadrature falls throughout


def wrong_direction(orbits: Orbits) -> Iterator[Finding]:
    """Responses nearly all of which are against the direction of the force."""
    share: dict[tuple[str, ...], float] = {}
    for key, at in orbits.groups("run", "plane"):
        paired = at[np.isfinite(orbits.wrong[at])]
        if paired.size:
            right, wrong = (float(np.sum(np.abs(part[paired]) ** 2)) for part in (orbits.right, orbits.wrong))
            share[key] = wrong / (right + wrong) if right + wrong > 0 else 0.0
    bad = dict.fromkeys(key for key, part in share.items() if part > _MOSTLY)
    if bad:
        runs = list(dict.fromkeys(run for run, _ in bad))
        planes = list(dict.fromkeys(plane for _, plane in share if any(plane == p for _, p in bad)))
        hit = np.array([key in bad for key in zip(orbits.run.tolist(), orbits.plane.tolist(), strict=True)])
        everywhere = len(bad) == len(share)
        cause = (
            "phase lag read as lead (use phase_lag_deg), x and y probes exchanged, or the sign of the frequency"
            if everywhere
            else f"the probes at {listed(planes)}: x and y exchanged, one of them inverted, or phases as lag"
            if len(planes) < len({plane for _, plane in share})
            else "the sign of the frequency in these runs, or phases given as lag"
        )
        whole = tuple(dict.fromkeys(plane for _, plane in bad)) if _whole(bad, share) else ()
        if named := pose_in_words(orbits, whole) if whole else "":
            cause = f"{cause}. A trial fit says: {named}"
        text = (
            f"The rotor answers mostly against the direction of the force, in "
            f"{'all runs' if everywhere else listed(runs)}. Check {cause}."
        )
        yield Finding("error", "wrong-direction", text, orbits.rows_of(np.flatnonzero(hit)))


def _whole(bad: Collection[tuple[str, ...]], every: Mapping[tuple[str, ...], float]) -> bool:
    """Whether planes answer so in all of their runs, as wrong probes do, and not in some, as a wrong frequency does."""
    planes = {plane for _, plane in bad}
    return all(key in bad for key in every if key[1] in planes)


def _established(values: Float) -> Float:
    """Sum over its standard deviation under random signs, shape ``(...)`` of ``(..., N)``; noise cannot make it large,
    few values cannot either."""
    size = np.sqrt((values * values).sum(axis=-1))
    return np.asarray(values.sum(axis=-1) / np.where(size > 0, size, 1.0))


def surely_right(orbits: Orbits, right: ComplexArray, speed: Float) -> NDArray[np.bool_]:
    """Which of many tests of one plan :func:`signs` has surely nothing to say of, shape ``(W,)``.

    Args:
        orbits: what was read where.
        right: responses in the direction of the force, shape ``(W, N)``.
        speed: of each test, rad/s, shape ``(W,)``.
    """
    at = np.flatnonzero(orbits.place == orbits.force_place)
    moved = (np.abs(right[:, at]) > 0).all(axis=1)
    kappa = np.zeros(right.shape, dtype=complex)
    kappa[:, at] = orbits.force[at] / np.where(right[:, at] == 0, 1.0, right[:, at])
    drives = [np.intersect1d(group, at) for _, group in orbits.groups("run", "plane", "force_plane")]
    signs = [_dissipates(orbits.frequency[group], speed[:, None], kappa[:, group]) for group in drives]
    sweeps = [np.intersect1d(group, at) for _, group in orbits.groups("plane", "force_plane", "speed")]
    falls = np.any([_falls(orbits, kappa, group) for group in sweeps], axis=0)
    told = np.all([sign >= 0 for sign in signs], axis=0) & (np.any([sign > 0 for sign in signs], axis=0) | ~falls)
    reversals = [(score <= CERTAIN).all(axis=0) for score, *_ in _reversals(orbits, kappa, right, speed[:, None], at)]
    return np.asarray(moved & told & np.all(reversals, axis=0))


def signs(orbits: Orbits) -> Iterator[Finding]:
    """Conjugated FRFs, or else a reversed sense of rotation, from the sign of Im kappa at drive points."""
    at = np.flatnonzero((orbits.place == orbits.force_place) & (np.abs(orbits.right) > 0))
    kappa = np.zeros(orbits.right.size, dtype=complex)
    kappa[at] = orbits.force[at] / orbits.right[at]
    driven = kappa != 0
    drives = [group[driven[group]] for _, group in orbits.groups("run", "plane", "force_plane")]
    signs = [_dissipates(orbits.frequency[group], orbits.speed[group], kappa[group]) for group in drives]
    conjugated = [group for group, sign in zip(drives, signs, strict=True) if sign < 0]
    if not any(signs):
        sweeps = [group[driven[group]] for _, group in orbits.groups("plane", "force_plane", "speed")]
        conjugated = [group for group in sweeps if _falls(orbits, kappa, group)]
    if not conjugated:
        yield from _reversed(orbits, kappa, at)
        return
    hit = np.concatenate(conjugated)
    text = (
        "Damping would be negative at the drive point (quadrature dynamic stiffness falls with frequency) in "
        f"{listed(_names(orbits, hit))}: the FRF is conjugated. Give phases of lag as phase_lag_deg and "
        "force_phase_lag_deg, or check the sign convention of the analyser."
    )
    yield Finding("error", "conjugated", text, orbits.rows_of(hit))


def _dissipates(w: Float, speed: Float, kappa: ComplexArray) -> Float:
    """Sign of the dissipation at |w| >= Omega, where the force leads or opposes the fluid whatever lam < 1 is; 0:
    unknown. Shape ``(...)`` of ``(..., N)``."""
    fast = np.abs(w) >= np.abs(speed) * (1 - NEAR_1X)
    sine = kappa.imag / np.abs(kappa) * np.sign(w)
    # a phase of a few degrees may be an error of the reference: such readings hardly count
    score = _established(np.where(fast, sine / np.hypot(sine, SMALL_SINE), 0.0))
    return np.where((np.sum(fast, axis=-1) >= ENOUGH) & (np.abs(score) > CERTAIN), np.sign(score), 0.0)


def _falls(orbits: Orbits, kappa: ComplexArray, at: Index) -> NDArray[np.bool_]:
    """Whether quadrature falls from backward to forward in a sweep below the speed, shape ``(...)`` of ``(..., N)``.

    One direction is enough if there is but one plane; else the other planes' motion turns the slope within a direction.
    """
    w = orbits.frequency[at]
    tells = np.unique(orbits.plane).size == 1 or bool((w > 0).any() and (w < 0).any())
    return np.asarray(tells & (_rank_correlation(w, kappa[..., at].imag) < -_MONOTONIC))


def _reversed(orbits: Orbits, kappa: ComplexArray, at: Index) -> Iterator[Finding]:
    """A reversed sense of rotation: the fluid, which drives slow forward whirl, seems to drive slow backward whirl."""
    found = list(_reversals(orbits, kappa, orbits.right, orbits.speed, at))
    score, rows, slow = max(found, key=lambda one: float(one[0].max()))
    best = int(np.argmax(score))
    if score[best] > CERTAIN:
        hit = np.unique(rows[slow[best]])
        text = (
            f"Slow backward forces drive the rotor instead of damping it in {listed(_names(orbits, hit))}: lam would "
            "be negative. The sense of rotation is reversed, or x and y are exchanged together with the sign of the "
            "frequency; x has to turn towards y with the rotor."
        )
        yield Finding("error", "reversed-rotation", text, orbits.rows_of(hit))


def _reversals(
    orbits: Orbits, kappa: ComplexArray, right: ComplexArray, speed: Float, at: Index
) -> Iterator[tuple[Float, Index, NDArray[np.bool_]]]:
    """Scores of a drive by backward forces, for each limit of what is slow, shape ``(4, ...)``, with the orbits that
    they look at, and which of these count.

    Args:
        orbits: what was read where.
        kappa, right: drive-point stiffness, zero where there is none, and responses, shape ``(..., N)``.
        speed: rad/s, broadcasting with them.
        at: orbits at drive points.
    """
    # slow unbalance moves the rotor little and noise turns its phase: weigh the sign by the response
    power = kappa.imag / np.maximum(np.abs(kappa), np.finfo(float).tiny) * np.abs(right)
    for _, group in orbits.groups("run", "plane", "force_plane"):
        largest = np.abs(right[..., group]).max(axis=-1, keepdims=True)
        power[..., group] /= np.where(largest > 0, largest, 1.0)
    turning = np.broadcast_to(np.where(speed == 0, np.nan, np.abs(speed)), right.shape)
    limits = np.array(SLOW).reshape(-1, *(1,) * right.ndim)
    ratio = orbits.frequency[at] / turning[..., at]
    slow = (ratio < 0) & (ratio > -limits)
    yield _established(np.where(slow, power[..., at], 0.0)), at, slow
    driven = np.zeros(right.shape[-1], dtype=bool)
    driven[at] = True
    groups = [some[driven[some]] for _, some in orbits.groups("plane", "force_plane", "speed")]
    pairs = np.concatenate([mirrored(orbits, some) for some in groups])
    even = _even_quadrature(kappa[..., pairs], right[..., pairs])
    slow = np.abs(orbits.frequency[pairs[:, 0]]) / turning[..., pairs[:, 0]] < limits
    yield _established(np.where(slow, even, 0.0)), pairs, slow


def _even_quadrature(kappa: ComplexArray, right: ComplexArray) -> Float:
    """The part of Im kappa even in w, ``-D lam Omega`` in eq. (13), over its noise up to a factor, shape ``(..., N)``.

    Args:
        kappa, right: drive-point stiffness and response, forward and backward, shape ``(..., N, 2)``.
    """
    noise = np.abs(kappa / right)  # of kappa = F / A, up to a common factor
    return np.asarray(kappa.imag.sum(axis=-1) / np.hypot(noise[..., 0], noise[..., 1]))


def _names(orbits: Orbits, at: Index) -> list[str]:
    return list(dict.fromkeys(orbits.run[at].tolist()))


def _rank_correlation(x: Float, y: Float) -> Float:
    """Spearman's correlation, shape ``(...)`` of ``(N,)`` and ``(..., N)``; zero where there is nothing to compare."""
    if x.size < ENOUGH or np.ptp(x) == 0:
        return np.zeros(y.shape[:-1])
    ranks = [np.argsort(np.argsort(values, axis=-1), axis=-1) - (x.size - 1) / 2 for values in (x, y)]
    return np.asarray(
        np.where(np.ptp(y, axis=-1) == 0, 0.0, np.sum(ranks[0] * ranks[1], axis=-1) / np.sum(ranks[0] ** 2))
    )
