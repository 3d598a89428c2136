"""Responses to forces as plain arrays in SI units. Readers make them, estimators see what is derived from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.accessors import Accessor
from rotorfit.base.array_types import Bool, ComplexArray, Float, Index, Records, Text
from rotorfit.base.digits import counted
from rotorfit.base.units import UNITS
from rotorfit.estimators.blocks.row_keys import combined, in_order, occurrence
from rotorfit.estimators.blocks.set_speeds import once_per_turn
from rotorfit.lab.data.rows import PLACEHOLDER, Experiment
from rotorfit.lab.data.table_columns import FORCED, Layout, in_units_of

if TYPE_CHECKING:
    from rotorfit.estimators.blocks.observations import Block
    from rotorfit.models import RotorModel

DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")
"""x, y: one probe, phasor relative to exp(+j|w|t); z: complex amplitude relative to exp(jwt) with w signed.
rx, ry, rz: the same for the slopes dx/ds, dy/ds of the shaft."""

FORCE_DIRECTIONS = ("circular", "x", "y")
"""A force that turns with the sign of the frequency (eq. 2), or one along an axis that does not turn."""


DERIVATIVES = ("displacement", "velocity", "acceleration")
"""Quantities that sensors measure, in the order of the derivatives of the displacement."""

_LINE = ("run", "set_speed", "frequency", "force_plane", "force", "force_direction", "further_forces")

FORCE_SIGMA = "force_sigma_N"
"""Attribute: standard deviation of the real part and of the imaginary part of each measured force, N."""

MEASURED = "measured_quantity"
"""Attribute that says which of :data:`DERIVATIVES` a reading was before it became a displacement."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PerturbationTest(Experiment):
    """Responses to a rotating force: one row is one probe reading in one run at one frequency.

    Attributes:
        run: name of the run, shape ``(R,)`` like all that follow.
        speed: rotative speed Omega when the row was measured, rad/s.
        frequency: perturbation frequency w, rad/s; negative is backward whirl.
        force_plane: plane of the force.
        force: ``F exp(j delta)`` of eq. (2), N: the phasor of Fx relative to exp(+j|w|t), beside readings z too. A
            force that points at an angle a from x towards y at t = 0 has delta = a forward and delta = -a backward.
            Along an axis, the phasor of that component.
        force_direction: one of :data:`FORCE_DIRECTIONS`; left out, every force is circular. Readings x and y under a
            force along an axis have positive frequencies.
        further_forces: forces that act at once with ``force``: for each row a tuple of (plane, N, direction), of which
            the direction is ``circular`` where ``force`` turns, else ``x`` or ``y``; empty where ``force`` acts alone.
            Left out, no row has any.
        plane: plane of the probe.
        direction: one of :data:`DIRECTIONS`.
        response: phasor, m (rad for slopes), 0-peak, phase lead.
        sigma: standard deviation of the real part and of the imaginary part of the reading's noise, NaN if unknown.
        attributes: further columns by name.
        speed_tolerance: fraction within which speeds go by one name, ``speed_rpm``; a model has them as they are.
        source: where the data came from, for messages.
    """

    title: ClassVar[str] = "perturbation test"
    layout: ClassVar[Layout] = Layout(columns=FORCED)
    reads: ClassVar[Literal["motion", "force", ""]] = "motion"

    frequency: Float
    force_plane: Text
    force: ComplexArray
    plane: Text
    direction: Text
    response: ComplexArray
    sigma: Float
    force_direction: Text = field(default_factory=lambda: np.array([], dtype=str))
    further_forces: Records = field(default_factory=lambda: np.array([], dtype=object))

    plot = Accessor()

    def __post_init__(self) -> None:
        if not self.force_direction.size:
            object.__setattr__(self, "force_direction", np.broadcast_to("circular", len(self.run)))
        if not self.further_forces.size:
            object.__setattr__(self, "further_forces", none_further(len(self.run)))
        super().__post_init__()
        for name, allowed in (("direction", DIRECTIONS), ("force_direction", FORCE_DIRECTIONS)):
            unknown = sorted(set(self.category(name).names) - set(allowed))
            if unknown:
                raise ValueError(
                    f"{self.source or 'the test'}: {name} {unknown} unknown; allowed: {', '.join(allowed)}"
                )
        bad = self.linear & (self.frequency < 0)
        if bad.any():
            bad &= ~np.char.endswith(self.direction, "z")
        if bad.any():
            raise ValueError(
                f"{self.source or 'the test'}: {counted(bad.sum(), 'reading')} with a negative frequency under a force "
                f"along {self.force_direction[bad][0]} (row {np.flatnonzero(bad)[0] + 1}); a force that does not turn "
                "has positive ones"
            )

    def observe(self, model: RotorModel, group: Index) -> Block:
        """See any experiment."""
        from rotorfit.lab.observing.forced import forced_responses  # late: it is written for this class

        return forced_responses(model, self, group)

    @property
    def perturbation(self) -> PerturbationTest:
        """See any experiment."""
        return self

    def corrected(self, correct: Callable[[PerturbationTest], PerturbationTest]) -> PerturbationTest:
        """See any experiment."""
        return correct(self)

    def forced_at(self, plane: str) -> Bool:
        """See any experiment."""
        return np.array([any(plane == at for at, *_ in more) for more in self.further_forces.tolist()], dtype=bool)

    @property
    def drives_both_ways(self) -> bool:
        """See any experiment."""
        return bool(self.linear.any())

    @property
    def line_of_rows(self) -> Index:
        """See any experiment."""
        return self.lines_apart[1]

    def table_columns(self) -> dict[str, NDArray[Any]]:
        """See any experiment: of several forces the first."""
        found = super().table_columns()
        if self.linear.any():
            found["force_direction"] = self.force_direction
        noise = {"sigma": self.sigma} if np.isfinite(self.sigma).any() else {}
        found |= in_units_of(self.direction, {"amplitude": np.abs(self.response), **noise})
        return found | {"phase_deg": np.degrees(np.angle(self.response))}

    def unread(self, sigma: Float) -> PerturbationTest:
        """See any experiment."""
        return replace(self, response=np.full(len(self), PLACEHOLDER), sigma=sigma)

    def stored_rows(self) -> PerturbationTest:
        """See any experiment: with a row for each force of a reading."""
        from rotorfit.lab.data.several_forces import written_per_force  # late: it knows this class

        return written_per_force(self)

    def from_stored_rows(self) -> PerturbationTest:
        """See any experiment."""
        from rotorfit.lab.data.several_forces import gathered  # late: it knows this class

        return gathered(self)

    @cached_property
    def lines(self) -> tuple[Index, Index]:
        """First row of each line, what one run at one frequency under one force is, and the line of each row; the speed
        is that which was set: probes may log it a moment apart."""
        return self.alike(*_LINE)

    @cached_property
    def lines_apart(self) -> tuple[Index, Index]:
        """The same, repeats of a reading being put on lines of their own."""
        line = self.lines[1]
        reading = combined(line, *[self.category(name).number for name in ("plane", "direction")])
        if not reading.size or np.bincount(reading).max() == 1:
            return self.lines
        return in_order(combined(occurrence(reading), line))

    @cached_property
    def forces(self) -> tuple[str, ...]:
        """Planes of the force in order of appearance, with the axis of those that do not turn: ``disk along x``; of
        forces that act at once all: ``disk + journal``."""
        first, _ = self.alike("force_plane", "force_direction", "further_forces")
        words = (
            [at if axis == "circular" else f"{at} along {axis}" for at, _, axis in self.acting(row)]
            for row in first.tolist()
        )
        return tuple(dict.fromkeys(map(" + ".join, words)))

    @cached_property
    def several(self) -> Bool:
        """Rows on which several forces act at once, shape ``(R,)``."""
        return np.array([bool(further) for further in self.further_forces.tolist()], dtype=bool)

    def acting(self, row: int) -> list[tuple[str, complex, str]]:
        """Plane, phasor (N) and direction of each force that acts on a row.

        Args:
            row: its number, from 0.
        """
        own = (str(self.force_plane[row]), complex(self.force[row]), str(self.force_direction[row]))
        return [own, *self.further_forces[row]]

    @cached_property
    def forces_by_plane(self) -> ComplexArray:
        """Circular forces of each row at each of ``force_planes``, N, shape ``(R, planes)``."""
        planes = self.force_planes
        found = np.zeros((len(self), len(planes)), dtype=complex)
        names, number = self.category("force_plane")
        place = np.array([planes.index(name) for name in names], dtype=np.intp)
        found[np.arange(len(self)), place[number]] = self.force
        for row in np.flatnonzero(self.several).tolist():
            for plane, force, _ in self.further_forces[row]:
                found[row, planes.index(plane)] += force
        return found

    def with_forces(self, change: Callable[[ComplexArray], ComplexArray]) -> PerturbationTest:
        """The test with each row's forces changed.

        Args:
            change: from one force of each row, N, shape ``(R,)``, to another.
        """
        further = [list(pairs) for pairs in self.further_forces.tolist()]
        for k in range(max(map(len, further), default=0)):
            column = np.array([pairs[k][1] if len(pairs) > k else 0 for pairs in further], dtype=complex)
            for pairs, force in zip(further, change(column).tolist(), strict=True):
                pairs[k : k + 1] = [(plane, force, axis) for plane, _, axis in pairs[k : k + 1]]
        return replace(self, force=change(self.force), further_forces=records(tuple(pairs) for pairs in further))

    @cached_property
    def derivative(self) -> Index:
        """How often the sensor of each reading differentiated the displacement: 2 for an accelerometer, ``(R,)``."""
        said = self.attributes.get(MEASURED)
        if said is None:
            return np.zeros(len(self), dtype=np.intp)
        return np.array([DERIVATIVES.index(word) if word in DERIVATIVES else 0 for word in said.tolist()])

    @cached_property
    def force_sigma(self) -> Float:
        """Standard deviation of both parts of each measured force, N, zero where none is given, shape ``(R,)``."""
        said = self.attributes.get(FORCE_SIGMA)
        return np.zeros(len(self)) if said is None else np.nan_to_num(said.astype(float))

    @property
    def linear(self) -> Bool:
        """Rows whose force acts along an axis and does not turn, shape ``(R,)``."""
        return np.asarray(self.force_direction != "circular")

    @cached_property
    def force_planes(self) -> tuple[str, ...]:
        """Planes of the forces in order of appearance."""
        further = [plane for acting in self.category("further_forces").names for plane, *_ in acting]
        return tuple(dict.fromkeys([*self.category("force_plane").names, *further]))

    @property
    def kind(self) -> str:
        """What the experiment is, in words."""
        return "synchronous test" if self.synchronous else self.title

    @property
    def motion(self) -> ComplexArray:
        """The responses."""
        return self.response

    @property
    def lateral(self) -> Bool:
        """Rows that are no slopes of the shaft, shape ``(R,)``."""
        return ~np.char.startswith(self.direction, "r")

    @property
    def unforced(self) -> Bool:
        """Rows without a force, shape ``(R,)``."""
        return np.asarray(self.force == 0)

    @property
    def same_place(self) -> Index:
        """Number of the run, speed, frequency and force of each row, shape ``(R,)``."""
        return self.alike("run", "set_speed", "frequency", "force_plane")[1]

    @property
    def probes(self) -> tuple[str, ...]:
        """Plane and direction of each probe in order of appearance."""
        pairs = zip(self.plane.tolist(), self.direction.tolist(), strict=True)
        return tuple(dict.fromkeys(map(" ".join, pairs)))

    @property
    def sizes(self) -> tuple[tuple[str, Float, str], ...]:
        """Amplitudes, and forces or, where it is the weight that was held, unbalances."""
        moved, forced = np.abs(self.response[self.lateral]) * 1e6, np.abs(self.force)
        found = (("amplitude", moved, "um 0-peak"),) if moved.size else ()
        if self.frequency.all():
            weight = forced / self.frequency**2 * 1e6
            if np.ptp(weight) * forced.max() < np.ptp(forced) * weight.max():
                return (*found, ("unbalance", weight, "g mm"))
        return (*found, ("force", forced, "N"))

    def excursion(self, plane: str, clearance: float) -> Float:
        """See any experiment; of a test about an equilibrium its distance from the centre."""
        if self.static_position is not None:
            return np.abs(self.static_position)
        return np.where((self.plane == plane) & self.lateral, np.abs(self.response), np.nan)

    @property
    def synchronous(self) -> bool:
        """True if every reading is at once-per-turn frequency."""
        return bool(len(self) and once_per_turn(self.frequency, self.speed).all())

    @property
    def static_position(self) -> ComplexArray | None:
        """Position about which the journal moves, ``x + j y``, m, from attributes ``static_x_um``, ``static_y_um``.

        ``None`` without these attributes: the test is centred. Other units of length by suffix.
        """
        parts = []
        for axis in ("static_x_", "static_y_"):
            found = [name for name in self.attributes if name.startswith(axis) and name[9:] in UNITS["length"]]
            parts += [self.attributes[name].astype(float) * UNITS["length"][name[9:]] for name in found[:1]]
        if len(parts) == 1:
            raise ValueError(f"{self.source}: a static position needs both static_x_um and static_y_um")
        return np.asarray(parts[0] + 1j * parts[1]) if parts else None

    def subtract_slow_roll(self, slow_roll: Mapping[tuple[str, str], complex]) -> PerturbationTest:
        """Subtract a slow-roll (run-out) vector for each (plane, direction), m, from all 1x readings.

        Args:
            slow_roll: vector, m 0-peak, by plane and direction: ``{("journal", "x"): 3e-6 + 1e-6j}``.
        """
        vector = np.array(
            [slow_roll.get((p, d), 0.0) for p, d in zip(self.plane.tolist(), self.direction.tolist(), strict=True)]
        )
        # run-out turns with the rotor: a single probe sees it at |w| = Omega whichever way the force turns
        seen = np.where(np.char.endswith(self.direction, "z"), self.frequency, np.abs(self.frequency))
        return replace(self, response=self.response - np.where(once_per_turn(seen, self.speed), vector, 0.0))


def records(values: Iterable[Any]) -> Records:
    """One object a row, tuples being left as they are."""
    return np.fromiter(values, dtype=object)


def none_further(rows: int) -> Records:
    """Further forces of rows on which one force acts alone."""
    return np.broadcast_to(records([()]), rows)


def perturbations(tests: Iterable[Experiment]) -> list[PerturbationTest]:
    """The responses to forces among some tests."""
    return [found for test in tests if (found := test.perturbation) is not None]


def plane_groups(test: PerturbationTest) -> list[list[str]]:
    """Groups of planes that runs connect, a run connecting the plane of its force with those it measures."""
    groups: list[set[str]] = []
    first, _ = test.alike("force_plane", "plane", "further_forces")
    columns = (test.force_plane, test.plane, test.further_forces)
    for forced, measured, further in zip(*[column[first].tolist() for column in columns], strict=True):
        connected = {forced, measured, *[plane for plane, *_ in further]}
        joined = connected.union(*[group for group in groups if group & connected])
        groups = [group for group in groups if not group & joined] + [joined]
    return [sorted(group) for group in groups]
