"""Measured responses in a model's coordinates: the plain data that estimators work on."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, Self

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index, Text
from rotorfit.estimators.blocks.response import (
    displacement_to_force,
    displacement_to_force_jacobian,
    respond,
    respond_jacobian,
)
from rotorfit.estimators.blocks.row_keys import combined, numbers, occurrence, rows_by
from rotorfit.estimators.blocks.set_speeds import set_speeds
from rotorfit.models import RotorModel
from rotorfit.models.motion.neglected_terms import LeftOut


class Asked(Protocol):
    """What every kind of block is asked, with the plain answers: a kind overrides what is its own."""

    @property
    def responses(self) -> Responses | None:
        """The responses to forces, circular or constant, that the block holds."""
        return None

    @property
    def linear(self) -> Responses | None:
        """The responses of a linear rotor that its predictions are."""
        return None

    @property
    def circular(self) -> Responses | None:
        """The responses to circular forces, of a linear rotor or in centred orbits, that its predictions are."""
        return self.linear

    def values(self, theta: Float) -> Float:
        """Parameter vectors of the groups of :attr:`linear`."""
        return theta

    @property
    def by_causes(self) -> ComplexArray | float:
        """Factor of each reading by what a model does not hold, shape ``(R,)``."""
        return 1.0

    @property
    def corner(self) -> float:
        """Corner of the high-pass that is in :attr:`by_causes`, rad/s."""
        return 0.0

    def by_values(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """Predictions, and their derivatives by the values of each reading's own group, shape ``(R, P)``."""
        return self.predict_jacobian(theta)  # type: ignore[attr-defined,no-any-return]

    def seen_by_probes(self, motion: ComplexArray) -> ComplexArray:
        """What probes without a factor read of a motion of all coordinates of :attr:`circular`, shape ``(L, n)``."""
        base = self.circular
        return np.zeros(0, dtype=complex) if base is None else motion[base.line, base.coordinate]

    def motion(self, theta: Float) -> ComplexArray:
        """Motion of all coordinates of :attr:`circular`, shape ``(L, n)``; nothing of blocks that are linear."""
        return np.zeros((0, 0), dtype=complex)

    def pushed(self, theta: Float, force: ComplexArray) -> ComplexArray:
        """Change of :meth:`motion` by small forces beside those of the test, shape ``(L, n)`` as these."""
        return np.zeros_like(force)

    @property
    def speed_read(self) -> Float | None:
        """Rotative speed of each reading of free vibration, rad/s, shape ``(R,)``; None for other blocks."""
        return None

    def shifted(self, theta: Float, term: Callable[[RotorModel, Float, float], LeftOut | None]) -> ComplexArray:
        """Change of readings of free vibration by a unit of what adds to the equation of motion, shape ``(R,)``.

        Args:
            theta: parameter vectors, shape ``(G, P)``.
            term: what is added, of the model, the vector of a group and a frequency of whirl, rad/s.
        """
        return np.zeros(self.measured.size, dtype=complex)  # type: ignore[attr-defined, arg-type]

    @property
    def apart(self) -> Block | None:
        """The same with each (group, speed) a group of its own; None for blocks whose values causes do not change."""
        return None

    def at_speeds(self, factor: float) -> Block:
        """The same with speeds so many times as fast."""
        return self  # type: ignore[return-value]

    def stiffened(self, stiffness: ComplexArray) -> Block:
        """The same with a dynamic stiffness beside the rotor's, shape ``(L, n, n)``, where it moves in orbits."""
        return self  # type: ignore[return-value]

    def lines(self, keep: Bool) -> Block | None:
        """The observations of some lines, None where they are not made line by line."""
        return None

    @property
    def by_turning_phase(self) -> ComplexArray | None:
        """Derivative of the logarithm of each reading by a lead of what probes gave; None where no force turns."""
        base = self.responses
        return base.by_phase if base is not None and base.frequency.any() else None

    @property
    def uncorrelated(self) -> Block:
        """The same readings as if their errors had nothing in common."""
        return self  # type: ignore[return-value]

    @property
    def without_force_errors(self) -> Block:
        """The same without what measured forces and a dry run make their errors have in common."""
        return self  # type: ignore[return-value]

    def from_rest(self, *, one_sweep: bool = False) -> Block:
        """The same with orbits followed from rest, where readings choose among them.

        Args:
            one_sweep: whether all lines are of one sweep.
        """
        return self  # type: ignore[return-value]

    @property
    def of_motion(self) -> bool:
        """True if readings are of motion or force, so that their noise may grow with them."""
        return True

    @property
    def centred(self) -> bool:
        """True if orbits are about the centre of the clearance."""
        return True

    @property
    def over_clearance(self) -> bool:
        """True if readings of the journal are divided by the clearance."""
        return False

    @property
    def shows_eccentricity(self) -> bool:
        """True if it shows how a rotor changes with the eccentricity of its journal."""
        return False

    @property
    def tells_sense(self) -> bool:
        """True if they tell in which sense the shaft turns."""
        return True

    @property
    def reads_twist(self) -> bool:
        """True if the twist of a shaft is among them."""
        return False

    @property
    def shaft_lines(self) -> frozenset[str]:
        """Names of spectral lines of a shaft that is not round and may twist."""
        return frozenset()

    @property
    def forced_lines(self) -> bool:
        """True if spectral lines under a force are among them."""
        return False

    def cut_off(self, theta: Float) -> Float:
        """Change by lines that the model leaves out, m, shape ``(R,)``."""
        return np.zeros(1)

    def weighing_error(self, rows: ComplexArray, covar: Float) -> Float:
        """Scatter of the cost's gradient by errors of its weights, shape ``(p, p)``.

        Args:
            rows: whitened derivatives of its readings by the fitted vector, shape ``(R, p)``.
            covar: covariance of that vector.
        """
        return np.zeros_like(covar)

    @property
    def frozen(self) -> Block:
        """The same without branches and jumps, where eccentricities were measured: a good place to start a fit from."""
        return self  # type: ignore[return-value]

    @property
    def freedom(self) -> float:
        """Degrees of freedom from which its noise is known; infinite where it was given or sampled well."""
        return math.inf

    @property
    def independent(self) -> bool:
        """True if the errors of its readings have nothing in common."""
        return True

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on where its errors come from."""
        return ()

    def unmixed(self, scaled: ComplexArray) -> ComplexArray:
        """Misses over their noise, shape ``(..., R)``, free of what they have in common."""
        return scaled

    def weighed(self, predicted: ComplexArray) -> Block:
        """The same with the noise that readings have where predictions, shape ``(..., R)``, are right.

        Args:
            predicted: what is predicted for them.
        """
        return self  # type: ignore[return-value]

    @property
    def rougher(self) -> Block:
        """The block with as many readings as tell where a search may begin."""
        return self  # type: ignore[return-value]

    @property
    def force_spectra(self) -> tuple[str, ...]:
        """Names of what the spectrum of a force that was not measured may be: the one that is taken, then others, the
        freest first."""
        return ()

    def with_force_spectrum(self, name: str) -> Block:
        """The same with another spectrum of such a force.

        Args:
            name: of it; none leaves the block as it is.
        """
        return self  # type: ignore[return-value]

    @property
    def own_unknowns(self) -> int:
        """Numbers that are fitted inside for every parameter vector."""
        return 0

    @property
    def own_believable(self) -> bool:
        """False where one of these numbers came out as it cannot be."""
        return True

    def doubts(self, theta: Float, predicted: ComplexArray) -> Iterator[tuple[str, str]]:
        """What its readings show that its model does not hold: codes and sentences.

        Args:
            theta: parameters of each group.
            predicted: of the best fit.
        """
        return iter(())

    @property
    def normal(self) -> bool:
        """True if the errors of its readings are normal: the squares of residuals are their likelihood."""
        return True

    def losses(self, residuals: ComplexArray) -> Float:
        """Twice what whitened residuals of shape ``(..., R)`` add to minus the logarithm of the likelihood.

        Args:
            residuals: weighed by predictions, see :meth:`weighed`.
        """
        return residuals.real**2 + residuals.imag**2

    def scattered(self, rows: ComplexArray) -> ComplexArray:
        """Covariance of the whitened residuals times rows of whitened derivatives, shape ``(R, p)``."""
        return rows

    def drawn(self, noise: ComplexArray) -> ComplexArray:
        """Noise over sigma from independent numbers, shape ``(..., R)``."""
        return noise

    def split(self, readings: int) -> Sequence[Block]:
        """The same observations in pieces of about so many readings, where they can be taken apart."""
        return [self]  # type: ignore[list-item]

    def at_set_speed(self) -> Block:
        """The observations as if the speed had not wandered, for what holds for every set speed alike."""
        return self  # type: ignore[return-value]

    def as_if_round(self, rotor: RotorModel) -> Responses | None:
        """The motion at w alone, of a rotor that is taken for round, None where it was not read.

        Args:
            rotor: the model without what turns with it.
        """
        return None

    def at_small_orbits(self, limit: float) -> Responses | None:
        """Responses at eccentricities up to a limit, or, where there are too few, those of the smaller half."""
        return None

    def measured_eccentricity(self, theta: Float) -> Float:
        """Eccentricity of the journal as its probe read it, the factor of the probe taken out; empty where none did."""
        return np.zeros(0)

    def in_clearance(self, factor: float) -> Block:
        """The same in a bearing of another clearance, positions in metres kept."""
        return self  # type: ignore[return-value]


class Block(Asked, Protocol):
    """Complex observations that depend on the parameter vectors of some groups; ``theta`` has shape ``(..., G, P)``."""

    @property
    def measured(self) -> ComplexArray:
        """Complex observations."""

    @property
    def sigma(self) -> Float:
        """Their noise."""

    @property
    def label(self) -> Index:
        """Response of each."""

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the responses."""

    @property
    def run(self) -> Text:
        """Run of each."""

    @property
    def reading_group(self) -> Index:
        """Group of each observation, shape ``(R,)``."""

    def predict(self, theta: Float) -> ComplexArray:
        """Predictions, shape ``(..., R)``."""

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """Predictions and their derivatives by the group's own parameters, shapes ``(..., R)`` and ``(..., R, P)``."""

    def with_noise(self, factor: Float) -> Self:
        """The same observations with each sigma multiplied by a factor, shape ``(R,)``."""

    def with_measured(self, measured: ComplexArray) -> Self:
        """The same observations with other readings, shape ``(R,)``."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Observed(Asked):
    """Columns of readings that every kind of test has, shape ``(R,)``."""

    model: RotorModel  # the rotor whose coordinates these are
    measured: ComplexArray
    sigma: Float
    label: Index
    labels: tuple[str, ...]  # names of the responses
    run: Text

    def with_noise(self, factor: Float) -> Self:
        """See :meth:`Block.with_noise`; what was worked out of the layout, which does not change, goes along."""
        found = copy(self)
        object.__setattr__(found, "sigma", self.sigma * factor)
        return found

    def with_measured(self, measured: ComplexArray) -> Self:
        """See :meth:`Block.with_measured`; what was worked out of the layout goes along here too."""
        found = copy(self)
        object.__setattr__(found, "measured", measured)
        return found


@dataclass(frozen=True, eq=False, kw_only=True)
class Responses(Observed):
    """Responses to circular forces, or forces under imposed orbits, one line a run at one frequency."""

    speed: Float  # rotative speed of each line, rad/s, shape ``(L,)``
    frequency: Float  # of each line, rad/s, shape ``(L,)``
    force: ComplexArray  # generalised force, shape ``(L, n)``; with ``imposed``, the imposed displacement instead
    group: Index  # parameter group of each line, shape ``(L,)``
    line: Index  # line of each reading, shape ``(R,)``, ascending
    coordinate: Index  # coordinate of each reading, shape ``(R,)``
    imposed: bool = False  # the displacement is imposed and ``measured`` is the force
    sigma_given: bool = True  # sigma was given with all readings, not estimated from them
    beside: ComplexArray | None = None  # known dynamic stiffness that acts beside the model's, shape ``(L, n, n)``
    beside_read: bool = False  # whether the probes of the readings measured it
    force_noise: ComplexArray | None = None  # covariance of each line's forces, of either part, shape ``(L, n, n)``
    derivative: Index | None = None  # how often each reading's sensor differentiated the motion; None is not at all

    @property
    def responses(self) -> Responses:
        """See :class:`Asked`."""
        return self

    @property
    def linear(self) -> Responses:
        """See :class:`Asked`."""
        return self

    @property
    def reading_group(self) -> Index:
        """Group of each reading."""
        return self.group[self.line]

    @property
    def rate(self) -> Float:
        """Size of what the sensor of each reading gives over that of the motion, ``|w|**derivative``."""
        w = np.abs(self.frequency[self.line])
        return np.ones(w.size) if self.derivative is None else w**self.derivative

    @property
    def conjugated(self) -> Bool:
        """Where a reading is the conjugate of what probes gave: backward, with x and y as one complex coordinate."""
        return (self.frequency[self.line] < 0) & (self.model.frame == "z")

    @cached_property
    def receptances(self) -> dict[bytes, ComplexArray]:
        """Receptance of every line at the parameter vectors that were asked for last: much is asked at an optimum."""
        return {}

    @cached_property
    def by_phase(self) -> ComplexArray:
        """Derivative of the logarithm of each reading by a lead of what probes gave."""
        return np.where(self.conjugated, -1j, 1j)

    def at_speeds(self, factor: float) -> Responses:
        """See :class:`Asked`."""
        return replace(self, speed=self.speed * factor)

    @cached_property
    def condition(self) -> tuple[Index, Index, Float]:
        """Distinct (group, speed) pairs: the pair of each line, then group and speed of each pair."""
        speed = self.speed if self.model.speed_dependent else np.zeros_like(self.speed)
        # As complex numbers, which sort by the real part first: far quicker than rows of a table.
        pairs, index = np.unique(self.group + 1j * speed, return_inverse=True)
        return index.reshape(-1), pairs.real.astype(np.intp), pairs.imag.copy()

    @cached_property
    def channels(self) -> list[tuple[int, int, Index]]:
        """Coordinate, group and readings of each pair of these that was read."""
        key = combined(self.coordinate, self.reading_group)
        return [(int(self.coordinate[own[0]]), int(self.reading_group[own[0]]), own) for own in rows_by(key)]

    @cached_property
    def set_speed(self) -> Float:
        """Speed that the rotor was set to on each line, about which ``speed`` may wander, rad/s, shape ``(L,)``."""
        run = np.zeros(self.speed.size, dtype=np.intp)
        run[self.line] = numbers(self.run)
        return set_speeds(self.speed, self.frequency, run)

    def at_set_speed(self) -> Responses:
        """The observations as if the speed had not wandered, for what holds for every set speed alike."""
        return self if np.array_equal(self.set_speed, self.speed) else replace(self, speed=self.set_speed)

    @cached_property
    def s(self) -> ComplexArray:
        """The variable j w of each line, |w| in models with x and y apart."""
        return np.asarray(1j * (self.frequency if self.model.frame == "z" else np.abs(self.frequency)))

    @cached_property
    def s_read(self) -> ComplexArray:
        """The same of each reading."""
        return self.s[self.line]

    @cached_property
    def read_at(self) -> dict[str, Bool]:
        """Which readings are of each plane."""
        planes = np.array([c.plane for c in self.model.coordinates])[self.coordinate]
        return {plane: planes == plane for plane in self.model.read_planes}

    @cached_property
    def s_powers(self) -> ComplexArray:
        """Powers of s from zero to the model's order at each reading, shape ``(order + 1, R)``."""
        return np.asarray(self.s[self.line] ** np.arange(self.model.order + 1)[:, None])

    @cached_property
    def place(self) -> Index:
        """Place of each reading among all coordinates in all lines, coordinate by coordinate, shape ``(R,)``."""
        return self.coordinate * self.speed.size + self.line

    @cached_property
    def turned_powers(self) -> ComplexArray:
        """:attr:`s_powers` times j."""
        return 1j * self.s_powers

    @cached_property
    def condition_readings(self) -> list[Index]:
        """Readings of each distinct (group, speed) pair."""
        return rows_by(self.condition[0][self.line])

    @cached_property
    def conditions_alike(self) -> list[tuple[Index, Index]]:
        """Distinct (group, speed) pairs with as many readings each, and these, shape ``(C,)`` and ``(C, m)``."""
        sizes = np.array([readings.size for readings in self.condition_readings])
        alike = [np.flatnonzero(sizes == size) for size in np.unique(sizes)]
        return [(some, np.stack([self.condition_readings[number] for number in some.tolist()])) for some in alike]

    @cached_property
    def stretch(self) -> int:
        """Readings of each distinct pair, where the pairs follow one another with as many each; else zero."""
        number, pairs = self.condition[0][self.line], self.condition[1].size
        size = number.size // pairs
        return size if np.array_equal(number, np.repeat(np.arange(pairs), size)) else 0

    def at_small_orbits(self, limit: float) -> Responses:
        """See :class:`Asked`."""
        return self

    def split(self, readings: int) -> list[Responses]:
        """The same observations in pieces of whole lines."""
        if self.measured.size <= readings:
            return [self]
        first = np.searchsorted(self.line, np.arange(self.speed.size + 1))
        pieces, begin = [], 0
        while begin < self.speed.size:
            fitting = int(np.searchsorted(first, first[begin] + readings, side="right")) - 1
            end = min(max(fitting, begin + 1), self.speed.size)
            pieces.append(self._part(slice(begin, end), slice(first[begin], first[end])))
            begin = end
        return pieces

    def lines(self, keep: Bool) -> Responses:
        """The observations of some lines."""
        return self._part(keep, keep[self.line])

    def _part(self, lines: Bool | slice, readings: Bool | slice) -> Responses:
        """Some lines and all of their readings."""
        of_lines = ("speed", "frequency", "force", "group", "beside", "force_noise")
        of_readings = ("coordinate", "measured", "sigma", "label", "run", "derivative")
        some = [*((name, lines) for name in of_lines), *((name, readings) for name in of_readings)]
        columns = {name: values[part] for name, part in some if (values := getattr(self, name)) is not None}
        line = np.searchsorted(np.arange(self.speed.size)[lines], self.line[readings])
        return replace(self, **columns, line=line)

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`Block.predict`."""
        return (displacement_to_force if self.imposed else respond)(self, theta)

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`Block.predict_jacobian`."""
        predicted, rows = (displacement_to_force_jacobian if self.imposed else respond_jacobian)(self, theta)
        return predicted, np.swapaxes(rows, -1, -2)

    def amplitudes(self) -> tuple[ComplexArray, Float]:
        """Measured amplitude and sigma of every coordinate in every line, shape ``(L, n)``, NaN where there is none."""
        shape = (self.speed.size, len(self.model.coordinates))
        amplitude, sigma = np.full(shape, np.nan, dtype=complex), np.full(shape, np.nan)
        amplitude[self.line, self.coordinate] = self.measured
        sigma[self.line, self.coordinate] = self.sigma
        return amplitude, sigma


