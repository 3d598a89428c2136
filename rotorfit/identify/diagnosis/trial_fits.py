"""Fits with an error of the data undone: what was read as ``factor`` times the truth, or rows left out; and errors that
some readings alone have.

What the rest of the data makes one expect of a run, a plane, a speed is predicted; where the readings differ from it by
one number, that number is the error.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float, Text
from rotorfit.base.digits import significant
from rotorfit.base.faults import of_program
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.blocks.observations import linear_responses
from rotorfit.estimators.blocks.row_keys import numbers, rows_by
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.closed_form import closed_form
from rotorfit.estimators.starting.start_points import short_fits
from rotorfit.identify.diagnosis.probe_filters import (
    CHANNEL_FILTERS,
    INSTRUMENT_SCATTER,
    POWERS,
    SAME_FACTOR,
    likeness,
)
from rotorfit.lab.data.experiments import PerturbationTest

Hint = Callable[[ComplexArray], bool]
"""Answers True if small errors whose logarithm changes readings so, shape ``(R, k)``, may explain the misfit."""

EXPLAINED_MISFIT_SHARE = 0.01
"""Share of the misfit left from which nothing else has to be tried."""
EXPLAINING_MISFIT_SHARE = 0.1
"""Misfit that is left, of that of the data as given, if an error is the explanation, and share of the power of readings
left by a factor of theirs: missing structure alone does not vanish by what has nothing to do with it. Chosen."""
PROMISING_MISFIT_SHARE = 0.5
"""Share of the misfit that the right value leaves at most in a closed form, or without the wrong readings. Chosen."""
ALL = "all"
"""Who all readings are, in the name of a correction."""
MOST_PLANES = 4
"""Planes that are looked at one by one. Chosen: an experiment with an error has few."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Explanation:
    """An error of the data that was undone in a trial fit."""

    left: float  # share of the misfit that the fit leaves without it
    code: str
    message: str
    undo: str
    correction: str | None = None  # name of the error in the table of those that can be undone
    free: int = 0  # values that were searched for; of errors that explain the data alike, those with the fewest count
    end: Float | None = None  # where the trial fit ended, nuisance entries of its own behind the others


def trial(problem: Problem, *, search: bool = True) -> tuple[float, Float]:
    """Sum of squares that a short search from the closed form leaves, or the closed form alone in a tenth of the time,
    and its end; infinite where the data allow none. What is right needs no better start, and to look for one takes
    longer than all the rest."""
    space = problem.space
    end = np.zeros(space.size)
    try:
        end[: len(space.names)] = closed_form(space, problem.blocks).x
        end = np.clip(end, space.lower, space.upper)
        if search:
            (end,) = short_fits(problem, end[None]).x
    except (ValueError, np.linalg.LinAlgError) as reason:  # what cannot be fitted explains nothing
        if of_program(reason):
            raise
        return float("inf"), end
    left = 2 * problem.cost(end)
    return left if np.isfinite(left) else float("inf"), end


@dataclass(frozen=True, eq=False, kw_only=True)
class Readings:
    """Readings of all blocks one after the other, shape ``(R,)`` each."""

    problem: Problem  # as the data were given
    plane: Text  # plane of its probe
    force_plane: Text  # plane of its force
    speed: Float  # rad/s
    frequency: Float  # signed, rad/s
    conjugated: Bool  # where a reading is the conjugate of what probes gave

    @property
    def s(self) -> ComplexArray:
        """The variable j w of what probes gave, w > 0."""
        return 1j * np.abs(self.frequency)

    @property
    def middle(self) -> float:
        """A frequency in the midst of the readings: a power of what is relative to it leaves their sizes much alike."""
        return float(np.exp(np.mean(np.log(np.abs(self.frequency)))))

    def seen(self, factor: ComplexArray) -> ComplexArray:
        """Factors on phasors as factors on the readings as they stand."""
        conjugated = self.conjugated if factor.ndim == 1 else self.conjugated[:, None]
        return np.where(conjugated, factor.conj(), factor)

    def corrected(self, factor: ComplexArray) -> Problem:
        """The problem with readings that were given as so many times the truth."""
        whole, problem = self.seen(factor), self.problem
        columns = problem.by_block(problem.measured / whole), problem.by_block(problem.sigma / np.abs(whole))
        parts = zip(problem.responses, *columns, strict=True)
        return replace(problem, blocks=tuple(replace(block, measured=m, sigma=e) for block, m, e in parts))

    def without(self, rows: Bool) -> Problem:
        """The problem in which some readings have no weight."""
        hidden = 1e4  # factor on the noise of readings that are left out, which then have no weight
        return self.problem.with_noise(np.where(rows, hidden, 1.0))


