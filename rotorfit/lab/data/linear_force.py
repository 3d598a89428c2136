"""Readings x and y as motion with the force and against it; forces along an axis, which drive both at once."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index, Text
from rotorfit.base.digits import counted, significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.synchronous import join


def whirl_parts(test: PerturbationTest, planar: Bool | None = None) -> tuple[PerturbationTest, Index]:
    """The test with each x/y pair under a force along an axis replaced by its forward and its backward part.

    ``Re(X exp(jwt)) + j Re(Y exp(jwt))`` is ``(X + jY)/2`` at +w and ``conj(X - jY)/2`` at -w: readings z at signed
    frequencies, whose noises are independent as long as x and y are equally noisy. At ``planar`` rows, shape ``(R,)``,
    x and y are not coupled and motion stays in the plane of the force: ``X = H(w) Fx``, the answer to a circular force
    of that size. Returns the test, and the two rows of the original that each of its rows was made of, shape ``(N,
    2)``, equal where the reading is as it was.
    """
    split = test.linear & ~np.char.endswith(test.direction, "z")
    if not split.any():
        return test, np.repeat(np.arange(len(test))[:, None], 2, axis=1)
    pairs, lonely = probe_pairs(test, split)
    alone = lonely if planar is None else lonely[~planar[lonely]]
    if alone.size:
        row, rpm = alone[0], test.speed[alone[0]] * RPM_PER_RAD_S
        raise ValueError(
            f"{test.source or 'the test'}: {counted(alone.size, 'reading')} under a force along an axis without a "
            f"partner in the other direction (row {row + 1}: {test.plane[row]} {test.direction[row]}, at "
            f"{significant(rpm, 4)} rpm); such a force moves a rotor that turns forward and backward at once, "
            "which one probe cannot tell apart. One direction is enough at rest (speed 0) and for models "
            "without cross-coupling"
        )
    x, y = pairs.T
    whole = np.flatnonzero(~split)
    parts = [test.select(whole), _in_plane(test, lonely)]
    origin = [np.column_stack([rows, rows]) for rows in (whole, lonely)]
    halves = (
        (test.frequency[x], (test.response[x] + 1j * test.response[y]) / 2),
        (-test.frequency[x], np.conj(test.response[x] - 1j * test.response[y]) / 2),
    )
    for frequency, response in halves:
        part = test.select(x)
        part = replace(
            part,
            frequency=frequency,
            response=response,
            sigma=np.hypot(test.sigma[x], test.sigma[y]) / 2,
            direction=_combined(part.direction),
        )
        parts.append(part)
        origin.append(pairs)
    return join(parts), np.concatenate(origin)


def _combined(direction: Text) -> Text:
    return np.where(np.char.startswith(direction, "r"), "rz", "z")


def _in_plane(test: PerturbationTest, rows: Index) -> PerturbationTest:
    """Readings along their force's axis as of a circular force; of two forces that along the reading's axis counts."""
    part = test.select(rows)
    force, plane = part.force.copy(), part.force_plane.astype(object)
    along, further = part.force_direction.copy(), part.further_forces.copy()
    axes = np.char.lstrip(part.direction, "r")
    for row in np.flatnonzero(part.several).tolist():
        mine = [(at, size, "circular") for at, size, axis in part.acting(row) if axis == axes[row] and size != 0]
        if mine:
            (plane[row], force[row], _), *rest = mine
            along[row], further[row] = axes[row], tuple(rest)
    across = axes != along
    if across.any():
        first = int(np.flatnonzero(across)[0])
        row = int(rows[first])
        raise ValueError(
            f"{test.source or 'the test'}: row {row + 1} reads {test.plane[row]} {test.direction[row]} alone under a "
            f"force along {along[first]}. Without cross-coupling nothing moves across the force: leave such readings "
            "out, give those along the force too, or fit a model with x and y apart (anisotropic)"
        )
    return replace(
        part,
        direction=_combined(part.direction),
        force=force,
        force_plane=plane.astype(str),
        force_direction=np.full(rows.size, "circular"),
        further_forces=further,
    )


def probe_pairs(test: PerturbationTest, rows: Bool) -> tuple[Index, Index]:
    """Rows of x and y (rx and ry) taken together, ``(N, 2)``, repeats in their order, and rows without a partner."""
    found: dict[Any, tuple[list[int], list[int]]] = {}
    names = ("run", "set_speed", "frequency", "force_plane", "force", "force_direction", "further_forces", "plane")
    keys = zip(*[getattr(test, name).tolist() for name in names], strict=True)
    for row, (key, direction, wanted) in enumerate(zip(keys, test.direction.tolist(), rows.tolist(), strict=True)):
        if wanted and direction[-1] in "xy":
            found.setdefault((key, direction[:-1]), ([], []))["xy".index(direction[-1])].append(row)
    pairs = [pair for x, y in found.values() for pair in zip(x, y, strict=False)]
    lonely = [row for x, y in found.values() for row in (*x[len(y) :], *y[len(x) :])]
    return np.array(pairs, dtype=np.intp).reshape(-1, 2), np.array(sorted(lonely), dtype=np.intp)


def directional(response: ComplexArray, rows: Index, backward: Bool) -> tuple[ComplexArray, ComplexArray]:
    """Motion in the direction of the force, relative to ``exp(jwt)``, and against it, relative to ``exp(-jwt)``. ``Re(X
    exp(j|w|t)) + j Re(Y exp(j|w|t))`` is ``(X + jY)/2`` forward and ``conj(X - jY)/2`` backward. What one probe reads
    alone is taken for that of a circular orbit, ``Y = -jX`` forward and ``Y = +jX`` backward; a reading z is motion in
    the direction of the force as it is, and counts where neither x nor y was read."""
    seen, turn = rows >= 0, np.where(backward, -1j, 1j)
    right = np.where(seen[:, 2], response[..., rows[:, 2]], np.nan)
    wrong = np.full(right.shape, np.nan, dtype=complex)
    x, y, pair = (
        np.flatnonzero(some) for some in (seen[:, 0] & ~seen[:, 1], seen[:, 1] & ~seen[:, 0], seen[:, 0] & seen[:, 1])
    )
    if x.size:
        right[..., x] = _folded(response[..., rows[x, 0]], backward[x])
    if y.size:
        right[..., y] = _folded(response[..., rows[y, 1]] * turn[y], backward[y])
    if pair.size:
        along, across = response[..., rows[pair, 0]], response[..., rows[pair, 1]] * turn[pair]
        right[..., pair] = _folded((along + across) / 2, backward[pair])
        wrong[..., pair] = _folded((along - across) / 2, ~backward[pair])
    return right, wrong


def _folded(values: ComplexArray, backward: Bool) -> ComplexArray:
    """Conjugates where a phasor relative to exp(j|w|t) is that of motion backward."""
    return np.where(backward, values.conj(), values)


def directional_noise(sigma: Float, rows: Index) -> Float:
    """Standard deviation of each part of the motion in the direction of the force, shape ``(..., M)``."""
    seen = rows >= 0
    noise = np.where(seen[:, 2], sigma[..., rows[:, 2]], np.nan)
    for axis in (1, 0):
        if seen[:, axis].any():
            noise = np.where(seen[:, axis], sigma[..., rows[:, axis]], noise)
    both = np.flatnonzero(seen[:, 0] & seen[:, 1])
    if both.size:
        noise[..., both] = np.sqrt(sigma[..., rows[both, 0]] ** 2 + sigma[..., rows[both, 1]] ** 2) / 2
    return noise
