"""Steady states of the integrated motion: phasors under rotating forces, positions under constant loads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float, Index
from rotorfit.models.digits import significant
from rotorfit.simulation.integration import STEP_TOLERANCE, IntegrationError, Motion, Path, integrate
from rotorfit.units import RPM_PER_RAD_S

_MOST_WINDOWS = 60  # windows in which a motion must settle
_TIME_CONSTANTS = 3.0  # time constants of the slowest transient in a window


class Steady(NamedTuple):
    """Steady motion ``mean + forward exp(jwt) + backward exp(-jwt) + ...``, all of shape ``(L, n)``, and its end."""

    forward: ComplexArray  # amplitude at the signed frequency w of the force
    backward: ComplexArray  # amplitude at -w, zero on a centred circular orbit
    mean: ComplexArray  # constant displacement
    z: ComplexArray  # displacement at the last instant, turned back to that of a force at phase zero
    v: ComplexArray  # velocity at the last instant, turned likewise


def steady_state(
    motion: Motion,
    frequency: Float,
    force: ComplexArray,
    decay: Float,
    *,
    load: ComplexArray | None = None,
    start: tuple[ComplexArray, ComplexArray] | None = None,
    tolerance: float = STEP_TOLERANCE,
) -> Steady:
    """Integrate under ``force exp(jwt) + load`` until nothing changes any more, then measure the motion."""
    zero = np.zeros_like(force)
    z, v = start or (zero, zero)
    load = zero if load is None else load
    parts = {name: np.zeros_like(force) for name in Steady._fields}
    # Where nothing acts a stable rotor is at rest, of no size to which steps could be held.
    driven = (force != 0).any(axis=1) | (load != 0).any(axis=1) | (motion.imposed is not None)
    # Lines within an octave go together, so that windows of whole periods are of like length.
    w, left = np.abs(frequency), np.flatnonzero(driven)
    octave = np.floor(np.log2(w[left] / w.min())) if left.size else left
    groups: list[Index] = []
    # States integrated together: times the 13 slopes of a step of DOP853 they stay below the 4096 elements from which
    # OpenBLAS starts threads, whose waiting for each other takes longer than the product
    states_together = 300
    for number in np.unique(octave):
        mine = left[octave == number]
        count = -(-mine.size * 2 * force.shape[1] // states_together)
        groups += np.array_split(mine[np.argsort(w[mine], kind="stable")], count)
    for lines in groups:
        chosen = (motion.select(lines), frequency[lines], force[lines], load[lines], decay[lines])
        found = _settle(*chosen, z[lines], v[lines], tolerance)
        for name, values in found._asdict().items():
            parts[name][lines] = values
    return Steady(**parts)


def rest_position(
    motion: Motion, load: ComplexArray, decay: Float, *, tolerance: float = STEP_TOLERANCE
) -> ComplexArray:
    """Integrate under constant loads, from the centre, until nothing moves: the equilibria, shape ``(L, n)``."""
    z, v = np.zeros_like(load), np.zeros_like(load)
    size = _typical(motion, np.zeros(load.shape[0]), np.zeros_like(load), load)
    window = _TIME_CONSTANTS / decay.min()
    for _ in range(_MOST_WINDOWS):
        path = integrate(motion, lambda _: load, z, v, (0.0, window), size=size, rate=decay, tolerance=tolerance)
        moved = np.abs(path.z - path.z[-1]).max(axis=0)
        z, v = path.z[-1], path.v[-1]
        if (moved <= 10 * tolerance * np.abs(z).max(axis=1, keepdims=True)).all():
            return np.asarray(z)
    raise IntegrationError(
        f"{motion.model.name}: the rotor has not come to rest after {significant(_MOST_WINDOWS * window, 3)} s; it may "
        "be unstable under this load"
    )


def _settle(
    motion: Motion,
    w: Float,
    force: ComplexArray,
    load: ComplexArray,
    decay: Float,
    z: ComplexArray,
    v: ComplexArray,
    tolerance: float,
) -> Steady:
    result = {name: np.zeros_like(force) for name in Steady._fields}
    window = max(2 * np.pi / np.abs(w).min(), _TIME_CONSTANTS / decay.min())
    size = _typical(motion, w, force, load) if motion.imposed is None else np.abs(z).max(axis=1)
    rate = np.abs(w) + decay
    left = np.arange(w.size)
    before = np.full(force.shape, np.inf, dtype=complex)
    time = 0.0
    for _ in range(_MOST_WINDOWS):
        drive, constant, omega = force[left], load[left], w[left]

        def push(
            t: float, drive: ComplexArray = drive, constant: ComplexArray = constant, omega: Float = omega
        ) -> ComplexArray:
            return np.asarray(drive * np.exp(1j * omega * t)[:, None] + constant)

        span = (time, time + window)
        path = integrate(motion.select(left), push, z, v, span, size=size[left], rate=rate[left], tolerance=tolerance)
        mean, forward, backward = _phasors(path, omega)
        z, v, time = path.z[-1], path.v[-1], span[1]
        # Within a window a transient shrinks by exp(-3): what has changed is nearly all that is left of it.
        settled = np.abs(forward - before).max(axis=1) <= 10 * tolerance * np.abs(forward).max(axis=1)
        done = left[settled]
        turn = np.exp(-1j * omega * time)[settled, None]
        centred = {"forward": forward, "backward": backward, "mean": mean}
        for name, values in centred.items():
            result[name][done] = values[settled]
        result["z"][done] = (z[settled] - mean[settled]) * turn + mean[settled]
        result["v"][done] = v[settled] * turn
        left, z, v, before = left[~settled], z[~settled], v[~settled], forward[~settled]
        if not left.size:
            return Steady(**result)
    raise IntegrationError(
        f"{motion.model.name}: the motion has not settled after {significant(time, 3)} s in {left.size} of {w.size} "
        f"cases, the first at {significant(w[left[0]] * RPM_PER_RAD_S, 4)} rpm; the rotor may be unstable or vibrate "
        "with more than one period"
    )


def _typical(motion: Motion, w: Float, force: ComplexArray, load: ComplexArray) -> Float:
    """Size of the linear response, m, shape ``(L,)``; the clearance limits it."""
    moving = np.einsum("lij,lj->li", motion.model.receptance(motion.theta, w, motion.speed), force)
    at_rest = np.einsum("lij,lj->li", motion.model.receptance(motion.theta, 0.0, motion.speed), load)
    size = (np.abs(moving) + np.abs(at_rest)).max(axis=1)
    limit = motion.model.clearance if motion.model.eccentricity_dependent else None
    return np.asarray(size if limit is None else np.minimum(size, limit))


def _phasors(path: Path, frequency: Float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Mean, forward and backward amplitude by least squares over the last whole periods, shapes ``(L, n)``. Harmonics
    are fitted along: small motion about an eccentric equilibrium has some."""
    orders = [0, 1, -1]
    harmonics = 3
    orders += [sign * k for k in range(2, harmonics + 1) for sign in (1, -1)]
    amplitudes = np.zeros((3, *path.z.shape[1:]), dtype=complex)
    length = path.time[-1] - path.time[0]
    for line, w in enumerate(np.abs(frequency).tolist()):
        period = 2 * np.pi / w
        begin = path.time[-1] - max(np.floor(length / period * (1 + 1e-9)), 1.0) * period
        inside = path.time >= begin - 1e-9 * period
        basis = np.exp(1j * frequency[line] * path.time[inside, None] * np.array(orders))
        amplitudes[:, line] = np.linalg.lstsq(basis, path.z[inside, line], rcond=None)[0][:3]
    return amplitudes[0], amplitudes[1], amplitudes[2]
