"""Weights at dwell speeds solved together: residual vectors, influences, and the scatter between mountings."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import Float, Index
from rotorfit.base.digits import significant
from rotorfit.base.equality import ByValue
from rotorfit.base.significance import SIGNIFICANT_ERRORS
from rotorfit.base.text_table import Printed, text_table
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.blocks.set_speeds import SPEED_TOLERANCE
from rotorfit.estimators.noise.sweep_noise import FEWEST_LINES
from rotorfit.estimators.starting.influence import (
    Influence,
    ModesSeen,
    Readings,
    UndeterminedError,
    modes_seen,
    solve_influence,
)
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.synchronous import DIFFERENCED, OPPOSITE_TOLERANCE, at_speeds, difference_synchronous


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Influences(ByValue, Printed):
    """Residual vectors and influences of a synchronous test at dwell speeds (:func:`influence`).

    Attributes:
        solved: the numbers, with their covariance.
        channels: plane and direction of each channel.
        planes: forced planes.
        mountings: names of the mountings.
        weight: unbalance that the rows of ``test`` are responses to, kg m, one a plane.
        measured: the readings that they come from.
        run_out: a sentence on the run-out of start-ups, which slow turning shows.
    """

    solved: Influence
    channels: tuple[tuple[str, str], ...]
    planes: tuple[str, ...]
    mountings: tuple[str, ...]
    weight: Float
    measured: PerturbationTest
    run_out: str = ""

    @cached_property
    def test(self) -> PerturbationTest:
        """The influences as a test: the response of each probe to the usual weight of each plane at 0 degrees, one row
        a cell and plane, cell by cell: the order of the covariance."""
        solved, size = self.solved, len(self.planes)
        cell = np.repeat(np.arange(solved.channel.size), size)
        plane = np.tile(np.arange(size), solved.channel.size)
        speed, weight = solved.speed[solved.dwell[cell]], self.weight[plane]
        places = [self.channels[k] for k in solved.channel[cell].tolist()]
        names = np.array(self.planes)[plane]
        return PerturbationTest(
            source=self.measured.source,
            attributes={DIFFERENCED: np.ones(cell.size)},
            run=np.array([f"weight at {name}" for name in names.tolist()]),
            speed=speed,
            frequency=speed.copy(),
            force_plane=names,
            force=(weight * speed**2).astype(complex),
            plane=np.array([at for at, _ in places]),
            direction=np.array([direction for _, direction in places]),
            response=solved.influence.reshape(-1) * weight,
            sigma=np.sqrt(np.real(np.diag(solved.working))) * weight,
        )

    @cached_property
    def modes(self) -> ModesSeen | None:
        """How many modes the influences show; None where there is one speed only."""
        return modes_seen(self.solved)

    @property
    def modes_told(self) -> str:
        """How many modes the influences show, in words; empty where there is one speed only."""
        seen = self.modes
        if seen is None:
            return ""
        values = ", ".join(significant(value, 3) for value in seen.singular)
        modes = ", ".join(
            f"{w * RPM_PER_RAD_S:.0f} +- {significant(e * RPM_PER_RAD_S, 2)} rpm" for w, e in seen.frequencies
        )
        text = f"these data see {seen.count} mode{'s' * (seen.count != 1)}"
        text += f" ({modes}; " if modes else " ("
        text += f"singular values over the largest of noise: {values})"
        if seen.shapes > seen.count:
            more = seen.shapes - seen.count
            text += f"; {more} more shape{'s' * (more > 1)} above the noise, but the speeds leave the frequency open"
        return text

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on how far mountings and repeats scatter."""
        found = []
        between, repeat = (values[np.isfinite(values)] * 1e6 for values in (self.solved.mounting, self.solved.repeat))
        if between.size:
            sentence = (
                f"mounting the weight again moves vectors by {significant(np.sqrt(np.mean(between**2)), 2)} um "
                f"({significant(between.min(), 2)} to {significant(between.max(), 2)} by channel and speed; "
                f"{len(self.mountings)} mountings, {self.solved.freedom:.0f} degrees of freedom)"
            )
            if repeat.size:
                sentence += f", repeats by {significant(np.sqrt(np.mean(repeat**2)), 2)} um"
            found.append(sentence)
        elif np.isnan(self.test.sigma).any():
            found.append(
                "no error is known: there are no more mountings than unknowns and no repeats, and no noise was given; "
                "give sigma_um, repeat the runs, or mount a weight at one angle more"
            )
        else:
            found.append(
                "there are no more mountings than unknowns: how far mounting a weight again moves vectors cannot be "
                "estimated, and error bars count repeats or given noise alone, which understates them"
            )
        if not (MOUNTING in self.measured.attributes or any(map(_REPEAT.fullmatch, self.measured.runs))):
            found.append(
                "nothing says which runs are repeats of one mounting, so each counts as a mounting of its own; name "
                f"repeats A-1, A-2 or add a column {MOUNTING}"
            )
        lacking: dict[str, list[str]] = {}  # places by what is not known of them
        for one in self.solved.partly:
            known = np.isfinite(one.combined(np.eye(1 + len(self.planes), dtype=complex))[0]).tolist()
            what = ["its level without weights", *(f"the influence of {plane}" for plane in self.planes)]
            unknown = " and ".join(name for name, there in zip(what, known, strict=True) if not there)
            lacking.setdefault(unknown, []).append(self.place(one.channel, one.dwell))
        found += [
            f"the runs that read {', '.join(places)} do not tell {unknown}; what they tell is kept"
            for unknown, places in lacking.items()
        ]
        found += [self.run_out] if self.run_out else []
        return tuple(found)

    def place(self, channel: int, dwell: int) -> str:
        """Probe and speed of a cell in words.

        Args:
            channel: its number.
            dwell: number of its speed.
        """
        return f"{' '.join(self.channels[channel])} at {self.solved.speed[dwell] * RPM_PER_RAD_S:.0f} rpm"

    def summary(self) -> str:
        """Table of residual vectors and influences with standard errors, um and um/(g mm), degrees of lead."""
        size = len(self.planes)
        errors = np.sqrt(np.real(np.diag(self.solved.covariance))).reshape(-1, size)
        scale = np.array([1e6, *[1.0] * size])  # um, and um/(g mm), which is m/(kg m)
        heads = [cell for plane in self.planes for cell in (plane, "")]
        rows = [["probe", "rpm", "residual", *heads], ["", "", "um 0-pk", *["um/(g mm)", ""] * size]]
        for cell, (channel, dwell) in enumerate(zip(self.solved.channel, self.solved.dwell, strict=True)):
            speed = self.solved.speed[dwell] * RPM_PER_RAD_S
            row = [" ".join(self.channels[channel]), f"{speed:.0f}", _polar(self.solved.residual[cell] * 1e6)]
            for value, error in zip(self.solved.influence[cell], errors[cell], strict=True):
                row += [_polar(value), f"+- {significant(error, 1)}" if np.isfinite(error) else "+- ?"]
            rows.append(row)
        for one in self.solved.partly:
            values, covariance = one.combined(np.eye(1 + size, dtype=complex))
            speed = self.solved.speed[one.dwell] * RPM_PER_RAD_S
            level, *influences = (_polar(value) if np.isfinite(value) else "not known" for value in values * scale)
            row = [" ".join(self.channels[one.channel]), f"{speed:.0f}", level]
            for said, error in zip(influences, np.sqrt(np.real(np.diag(covariance)))[1:], strict=True):
                row += [said, "" if np.isnan(error) else f"+- {significant(error, 1)}"]
            rows.append(row)
        lines = text_table(rows, "<14 >8 >18" + " >18 <8" * size)
        seen = [self.modes_told] if self.modes_told else []
        return "\n".join([*lines, *self.remarks, *seen])

    def __str__(self) -> str:
        return self.summary()


