"""Some readings with a factor or an angle of their own: those of a run, of a plane in a run, of a speed, of a plane.

What the rest of the data makes one expect of them is predicted; where they differ from it by one number, that number
is the error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.diagnosis.probe_filters import INSTRUMENT_SCATTER, POWERS, SAME_FACTOR, likeness
from rotorfit.diagnosis.trials.trial_fits import (
    EXPLAINED_MISFIT_SHARE,
    EXPLAINING_MISFIT_SHARE,
    PROMISING_MISFIT_SHARE,
    Explanation,
    Hint,
    Readings,
    trial,
)
from rotorfit.models.array_types import Bool, ComplexArray
from rotorfit.models.digits import significant
from rotorfit.units import RPM_PER_RAD_S

_MOST_GROUPS, _MOST_SPEEDS = 40, 8  # groups looked at, and speeds that are few enough to be sessions


@dataclass(frozen=True, kw_only=True)
class _Group:
    """Readings that may have a factor of their own."""

    who: str  # whose they are
    rows: Bool  # which, shape ``(R,)``
    forces: str = ""  # whose forces they are all readings of; empty where other readings are of the same forces
    other: _Group | None = None  # where there are two such groups, the other one
    unless: str = ""  # what else may make them seem so


def factors_of_groups(readings: Readings, missed: float, hint: Hint, known: Sequence[str]) -> Iterator[Explanation]:
    """Explanations of the data by factors and angles that some readings alone have."""
    seen = {np.ones(readings.run.size, dtype=bool).tobytes()}
    count = 0
    for level in _levels(readings, known):
        explained = False
        for group in level:
            key = group.rows.tobytes()
            if key in seen or count == _MOST_GROUPS or not group.rows.any():
                continue
            seen.add(key)
            if not hint(np.where(group.rows[:, None], np.array([1.0, 1j]), 0.0)):
                continue
            count += 1
            for one, found in _of_group(readings, group, missed):
                seen.add(one.rows.tobytes())
                explained |= found.left < EXPLAINED_MISFIT_SHARE
                yield found
        if explained:
            return


def _of_group(readings: Readings, group: _Group, missed: float) -> Iterator[tuple[_Group, Explanation]]:
    left, x = trial(readings.without(group.rows))
    if left > PROMISING_MISFIT_SHARE * missed:
        return
    power, factor, unlike = _factor(readings, group.rows, np.concatenate(readings.problem.predict(x)))
    if unlike > EXPLAINING_MISFIT_SHARE or (not power and abs(np.log(factor)) < INSTRUMENT_SCATTER):
        return
    either = [(group, factor)]
    if group.other is not None and not power:
        either.append((group.other, 1 / factor))  # scale and angle of all hardly tell which of the two is right
    # Other runs that show whether it is one run alone, and times by which it must differ more than any of them
    fewest_other_runs, least_difference_ratio = 2, 5.0
    for one, own in either:
        seen = np.where(one.rows, own * (readings.s / readings.middle) ** power, 1.0)
        problem = readings.corrected(seen)
        left, x = trial(problem)
        # Runs beside the one that was corrected are as expected: where all differ, none has the error.
        others = np.unique(readings.run[~one.rows]).tolist()
        if np.unique(readings.run[one.rows]).size == 1 and len(others) >= fewest_other_runs:
            corrected, expected = replace(readings, problem=problem), np.concatenate(problem.predict(x))
            apart = (abs(np.log(_factor(corrected, readings.run == run, expected, (0,))[1])) for run in others)
            if max(apart) >= abs(np.log(own)) / least_difference_ratio:
                continue
        yield one, _explanation(one, power, own, left / missed)


def _levels(readings: Readings, known: Sequence[str]) -> Iterator[list[_Group]]:
    """Sets of readings, the likeliest to share an error first; of later ones none that an earlier one explains."""
    w = readings.frequency
    speeds = np.unique(readings.speed).tolist()
    ways = [
        [(f"of run {run}", readings.run == run) for run in np.unique(readings.run).tolist()],
        [(f"at {v * RPM_PER_RAD_S:.6g} rpm", readings.speed == v) for v in speeds if len(speeds) <= _MOST_SPEEDS],
        [("of forward whirl", w > 0), ("of backward whirl", w < 0)],
    ]
    planes = np.unique(readings.plane).tolist()
    forced = np.unique(readings.force_plane).tolist()
    unless = f", unless what was given as known ({', '.join(known)}) is wrong" if known else ""
    forces = [(f"under forces at {p}", readings.force_plane == p, f"at {p}") for p in forced]
    yield [*_set(forces, unless), *_set([(f"at {p}", readings.plane == p, "") for p in planes], unless)]
    yield [group for way in ways for group in _set([(who, rows, who) for who, rows in way])]
    if len(planes) > 1:
        for way in reversed(ways):
            yield [
                group
                for p in planes
                for group in _set([(f"{who} at {p}", rows & (readings.plane == p), "") for who, rows in way])
            ]


def _set(ways: Sequence[tuple[str, Bool, str]], unless: str = "") -> list[_Group]:
    """Groups that together are one whole, of which two are each the other's other."""
    groups = [_Group(who=who, rows=rows, forces=forces, unless=unless) for who, rows, forces in ways]
    if len(groups) != 2:
        return groups
    return [replace(one, other=other) for one, other in (groups, reversed(groups))]


