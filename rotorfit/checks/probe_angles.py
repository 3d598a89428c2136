"""Pairs of probes that sit at another angle than they are said to: turned, exchanged, inverted.

A turn of both probes by an angle a leaves the orbits circular and multiplies every response by ``exp(-ja)``: it is
found where the whole dynamic stiffness is measured (eq. 7), because inertia is real.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from rotorfit.checks.orbits import Orbits, Receptances, receptances_of, total_power
from rotorfit.checks.stiffness_polynomials import inertia_turns, some_lines, unexplained
from rotorfit.data.findings import Finding
from rotorfit.models.array_types import ComplexArray

CLEAR = 6.0
"""Turn over its error beyond which it is there."""

CIRCULAR = 0.2
"""Part of the orbits against the force, of amplitude, beyond which they are no circles."""

BETTER = 0.5
"""Misfit of a trial fit with turned probes, over that without, in power, from which the turn is believed: what neither
explains, such as an anisotropic support, is no turn."""

MOST_SPEEDS = 3
"""Rotative speeds that the search looks at."""

SMALLEST_TURN = 15.0
"""Turn of a pair of probes, degrees, beyond which it is no matter of calibration."""


@dataclass(frozen=True)
class _Pose:
    """How a pair of probes stands: turned by an angle, its error, degrees, and whether the damping seen is positive."""

    turn: float
    error: float
    damped: bool


def turned_probes(orbits: Orbits) -> Iterator[Finding]:
    """Pairs of probes that sit at another angle than they are said to."""
    paired = orbits.paired
    if not paired.any() or total_power(orbits.wrong[paired]) > CIRCULAR**2 * total_power(orbits.right[paired]):
        return  # anisotropic, of which inertia as seen by circular orbits says nothing
    if surely_straight(orbits, orbits.right):
        return
    found = {
        plane: pose
        for plane, pose in poses(orbits, ()).items()
        if abs(pose.turn) > max(SMALLEST_TURN, CLEAR * pose.error)
    }
    if not found or not _turn_pays(orbits):
        return
    for plane, pose in found.items():
        a = pose.turn
        what = (
            f"The pair of probes at {plane} is inverted, both x and y, or the force there has the wrong sign"
            if abs(abs(a) - 180) < SMALLEST_TURN
            else f"The probes at {plane} read as if they sat at {a:.0f} and {a + 90:.0f} degrees instead of 0 and 90"
        )
        text = (
            f"{what}: with any other angle the rotor's inertia would not be real. Give their angles (probe_angles), or "
            "check the angle of the force. Stiffness and damping are mixed by it: D, lam and K0 are all wrong."
        )
        yield Finding("error", "probe-angle", text, orbits.rows_of(np.flatnonzero(orbits.plane == plane)))


def _upright(measured: Receptances | None) -> NDArray[np.bool_]:
    """Whether straight lines through the dynamic stiffness show every pair far from turned, shape ``(...)``."""
    found = np.ones((), dtype=bool)
    for _, turn, error, _ in inertia_turns(measured, trial=False):
        found = found & (np.abs((turn + 180) % 360 - 180) + CLEAR * error < SMALLEST_TURN / 2)
    return found


def surely_straight(orbits: Orbits, right: ComplexArray) -> NDArray[np.bool_]:
    """Whether :func:`turned_probes` has surely nothing to say, of one test or many of one plan, shape ``(...)``.

    There is no pair, or straight lines through the dynamic stiffness show every pair far from turned.
    """
    found = np.ones(right.shape[:-1], dtype=bool)
    if not orbits.paired.any():
        return found
    alone = right is orbits.right
    speeds = orbits.groups("speed")[:MOST_SPEEDS]
    told = orbits.receptances(MOST_SPEEDS) if alone else [receptances_of(orbits, right, at) for _, at in speeds]
    for measured in told:
        if measured is not None and not alone and not measured.regular.all():
            return np.zeros(right.shape[:-1], dtype=bool)  # each has to be looked at by itself
        found = found & _upright(measured)
    return found


def _turn_pays(orbits: Orbits) -> bool:
    """Whether turned probes explain what straight ones do not, at one speed at least."""
    for measured in orbits.receptances(MOST_SPEEDS):
        lines = some_lines(measured)
        if lines is not None:
            free, upright = (unexplained(lines, upright=kept) for kept in (False, True))
            if np.isfinite(free) and (np.isnan(upright) or free < BETTER * upright):
                return True
    return False


def pose_in_words(orbits: Orbits, mirrored: tuple[str, ...]) -> str:
    """What is wrong with pairs of probes whose orbits turn the wrong way round; empty where that is not known."""
    found = poses(orbits, mirrored)
    words = []
    for plane in mirrored:
        if plane not in found:
            return ""
        pose = found[plane]
        nearest = min((0, 90, 180, -90), key=lambda a, turn=pose.turn: abs((turn - a + 180) % 360 - 180))  # type: ignore[misc]
        if abs((pose.turn - nearest + 180) % 360 - 180) > SMALLEST_TURN:
            return ""
        if nearest == 0 and not pose.damped:
            words.append("lag")
        else:
            words.append(
                {0: "y inverted", 90: "x and y exchanged", 180: "x inverted"}.get(
                    nearest, "x and y exchanged, both inverted"
                )
            )
    if words and set(words) == {"lag"}:
        return "phases of lag were given as lead (use phase_lag_deg and force_phase_lag_deg)"
    return "; ".join(f"at {plane} {word}" for plane, word in zip(mirrored, words, strict=True) if word != "lag")


def poses(orbits: Orbits, mirrored: tuple[str, ...]) -> dict[str, _Pose]:
    """Turn of every pair of probes that is certain: that which makes the inertia of eq. (7) real and positive."""
    found: dict[str, list[tuple[float, float, bool]]] = {}
    measured = orbits.receptances(MOST_SPEEDS)
    if mirrored:
        amplitude = np.where(np.isin(orbits.plane, mirrored), orbits.wrong.conj(), orbits.right)
        speeds = islice(orbits.groups("speed"), MOST_SPEEDS)
        measured = [receptances_of(orbits, amplitude, at) for _, at in speeds]
    for at_speed in measured:
        for plane, *told in inertia_turns(at_speed):
            angle, uncertain, damping = (np.asarray(value).item() for value in told)
            found.setdefault(plane, []).append((angle, uncertain, damping))
    result = {}
    speeds_tried = sum(some_lines(at_speed) is not None for at_speed in measured)
    for plane, values in found.items():
        if len(values) < speeds_tried:
            continue  # probes stand as they do at every speed: what explains one of them only is no explanation
        turns, errors = np.array([v[0] for v in values]), np.maximum([v[1] for v in values], 0.1)
        weight = errors**-2
        apart = (turns - turns[np.argmin(errors)] + 180) % 360 - 180
        error = float(np.sum(weight) ** -0.5)
        turn = float(turns[np.argmin(errors)] + np.sum(weight * apart) / np.sum(weight))
        agree = (np.abs(apart) < SMALLEST_TURN + CLEAR * errors).all()
        if agree and error < SMALLEST_TURN / 2:
            result[plane] = _Pose((turn + 180) % 360 - 180, error, values[int(np.argmin(errors))][2])
    return result
