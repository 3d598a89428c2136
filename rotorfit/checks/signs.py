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

from rotorfit.checks.linear_force import SHARE
from rotorfit.checks.orbits import ENOUGH, NEAR_1X, Orbits, mirrored
from rotorfit.checks.probe_angles import pose_in_words
from rotorfit.data.findings import Finding, listed
from rotorfit.models.array_types import ComplexArray, Float, Index

CERTAIN = 3.5
"""Sum of signs over its standard deviation under random signs, beyond which a sign is taken as established."""

SMALL_SINE = 0.1
"""Sine of the phase of kappa below which its sign says little."""

MOSTLY = 0.8
"""Share of the energy against the force that is an error; short of that it may be strong anisotropy."""

CLEAR = 0.9
"""Share of a line's energy from which it turns clearly one way, or the other."""

SLOW = (0.1, 0.2, 0.3, 0.5)
"""Fractions of the speed below which whirl may be slower than the fluid; the largest is more than any lam."""

_DRIVE = ("run", "plane", "force_plane")
_SWEEP = ("plane", "force_plane", "speed")
_RESPONSE = ("run", "speed", "force_plane", "plane")
_SOME = 3  # lines of either kind from which a run is torn
_MONOTONIC = 0.8  # rank correlation with frequency from which quadrature falls throughout


def wrong_direction(orbits: Orbits) -> Iterator[Finding]:
    """Responses against the direction of the force: in some lines of a run, or in nearly all."""
    torn = np.zeros(orbits.frequency.size, dtype=bool)
    for _, at in orbits.groups(*_RESPONSE):
        torn[at] = turned(orbits.right[at], orbits.wrong[at])
    if torn.any():
        yield _in_some_lines(orbits, np.flatnonzero(torn))
    share: dict[tuple[str, ...], float] = {}
    for key, at in orbits.groups("run", "plane"):
        paired = at[np.isfinite(orbits.wrong[at]) & ~torn[at]]
        if paired.size:
            right, wrong = (float(np.sum(np.abs(part[paired]) ** 2)) for part in (orbits.right, orbits.wrong))
            share[key] = wrong / (right + wrong) if right + wrong > 0 else 0.0
    bad = dict.fromkeys(key for key, part in share.items() if part > MOSTLY)
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


def _in_some_lines(orbits: Orbits, at: Index) -> Finding:
    places = zip(orbits.run[at].tolist(), orbits.plane[at].tolist(), strict=True)
    named = listed(list(dict.fromkeys(f"{run} / {plane}" for run, plane in places)))
    text = (
        f"In {at.size} lines the rotor answers against the direction of the force, in the others of the same runs "
        f"along it, and nowhere between the two: {named}. Check whether a probe was turned round, or x and y "
        "exchanged, in these lines, and the sign of their frequency."
    )
    return Finding("error", "turned-lines", text, orbits.rows_of(at))


def turned(along: ComplexArray, against: ComplexArray) -> NDArray[np.bool_]:
    """Lines that are clearly against the force, if of a run some are, some are clearly along it, and few are neither.

    Strong anisotropy turns orbits between two resonances too, but through lines that are neither, eight for each that
    is clearly against; noise makes mostly such lines.
    """
    wrong, both = np.abs(against) ** 2, np.abs(along) ** 2 + np.abs(against) ** 2
    told = np.isfinite(both) & (both > 0)
    share = np.divide(wrong, both, out=np.full(both.shape, np.nan), where=told)
    clear, neither = share > CLEAR, (share <= CLEAR) & (share >= 1 - CLEAR)
    fewer = min(int(clear.sum()), int((share < 1 - CLEAR).sum()))
    torn = fewer >= _SOME and fewer > 2 * neither.sum()
    return np.asarray(clear & bool(torn and wrong[told].sum() > SHARE[0] * both[told].sum()))


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
    """Which of many tests of one plan :func:`signs` has surely nothing to say of, shape ``(...)``."""
    at = np.flatnonzero(orbits.place == orbits.force_place)
    if not at.size:
        return np.ones(right.shape[:-1], dtype=bool)
    drives, moved = orbits.part(at), right[..., at]
    kappa, speed = drives.force / moved, np.broadcast_to(speed, right.shape)[..., at]
    signs = _dissipates(drives, kappa, speed)
    damped = (signs > 0).any(axis=-1)
    if not damped.all():
        falls = [_falls(drives, kappa, sweep, len(orbits.groups("plane"))) for _, sweep in drives.groups(*_SWEEP)]
        damped = damped | ~np.any(falls, axis=0)
    found = moved.all(axis=-1) & (signs >= 0).all(axis=-1) & damped
    if found.any():
        for score, *_ in _reversals(drives, kappa, moved, speed):
            found = found & (score <= CERTAIN).all(axis=0)
    return np.asarray(found)