@dataclass(frozen=True, eq=False)
class OnResponses(Asked):
    """Observations that are responses seen in another way: their labels, runs and noise are those of the responses."""

    base: Responses  # the readings as of a linear rotor

    @property
    def responses(self) -> Responses | None:
        """See :class:`Asked`."""
        return self.base

    @property
    def model(self) -> RotorModel:
        """The rotor."""
        return self.base.model

    @property
    def measured(self) -> ComplexArray:
        """See :class:`Block`."""
        return self.base.measured

    @property
    def sigma(self) -> Float:
        """See :class:`Block`."""
        return self.base.sigma

    @property
    def label(self) -> Index:
        """See :class:`Block`."""
        return self.base.label

    @property
    def labels(self) -> tuple[str, ...]:
        """See :class:`Block`."""
        return self.base.labels

    @property
    def run(self) -> Text:
        """See :class:`Block`."""
        return self.base.run

    @property
    def reading_group(self) -> Index:
        """See :class:`Block`."""
        return self.base.reading_group

    def with_noise(self, factor: Float) -> Self:
        """See :meth:`Block.with_noise`."""
        return self.on(self.base.with_noise(factor))

    def with_measured(self, measured: ComplexArray) -> Self:
        """See :meth:`Block.with_measured`."""
        return self.on(self.base.with_measured(measured))

    def on(self, base: Responses) -> Self:
        """The same seen of other readings of the same layout."""
        return replace(self, base=base)