def readings_of(problem: Problem) -> Readings | None:
    """Readings of a problem, thinned where many; None with others than a linear rotor's to turning forces."""
    blocks = linear_responses(problem.blocks)
    if len(blocks) < len(problem.blocks) or any(block.imposed or not block.frequency.all() for block in blocks):
        return None
    most_readings = 1500  # readings that show an error
    every = -(-sum(block.measured.size for block in blocks) // most_readings)
    if every > 1:
        kept, factors = [], []
        for number, block in enumerate(blocks):
            run = numbers(block.run[np.searchsorted(block.line, np.arange(block.speed.size))])
            keep = np.zeros(run.size, dtype=bool)
            keep[np.concatenate([rows[::every] for rows in rows_by(run, np.abs(block.frequency))])] = True
            kept.append(block.lines(keep))
            own = problem.factors[number] if problem.factors else None
            factors.append(None if own is None else own[keep[block.line]])
        problem, blocks = replace(problem, blocks=tuple(kept), factors=tuple(factors)), kept
    names = np.array([c.plane for c in problem.space.model.coordinates])
    forced = [names[np.abs(block.force).argmax(axis=1)][block.line] for block in blocks]
    return Readings(
        problem=problem,
        plane=np.concatenate([names[block.coordinate] for block in blocks]),
        force_plane=np.concatenate(forced),
        speed=np.concatenate([block.set_speed[block.line] for block in blocks]),
        frequency=np.concatenate([block.frequency[block.line] for block in blocks]),
        conjugated=np.concatenate([block.conjugated for block in blocks]),
    )


# ---- factors of some readings ----------------------------------------------------------------------------------------


_MOST_GROUPS, _MOST_SPEEDS = 40, 8  # groups looked at, and speeds that are few enough to be sessions


@dataclass(frozen=True, kw_only=True, eq=False)
class _Group:
    """Readings that may have a factor of their own."""

    who: str  # whose they are
    rows: Bool  # which, shape ``(R,)``
    forces: str = ""  # whose forces they are all readings of; empty where other readings are of the same forces
    other: _Group | None = None  # where there are two such groups, the other one
    unless: str = ""  # what else may make them seem so


def factors_of_groups(readings: Readings, missed: float, hint: Hint, known: Sequence[str]) -> Iterator[Explanation]:
    """Explanations of the data by factors and angles that some readings alone have."""
    seen = {np.ones(readings.problem.run.size, dtype=bool).tobytes()}
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
    expected = np.concatenate(readings.problem.predict(x))
    if not (np.isfinite(left) and np.isfinite(expected).all() and expected[group.rows].any()):
        return  # a trial without a finite result explains nothing
    power, factor, unlike = _factor(readings, group.rows, expected)
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
        others = np.unique(readings.problem.run[~one.rows]).tolist()
        if np.unique(readings.problem.run[one.rows]).size == 1 and len(others) >= fewest_other_runs:
            corrected, expected = replace(readings, problem=problem), np.concatenate(problem.predict(x))
            if not np.isfinite(expected).all():
                continue
            apart = (abs(np.log(_factor(corrected, readings.problem.run == run, expected, (0,))[1])) for run in others)
            if max(apart) >= abs(np.log(own)) / least_difference_ratio:
                continue
        yield one, replace(_explanation(one, power, own, left / missed, readings.middle), end=x)


def _levels(readings: Readings, known: Sequence[str]) -> Iterator[list[_Group]]:
    """Sets of readings, the likeliest to share an error first; of later ones none that an earlier one explains."""
    columns = (readings.problem.run, readings.speed, readings.frequency, readings.plane, readings.force_plane)
    return _groups(*columns, f", unless what was given as known ({', '.join(known)}) is wrong" if known else "")


def _groups(
    run: Text, speed: Float, w: Float, plane: Text, force_plane: Text, unless: str = ""
) -> Iterator[list[_Group]]:
    """The same of readings by their columns, shape ``(R,)`` each."""
    speeds = np.unique(speed).tolist()
    ways = [
        [(f"of run {one}", run == one) for one in np.unique(run).tolist()],
        [(f"at {v * RPM_PER_RAD_S:.6g} rpm", speed == v) for v in speeds if len(speeds) <= _MOST_SPEEDS],
        [("of forward whirl", w > 0), ("of backward whirl", w < 0)],
    ]
    planes = np.unique(plane).tolist()
    forces = [(f"under forces at {p}", force_plane == p, f"at {p}") for p in np.unique(force_plane).tolist()]
    yield [*_set(forces, unless), *_set([(f"at {p}", plane == p, "") for p in planes], unless)]
    yield [group for way in ways for group in _set([(who, rows, who) for who, rows in way])]
    if len(planes) > 1:
        for way in reversed(ways):
            yield [
                group
                for p in planes
                for group in _set([(f"{who} at {p}", rows & (plane == p), "") for who, rows in way])
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


def _explanation(group: _Group, power: int, factor: complex, left: float, middle: float) -> Explanation:
    free = 1 + abs(power)
    if power:
        code, what, undo = POWERS[power]
        size, angle = abs(factor) / middle**power, float(np.degrees(np.angle(factor)))
        name = f"{code} ({group.who}: {significant(size, 4)} at {significant(angle, 3)} degrees)"
        message = f"the readings {group.who} are {what}"
        return Explanation(left=left, code=code, message=message, undo=undo, correction=name, free=free)
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
    vector = f"{significant(size, 3)} at {significant(angle, 3)} degrees"
    return Explanation(
        left=left,
        code=codes[0],
        message=f"the readings {group.who} {' and '.join(parts)}{cause}{group.unless}",
        undo=f"divide the readings {group.who} by {vector}",
        correction=f"{codes[0]} ({group.who}: {vector})",
        free=free,
    )


# ---- corrections by a value ------------------------------------------------------------------------------------------


_NUMBER = r"[-+]?\d+(?:\.\d*)?(?:e[-+]?\d{1,2})?"
_BY_VALUE = re.compile(rf"(?P<code>[\w-]+) \((?P<who>.+): (?P<value>{_NUMBER})(?: at (?P<angle>{_NUMBER}))? [\w ]+\)")
"""Name of a correction that says its value, ``delay (all: 0.0015 s)``, ``readings-scaled (of run 3: 2 at 0 degrees)``.
"""


def corrected_by_value(
    tests: Sequence[PerturbationTest], name: str
) -> Callable[[PerturbationTest], PerturbationTest] | None:
    """The correction that a name says with its value, another one if a person changed it; None for other names and
    for readings that there are not."""
    said = _BY_VALUE.fullmatch(name)
    whose = {who for test in tests for who in _rows_of_groups(test)}
    if said is None or said["who"] not in whose:
        return None
    value, kinds = float(said["value"]), {kind.code: kind for kind in CHANNEL_FILTERS}
    if not value > 0:
        return None
    if said["angle"] is not None:
        factor = value * np.exp(1j * np.radians(float(said["angle"])))
        power = {code: power for power, (code, *_) in POWERS.items()}.get(said["code"], 0)
        return partial(_divided, who=said["who"], by=lambda s: factor * s**power)
    kind = kinds.get(said["code"])
    if kind is None:
        return None
    size = value * 2 * np.pi if kind.corner else value
    return partial(_divided, who=said["who"], by=lambda s: kind.seen(s, size))


def _rows_of_groups(test: PerturbationTest) -> dict[str, Bool]:
    columns = (test.run, test.set_speed, test.frequency, test.plane, test.force_plane)
    groups = {group.who: group.rows for level in _groups(*columns) for group in level}
    return {ALL: np.ones(len(test), dtype=bool), **groups}


def _divided(test: PerturbationTest, *, who: str, by: Callable[[ComplexArray], ComplexArray]) -> PerturbationTest:
    rows = _rows_of_groups(test).get(who, np.zeros(len(test), dtype=bool))
    seen = np.where(rows, by(1j * np.abs(test.frequency)), 1.0)
    return replace(test, response=test.response / seen, sigma=test.sigma / np.abs(seen))