def _polar(value: complex) -> str:
    return f"{significant(abs(value), 4)} @ {np.degrees(np.angle(value)):.1f}"


def influence(test: PerturbationTest, speeds: ArrayLike | None = None) -> Influences:
    """Residual vectors and influences of a synchronous test at dwell speeds, from whatever weights it has.

    Weights at 0 and 180 degrees (eq. 20), a reference run without a weight (mass-radius product or force zero) beside
    one with, three weights at odd angles: all are solved together by least squares, repeats averaged first. Runs of one
    mounting share a random effect, whose variance is estimated by restricted maximum likelihood.

    Args:
        test: a synchronous test, not differenced, whose runs dwell at a few speeds, or start-ups with ``speeds``.
        speeds: where start-ups are read, rad/s; noise that was not given is estimated from their smoothness.

    Raises:
        ValueError: the test is no such test, a run was not sampled about one of the speeds, or its weights do not
            determine an influence.

    Example:
        >>> weighed = rf.influence(rf.read(rf.datasets.path("rk4_sync.csv")))
        >>> weighed.planes
        ('disk1', 'disk2')
    """
    name = test.source or "the test"
    if not test.synchronous:
        raise ValueError(f"{name} is not synchronous: influences need runs with frequency = speed on all rows")
    run_out = ""
    if speeds is not None:
        chosen = np.atleast_1d(np.asarray(speeds, dtype=float))
        run_out = _run_out(test, float(chosen.min()))
        test = at_speeds(test, chosen)
    if not dwells(test):
        raise ValueError(
            f"{name} has runs over many speeds (start-ups): choose some (speeds=, --speeds RPM,RPM), or fit the "
            "differences of two runs at a speed"
        )
    readings, channels, planes, mountings = _readings(test)
    try:
        solved = solve_influence(readings)
    except UndeterminedError as reason:
        raise UndeterminedError(f"{name}: {reason}") from reason
    return Influences(
        solved=solved,
        channels=channels,
        planes=planes,
        mountings=mountings,
        weight=np.array([np.median(np.abs(column[column != 0])) for column in readings.unbalance.T]),
        measured=test,
        run_out=run_out,
    )