def _factor(
    readings: Readings, rows: Bool, expected: ComplexArray, powers: Sequence[int] = (0, *POWERS)
) -> tuple[int, complex, float]:
    """Power of the frequency and factor by which readings differ from what is expected, and share of power left."""
    size = readings.problem.sigma[rows]
    p, m = (readings.seen(values)[rows] / size for values in (expected, readings.problem.measured))
    found = []
    for power in powers:
        own = p * (readings.s[rows] / readings.middle) ** power
        factor = complex(np.vdot(own, m) / np.vdot(own, own).real)
        found.append((power, factor, float(np.sum(np.abs(m - factor * own) ** 2) / np.sum(np.abs(m) ** 2))))
    return min(found, key=lambda one: one[2])


def _explanation(group: _Group, power: int, factor: complex, left: float) -> Explanation:
    free = 1 + abs(power)
    if power:
        code, what, undo = POWERS[power]
        return Explanation(left=left, code=code, message=f"the readings {group.who} are {what}", undo=undo, free=free)
    size, angle = abs(factor), float(np.degrees(np.angle(factor)))
    parts, causes, codes = [], [], []
    if abs(np.log(size)) > SAME_FACTOR:
        codes.append("readings-scaled")
        parts.append(f"are {significant(size, 3)} times as large as the rest makes one expect{likeness(size)}")
        causes.append(f"are given {significant(1 / size, 3)} times as large as they are")
    zero_angle = 3.0  # departure of an angle from zero, degrees, that is none
    if 180 - abs(angle) < zero_angle:
        codes.append("readings-inverted")
        parts.append("are upside down against what the rest makes one expect")
        causes.append("have the wrong sign (weights on the opposite side)")
    elif abs(angle) > zero_angle:
        codes.append("readings-turned")
        lead = f"{'lead' if angle > 0 else 'lag'} by {significant(abs(angle), 3)} degrees"
        parts.append(f"{lead} against what the rest makes one expect, as where the phase reference is another")
        causes.append(
            f"act {significant(angle, 3, sign=True)} degrees from where they are given (weights in other holes)"
        )
    cause = f", or the forces {group.forces} {' and '.join(causes)}" if group.forces else ""
    return Explanation(
        left=left,
        code=codes[0],
        message=f"the readings {group.who} {' and '.join(parts)}{cause}{group.unless}",
        undo=f"divide the readings {group.who} by {significant(size, 3)} at {significant(angle, 3)} degrees",
        free=free,
    )