def linear_responses(blocks: Iterable[Block]) -> list[Responses]:
    """The blocks that are responses of a linear rotor and nothing else."""
    return [block for block in blocks if isinstance(block, Responses)]


def force_plane(block: Responses) -> Index:
    """Coordinate that the force of each reading acts at, shape ``(R,)``; of several at once that of the most in its
    run, whose other one may be the greater where the rig resonates."""
    size = np.abs(block.force)
    plane = np.asarray(np.argmax(size, axis=1))[block.line]
    several = (np.count_nonzero(size, axis=1) > 1)[block.line]
    if not several.any():
        return plane
    run = numbers(block.run)
    total = np.zeros((int(run.max()) + 1, size.shape[1]))
    np.add.at(total, run[several], size[block.line[several]])
    return np.where(several, np.argmax(total, axis=1)[run], plane)


def acts_alone(block: Responses) -> Bool:
    """True if the force of a line acts at one plane, shape ``(L,)``."""
    planes = [coordinate.plane for coordinate in block.model.coordinates]
    forced = [block.force[:, [p == plane for p in planes]].any(axis=1) for plane in dict.fromkeys(planes)]
    return np.asarray(np.sum(forced, axis=0) == 1)


def read_at_the_force(block: Responses) -> Bool:
    """Readings at the coordinate of a force that acts alone, shape ``(R,)``."""
    return np.asarray((block.coordinate == force_plane(block)) & acts_alone(block)[block.line])


def sweeps_of(block: Responses, *, synchronous: bool = False) -> list[Index]:
    """Readings of each sweep by frequency; another level of force at the same frequencies is another sweep."""
    w = block.frequency[block.line]
    place = block.speed[block.line] if synchronous else w
    speed = np.zeros_like(block.speed) if synchronous else np.round(block.set_speed, 6)
    at = np.unique(speed, return_inverse=True)[1].reshape(-1)[block.line]
    key = combined(block.label, at, (w < 0).astype(np.intp), force_plane(block))
    return rows_by(combined(key, occurrence(combined(key, numbers(np.round(place, 9))))), w)