def _run_out(test: PerturbationTest, least_speed: float) -> str:
    """What slow turning shows in start-ups that are read at so high speeds: run-out, or that it is taken out."""
    slow_share = 0.25  # of a speed at which an unbalance moves a rotor 16 times less than there, or less still
    beside = 1.5  # times the slowest speed up to which readings are averaged
    slowest = float(test.speed.min())
    if slowest > slow_share * least_speed:
        return (
            f"run-out (slow roll) stays in: no reading is as slow as {slow_share * least_speed * RPM_PER_RAD_S:.0f} "
            "rpm, which would show it; record start-ups from a slow speed on"
        )
    part = test.select(test.speed <= min(beside * slowest, slow_share * least_speed))
    first, number = part.alike("plane", "direction")
    mean = np.array([part.response[number == k].mean() for k in range(first.size)])
    scatter = [np.sqrt(np.mean(np.abs(part.response[number == k] - mean[k]) ** 2)) for k in range(first.size)]
    largest = int(np.argmax(np.abs(mean)))
    error = scatter[largest] / np.sqrt(np.sum(number == largest))
    probe = f"{part.plane[first[largest]]} {part.direction[first[largest]]}"
    size = f"{significant(abs(mean[largest]) * 1e6, 2)} um"
    low, high = (f"{end * RPM_PER_RAD_S:.0f}" for end in (part.speed.min(), part.speed.max()))
    fast = np.abs(test.response[test.speed >= least_speed]).max()
    of_unbalance = fast * (part.speed.max() / least_speed) ** 2  # which moves a stiff rotor by as much at most
    if abs(mean[largest]) <= max(SIGNIFICANT_ERRORS * error, of_unbalance):
        return f"run-out is taken out, or small: at {low} to {high} rpm the probes read no more than an unbalance makes"
    limit = 10 * int(np.ceil(part.speed.max() * RPM_PER_RAD_S / 10))
    return (
        f"run-out (slow roll) stays in: at {low} to {high} rpm {probe} reads {size}, which no weight takes out; "
        f"subtract it (slow_roll_below_rpm={limit}, --slow-roll-below {limit})"
    )


def difference_unless_solved(test: PerturbationTest) -> PerturbationTest:
    """A synchronous test with its runs differenced (eq. 20), unless they say more when solved together. Runs that dwell
    at a few speeds are left alone where some would stay without a partner, or where a mounting was repeated:
    :func:`influence` uses them all."""
    paired = difference_synchronous(test)
    if not dwells(test) or (test.speed <= 0).any():
        return paired
    if (test.force == 0).any():  # a reference run that several share makes their differences err together
        return test
    whole = DIFFERENCED in paired.attributes and bool((paired.attributes[DIFFERENCED] == 1).all())
    return paired if whole and len(set(mountings(test))) == len(test.runs) else test


def solved_together(experiment: Experiment) -> Influences | None:
    """Influences of weights at dwell speeds, also where their noise is not known; None where none are to be solved."""
    test = experiment.perturbation
    if test is None or not test.synchronous or DIFFERENCED in test.attributes:
        return None
    finite = np.isfinite(test.response).all() and np.isfinite(test.force).all()
    if not dwells(test) or not finite or not (test.speed > 0).all():
        return None
    try:
        return influence(test)
    except UndeterminedError:
        # Single runs can be fitted as they are where their noise is given, or they are long enough to tell it; a check
        # says what the readings contain.
        if np.isfinite(test.sigma).all() or np.unique(dwell_number(test.speed)).size >= FEWEST_LINES:
            return None
        raise


