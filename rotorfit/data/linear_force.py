"""Forces that do not turn: a shaker, or one axis of a magnetic bearing, excites forward and backward whirl at once."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.synchronous import join
from rotorfit.models.array_types import Bool, Index


def whirl_parts(test: PerturbationTest) -> tuple[PerturbationTest, Index]:
    """The test with each x/y pair under a force along an axis replaced by its forward and its backward part.

    ``Re(X exp(jwt)) + j Re(Y exp(jwt))`` is ``(X + jY)/2`` at +w and ``conj(X - jY)/2`` at -w: readings z at signed
    frequencies, one the answer to the forward half of the force, the other to its backward half. Their noises are
    independent as long as x and y are equally noisy.

    Returns:
        the test, and the two rows of the original that each of its rows was made of, shape ``(N, 2)``, equal where the
        reading is as it was.
    """
    split = test.linear & ~np.char.endswith(test.direction, "z")
    if not split.any():
        return test, np.repeat(np.arange(len(test))[:, None], 2, axis=1)
    pairs, lonely = probe_pairs(test, split)
    if lonely.size:
        raise ValueError(
            f"{test.source or 'the test'}: {lonely.size} readings under a force along an axis have no partner in the "
            f"other direction (row {lonely[0] + 1}: {test.plane[lonely[0]]} {test.direction[lonely[0]]}); such a force "
            "moves the rotor forward and backward at once, which one probe cannot tell apart"
        )
    x, y = pairs.T
    whole = np.flatnonzero(~split)
    parts = [test.select(whole)]
    origin = [np.column_stack([whole, whole])]
    halves = (
        (test.frequency[x], (test.response[x] + 1j * test.response[y]) / 2),
        (-test.frequency[x], np.conj(test.response[x] - 1j * test.response[y]) / 2),
    )
    for frequency, response in halves:
        part = test.select(x)
        tilt = np.char.startswith(part.direction, "r")
        part = replace(
            part,
            frequency=frequency,
            response=response,
            sigma=np.hypot(test.sigma[x], test.sigma[y]) / 2,
            direction=np.where(tilt, "rz", "z"),
        )
        parts.append(part)
        origin.append(pairs)
    return join(parts), np.concatenate(origin)


def probe_pairs(test: PerturbationTest, rows: Bool) -> tuple[Index, Index]:
    """Rows of x and y (rx and ry) readings taken together, shape ``(N, 2)``, and rows without a partner.

    Repeats pair in order of appearance.
    """
    found: dict[Any, tuple[list[int], list[int]]] = {}
    names = ("run", "set_speed", "frequency", "force_plane", "force", "force_direction", "further_forces", "plane")
    keys = zip(*[getattr(test, name).tolist() for name in names], strict=True)
    for row, (key, direction, wanted) in enumerate(zip(keys, test.direction.tolist(), rows.tolist(), strict=True)):
        if wanted and direction[-1] in "xy":
            found.setdefault((key, direction[:-1]), ([], []))["xy".index(direction[-1])].append(row)
    pairs = [pair for x, y in found.values() for pair in zip(x, y, strict=False)]
    lonely = [row for x, y in found.values() for row in (*x[len(y) :], *y[len(x) :])]
    return np.array(pairs, dtype=np.intp).reshape(-1, 2), np.array(sorted(lonely), dtype=np.intp)