def signs(orbits: Orbits) -> Iterator[Finding]:
    """Conjugated FRFs, or else a reversed sense of rotation, from the sign of Im kappa at drive points."""
    drives = orbits.part(np.flatnonzero((orbits.place == orbits.force_place) & (orbits.right != 0)))
    if not drives.frequency.size:
        return
    kappa = drives.force / drives.right
    signs = _dissipates(drives, kappa, drives.speed)
    hit = np.flatnonzero((signs < 0)[drives.number(*_DRIVE)])
    if not signs.any():
        planes = len(orbits.groups("plane"))
        falling = [sweep for _, sweep in drives.groups(*_SWEEP) if _falls(drives, kappa, sweep, planes)]
        hit = np.concatenate([hit, *falling])
    if not hit.size:
        yield from _reversed(drives, kappa)
        return
    begin = "Damping would be negative at the drive point (quadrature dynamic stiffness falls with frequency) in "
    begin += listed(_names(drives, hit))
    slow = hit[np.abs(drives.frequency[hit]) <= np.quantile(np.abs(drives.frequency[hit]), 0.2)]
    both = bool(drives.paired[hit].all())
    if np.median(kappa.real[slow]) <= 0:
        cause = (
            ", and so would stiffness: phases are half a turn off. Check the angle of the force or of the weight, and "
            "whether the probes are inverted."
        )
    elif both:
        cause = (
            ". As x and y follow the force's direction, phases of lag alone are not the cause. What turns both probes "
            "alike is: an inverted pair, a filter or a delay, perhaps from some frequency on, a wrong angle of the "
            "force; or phases of lag together with exchanged probes or the other sign of the frequency."
        )
    else:
        cause = (
            ": the FRF is conjugated. Give phases of lag as phase_lag_deg and force_phase_lag_deg, or check the sign "
            "convention of the analyser. One probe alone does not tell that from a filter, or from its sign being "
            "turned round."
        )
    yield Finding("error", "negative-damping" if both else "conjugated", f"{begin}{cause}", drives.rows_of(hit))


def _dissipates(drives: Orbits, kappa: ComplexArray, speed: Float) -> Float:
    """Sign of the dissipation of each drive at |w| >= Omega, where the force leads or opposes the fluid whatever
    lam < 1 is; 0: unknown. Shape ``(..., G)``.
    """
    fast = np.abs(drives.frequency) >= np.abs(speed) * (1 - NEAR_1X)
    sine = kappa.imag / np.abs(kappa) * np.sign(drives.frequency)
    # a phase of a few degrees may be an error of the reference: such readings hardly count
    sign = np.where(fast, sine / np.hypot(sine, SMALL_SINE), 0.0)
    total, square, count = drives.total(np.stack([sign, sign**2, fast]), *_DRIVE)
    score = total / np.where(square > 0, np.sqrt(square), 1.0)
    return np.where((count >= ENOUGH) & (np.abs(score) > CERTAIN), np.sign(score), 0.0)


def _falls(drives: Orbits, kappa: ComplexArray, sweep: Index, planes: int) -> NDArray[np.bool_]:
    """Whether quadrature falls from backward to forward in a sweep below the speed, shape ``(...)`` of ``(..., N)``.

    One direction is enough if there is but one plane; else the other planes' motion turns the slope within a direction.
    """
    w = drives.frequency[sweep]
    tells = planes == 1 or bool((w > 0).any() and (w < 0).any())
    return np.asarray(tells & (_rank_correlation(w, kappa[..., sweep].imag) < -_MONOTONIC))


def _reversed(drives: Orbits, kappa: ComplexArray) -> Iterator[Finding]:
    """A reversed sense of rotation: the fluid, which drives slow forward whirl, seems to drive slow backward whirl."""
    found = list(_reversals(drives, kappa, drives.right, drives.speed))
    score, rows, slow = max(found, key=lambda one: float(one[0].max()))
    best = int(np.argmax(score))
    if score[best] > CERTAIN:
        hit = np.unique(rows[slow[best]])
        text = (
            f"Slow backward forces drive the rotor instead of damping it in {listed(_names(drives, hit))}: lam would "
            "be negative. The sense of rotation is reversed, or x and y are exchanged together with the sign of the "
            "frequency; x has to turn towards y with the rotor."
        )
        yield Finding("error", "reversed-rotation", text, drives.rows_of(hit))


def _reversals(
    drives: Orbits, kappa: ComplexArray, right: ComplexArray, speed: Float
) -> Iterator[tuple[Float, Index, NDArray[np.bool_]]]:
    """Scores of a drive by backward forces, for each limit of what is slow, shape ``(4, ...)``, with the orbits that
    they look at, and which of these count.
    """
    ratio = drives.frequency / np.where(speed == 0, np.nan, np.abs(speed))
    at = np.flatnonzero((np.abs(ratio) < SLOW[-1]).any(axis=tuple(range(ratio.ndim - 1))))
    size = np.abs(right)
    # slow unbalance moves the rotor little and noise turns its phase: weigh the sign by the response
    share = (size / drives.largest(size, *_DRIVE))[..., at]
    limits = np.array(SLOW).reshape(-1, *(1,) * right.ndim)
    slow = (ratio[..., at] < 0) & (ratio[..., at] > -limits)
    yield _established(np.where(slow, kappa.imag[..., at] / np.abs(kappa[..., at]) * share, 0.0)), at, slow
    pairs = mirrored(drives, at, *_SWEEP)
    even = _even_quadrature(kappa[..., pairs], right[..., pairs])
    slow = np.abs(ratio[..., pairs[:, 0]]) < limits
    yield _established(np.where(slow, even, 0.0)), pairs, slow


def _even_quadrature(kappa: ComplexArray, right: ComplexArray) -> Float:
    """The part of Im kappa even in w, ``-D lam Omega`` in eq. (13), over its noise, shape ``(..., N)``."""
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