def weighed(experiment: Experiment) -> Influences | None:
    """Influences of an experiment that has to be solved for them before it can be fitted, None of all others."""
    found = solved_together(experiment)
    if found is not None and np.isnan(found.test.sigma).any():
        raise ValueError(
            f"{found.test.source or 'the test'}: neither repeats nor more mountings than unknowns determine the noise "
            "of the readings; give a column sigma_um, repeat the runs (A-1, A-2), or mount the weight at one more angle"
        )
    return found


def _readings(test: PerturbationTest) -> tuple[Readings, tuple[tuple[str, str], ...], tuple[str, ...], tuple[str, ...]]:
    forces = test.forces_by_plane
    acting = np.flatnonzero(forces.any(axis=0))
    planes = tuple(test.force_planes[k] for k in acting.tolist())
    if not planes:
        raise ValueError(f"{test.source or 'the test'}: every run is without a weight; an influence needs one with")
    pairs = list(zip(test.plane.tolist(), test.direction.tolist(), strict=True))
    channels = tuple(dict.fromkeys(pairs))
    names = mountings(test)
    order = tuple(dict.fromkeys(names))
    mounting = np.array([order.index(name) for name in names], dtype=np.intp)
    count = np.bincount(mounting, minlength=len(order))[:, None]
    unbalance = np.zeros((len(order), len(planes)), dtype=complex)
    np.add.at(unbalance, mounting, forces[:, acting] / test.speed[:, None] ** 2)
    unbalance /= count
    readings = Readings(
        value=test.response,
        speed=test.speed,
        mounting=mounting,
        channel=np.array([channels.index(pair) for pair in pairs], dtype=np.intp),
        dwell=dwell_number(test.speed),
        unbalance=unbalance,
        sigma=test.sigma,
    )
    return readings, channels, planes, order


MOUNTING = "mounting"
"""Column, and attribute, that names the mounting of each row."""

MOST_DWELLS = 8
"""Speeds of a run up to which it dwelt at them; more are a start-up, which is differenced sample by sample."""

_REPEAT = re.compile(r"(.+)-\d+")


def dwells(test: Experiment) -> bool:
    """True if every run of a test has at most :data:`MOST_DWELLS` speeds."""
    number = dwell_number(test.speed)
    return all(np.unique(number[test.run == run]).size <= MOST_DWELLS for run in test.runs)


def dwell_number(speed: Float) -> Index:
    """Number of the dwell speed of each reading: neighbours within the tolerance of constant speeds are one."""
    values, inverse = np.unique(speed, return_inverse=True)
    steps = np.diff(values) > SPEED_TOLERANCE * values[1:]
    return np.asarray(np.concatenate([[0], np.cumsum(steps)])[inverse.reshape(-1)], dtype=np.intp)


def mountings(test: PerturbationTest) -> list[str]:
    """Name of the mounting of each row: the column, else the name of the run without the number of the repeat: the
    weight of ``A005-1`` and ``A005-2`` stayed where it was, another run is a mounting of its own. Runs whose weights
    differ are never one mounting, whatever their names."""
    given = MOUNTING in test.attributes
    if given:
        names = [str(value) for value in test.attributes[MOUNTING].tolist()]
    else:
        found = [(run, _REPEAT.fullmatch(run)) for run in test.run.tolist()]
        names = [run if match is None else match[1] for run, match in found]
    weights = test.forces_by_plane / test.speed[:, None] ** 2
    result: list[str] = []
    seen: dict[str, list[tuple[str, list[complex]]]] = {}
    for name, plane, own in zip(names, test.force_plane.tolist(), weights.tolist(), strict=True):
        kinds = seen.setdefault(name, [])
        place = next((i for i, (at, v) in enumerate(kinds) if at == plane and all(map(_same, own, v))), len(kinds))
        if place == len(kinds):
            kinds.append((plane, own))
        if place and given:
            raise ValueError(
                f"{test.source or 'the test'}: mounting {name} has different weights; a weight that was moved is "
                "another mounting"
            )
        result.append(name if not place else f"{name} ({place + 1})")
    return result


def _same(u: complex, v: complex) -> bool:
    if u == 0 or v == 0:
        return u == v
    turned = abs(float(np.angle(u / v)))
    same_weight = 0.02  # relative difference of mass-radius products that are one weight, written down twice
    return abs(abs(u) - abs(v)) <= same_weight * abs(v) and turned <= OPPOSITE_TOLERANCE
