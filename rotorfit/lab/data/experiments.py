"""Experiments as plain arrays in SI units. Readers make them, estimators see only what is derived from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any, ClassVar, Self, cast

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.accessors import Accessor
from rotorfit.base.array_types import Bool, ComplexArray, Float, Index, Records, Text
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S, UNITS
from rotorfit.estimators.blocks.row_keys import distinguished, numbers, words
from rotorfit.estimators.blocks.set_speeds import SPEED_TOLERANCE, once_per_turn, set_speeds
from rotorfit.lab.data.lines import Lines, lines_of

if TYPE_CHECKING:
    from pandas import DataFrame

DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")
"""x, y: one probe, phasor relative to exp(+j|w|t); z: complex amplitude relative to exp(jwt) with w signed.
rx, ry, rz: the same for the slopes dx/ds, dy/ds of the shaft."""

FORCE_DIRECTIONS = ("circular", "x", "y")
"""A force that turns with the sign of the frequency (eq. 2), or one along an axis that does not turn."""


DERIVATIVES = ("displacement", "velocity", "acceleration")
"""Quantities that sensors measure, in the order of the derivatives of the displacement."""

FORCE_SIGMA = "force_sigma_N"
"""Attribute: standard deviation of the real part and of the imaginary part of each measured force, N."""

MEASURED = "measured_quantity"
"""Attribute that says which of :data:`DERIVATIVES` a reading was before it became a displacement."""


def _read_only(values: NDArray[Any]) -> NDArray[Any]:
    """An array that nobody writes to: what is worked out of it holds as long as it lives."""
    if not isinstance(values, np.ndarray) or values.flags.writeable:
        values = np.array(values)
        values.flags.writeable = False
    return values


def _range(rates: Float) -> str:
    """Lowest and highest of some frequencies or speeds, rad/s, in rpm."""
    rates = rates[np.isfinite(rates)] * RPM_PER_RAD_S
    if not rates.size:
        return ""
    ends = [significant(end, 5) for end in (rates.min(), rates.max())]
    return ends[0] if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class _Rows:
    """Read-only arrays of one length, one row a reading."""

    title: ClassVar[str]

    source: str = ""
    attributes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    speed_tolerance: float = SPEED_TOLERANCE
    run: Text
    speed: Float

    @cached_property
    def set_speed(self) -> Float:
        """Speed that the rotor was set to, rad/s: means of logged speeds within ``speed_tolerance``, shape ``(R,)``."""
        frequency = self.frequencies if len(self.frequencies) else np.zeros(len(self))
        return set_speeds(self.speed, frequency, numbers(self.run), self.speed_tolerance)

    @cached_property
    def runs(self) -> tuple[str, ...]:
        """Names of the runs in order of appearance."""
        return tuple(words(self.run)[0])

    @cached_property
    def planes(self) -> tuple[str, ...]:
        """Measured planes in order of appearance, none for experiments that name no plane."""
        return tuple(words(getattr(self, "plane", np.zeros(0)))[0])

    @property
    def frequencies(self) -> Float:
        """Tested or measured frequencies, rad/s; none for constant loads and records."""
        return np.asarray(getattr(self, "frequency", np.zeros(0)))

    @property
    def kind(self) -> str:
        """What the experiment is, in words."""
        return self.title

    @property
    def synchronous(self) -> bool:
        """True if every reading is a response at once-per-turn frequency."""
        return False

    @property
    def motion(self) -> ComplexArray:
        """Motion that each row read or imposed, m, of slopes rad; empty where a kind has none."""
        return np.zeros(0, dtype=complex)

    @property
    def lateral(self) -> Bool:
        """Rows that are no slopes of the shaft, shape ``(R,)``."""
        return np.ones(len(self), dtype=bool)

    @property
    def unforced(self) -> Bool:
        """Rows of responses that no force brought about, shape ``(R,)``."""
        return np.zeros(len(self), dtype=bool)

    @property
    def same_place(self) -> Index:
        """Number of each row, the same where rows share one position of the journal, shape ``(R,)``."""
        return np.arange(len(self))

    @property
    def probes(self) -> tuple[str, ...]:
        """Plane, and direction where it is told, of each probe in order of appearance."""
        return self.planes

    @property
    def forces(self) -> tuple[str, ...]:
        """Planes of forces that turn or go with a frequency, in order of appearance, as a test names them."""
        return ()

    @property
    def force_planes(self) -> tuple[str, ...]:
        """Planes of all forces and loads in order of appearance."""
        return ()

    @property
    def sizes(self) -> tuple[tuple[str, Float, str], ...]:
        """Names of what was read and what brought it about, the sizes of these, and their units."""
        return ()

    def excursion(self, plane: str, clearance: float) -> Float:
        """How far the journal at a plane went by each reading, m, NaN where the reading is not of it, ``(R,)``.

        Args:
            plane: of the journal.
            clearance: of its bearing, m.
        """
        return np.full(len(self), np.nan)

    def with_forces(self, change: Callable[[ComplexArray], ComplexArray]) -> Self:
        """The experiment with other forces where turning forces were applied, and as it is elsewhere.

        Args:
            change: from one force of each row, N, shape ``(R,)``, to another.
        """
        return self

    def __repr__(self) -> str:
        """Kind and size of the experiment, on one line; the arrays are its attributes."""
        rpm = np.unique(np.round(self.set_speed * RPM_PER_RAD_S, 3))
        speeds = ", ".join(f"{s:g}" for s in rpm) if rpm.size <= 4 else f"{rpm[0]:g} to {rpm[-1]:g}"
        places = f", at {', '.join(self.planes)}" if self.planes else ""
        source = self.source or "from arrays"
        return f"<{type(self).__name__} {source}: {self.size_in_words}{places}, {speeds or 'no'} rpm>"

    def _repr_html_(self) -> str:
        """Runs as a table, for a notebook."""
        head = ("run", "readings", "speed, rpm", "frequency, rpm", "planes")
        most = 30  # runs that are read at a glance
        rows = []
        for run in self.runs[:most]:
            here = np.flatnonzero(np.asarray(self.run) == run)
            own = self.select(here)
            ranges = _range(self.set_speed[here]), _range(own.frequencies)
            rows.append((run, str(here.size), *ranges, ", ".join(own.planes)))
        body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
        names = "".join(f"<th>{name}</th>" for name in head)
        more = f"<p>and {len(self.runs) - most} more runs</p>" if len(self.runs) > most else ""
        table = f"<table><thead><tr>{names}</tr></thead><tbody>{body}</tbody></table>"
        return f"<p>{escape(repr(self)[1:-1])}</p>{table}{more}"

    def to_dataframe(self) -> DataFrame:
        """The experiment as a table with the columns of a tidy CSV, which :func:`rotorfit.read` takes too.

        Example:
            >>> len(rig.to_dataframe()) == len(rig)
            True
        """
        from rotorfit.lab.io.files import to_dataframe

        return to_dataframe(cast("Experiment", self))

    @property
    def size_in_words(self) -> str:
        """How many readings in how many runs."""
        rows, runs = len(self), len(self.runs)
        return f"{rows} reading{'s' * (rows != 1)} in {runs} run{'s' * (runs != 1)}"

    def __post_init__(self) -> None:
        lengths = {name: len(getattr(self, name)) for name in self._columns()}
        lengths |= {name: len(values) for name, values in self.attributes.items()}
        if len(set(lengths.values())) != 1:
            raise ValueError(f"{type(self).__name__}: columns of unequal length: {lengths}")
        self._freeze()

    def _freeze(self) -> None:
        for name in self._columns():
            object.__setattr__(self, name, _read_only(getattr(self, name)))
        object.__setattr__(self, "attributes", {name: _read_only(v) for name, v in self.attributes.items()})

    def __getstate__(self) -> dict[str, Any]:
        """The columns alone: what was worked out of them is worked out again where it is needed."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def __setstate__(self, columns: dict[str, Any]) -> None:
        self.__dict__.update(columns)
        self._freeze()

    def _columns(self) -> list[str]:
        return [f.name for f in fields(self) if f.name not in ("source", "attributes", "speed_tolerance")]

    def __len__(self) -> int:
        return len(self.run)

    def select(self, rows: NDArray[Any]) -> Self:
        """The experiment restricted to rows, given as a boolean mask or as indices."""
        chosen: dict[str, Any] = {name: getattr(self, name)[rows] for name in self._columns()}
        attributes = {name: values[rows] for name, values in self.attributes.items()}
        return replace(self, attributes=attributes, **chosen)

    def attribute(self, name: str) -> NDArray[Any]:
        """Values of a test attribute for each row; ``speed_rpm``, which the rotor was set to, and ``run`` count too.

        ``speed_rpm+pressure_bar`` stands for both together, with values such as ``3000+2``.
        """
        if "+" in name and name not in self.attributes:
            parts = [self.attribute(one.strip()).tolist() for one in name.split("+")]
            return np.array(["+".join(in_words(value) for value in row) for row in zip(*parts, strict=True)])
        if name == "speed_rpm":
            return np.asarray(np.round(self.set_speed * RPM_PER_RAD_S, 6))
        if name == "run":
            return self.run
        if name not in self.attributes:
            raise KeyError(
                f"{self.source or 'the experiment'} has no attribute {name!r}; it has "
                f"{', '.join(['run', 'speed_rpm', *self.attributes])}"
            )
        return self.attributes[name]


def in_words(value: Any) -> str:
    """A value of an attribute as the names of parameters have it."""
    return f"{value:.10g}" if isinstance(value, (int, float)) else str(value)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PerturbationTest(_Rows):
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
            unknown = sorted(set(words(getattr(self, name))[0]) - set(allowed))
            if unknown:
                raise ValueError(
                    f"{self.source or 'the test'}: {name} {unknown} unknown; allowed: {', '.join(allowed)}"
                )
        bad = self.linear & (self.frequency < 0)
        if bad.any():
            bad &= ~np.char.endswith(self.direction, "z")
        if bad.any():
            raise ValueError(
                f"{self.source or 'the test'}: {bad.sum()} readings have a negative frequency under a force along "
                f"{self.force_direction[bad][0]} (row {np.flatnonzero(bad)[0] + 1}); a force that does not turn has "
                "positive ones"
            )

    @cached_property
    def lines(self) -> Lines:
        """Rows put together by lines: what one run at one frequency under one force is."""
        return lines_of({name: getattr(self, name) for name in self._columns()} | {"speed": self.set_speed})

    @cached_property
    def forces(self) -> tuple[str, ...]:
        """Planes of the force in order of appearance, with the axis of those that do not turn: ``disk along x``; of
        forces that act at once all: ``disk + journal``."""
        first, _ = distinguished(self.force_plane, self.force_direction, self.further_forces)
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
        names, number = words(self.force_plane)
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
        further = [plane for acting in words(self.further_forces)[0] for plane, *_ in acting]
        return tuple(dict.fromkeys([*words(self.force_plane)[0], *further]))

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
        return distinguished(self.run, self.set_speed, self.frequency, self.force_plane)[1]

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


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class DisplacementTest(_Rows):
    """Forces measured while a circular orbit is imposed (eqs 14 to 17), one row a frequency.

    Attributes:
        run: name of the run, shape ``(R,)`` like all that follow.
        speed: rotative speed, rad/s.
        frequency: frequency of the imposed orbit, rad/s, signed.
        plane: plane of the imposed orbit and of the measured force.
        displacement: imposed circular orbit as in eq. (2), ``A exp(j delta)``, m.
        force_x, force_y: measured force phasors relative to exp(+j|w|t), N.
        sigma: standard deviation of real and imaginary part of each force reading, N, NaN if unknown.
        attributes, source: see :class:`PerturbationTest`.
    """

    title: ClassVar[str] = "displacement-in test"

    frequency: Float
    plane: Text
    displacement: ComplexArray
    force_x: ComplexArray
    force_y: ComplexArray
    sigma: Float

    @property
    def motion(self) -> ComplexArray:
        """The imposed orbits."""
        return self.displacement

    @property
    def sizes(self) -> tuple[tuple[str, Float, str], ...]:
        """Amplitudes and forces."""
        forced = np.hypot(np.abs(self.force_x), np.abs(self.force_y)) / np.sqrt(2)
        found = (("amplitude", np.abs(self.displacement) * 1e6, "um 0-peak"),) if len(self) else ()
        return (*found, ("force", forced, "N"))

    def excursion(self, plane: str, clearance: float) -> Float:
        """See any experiment."""
        return np.where(self.plane == plane, np.abs(self.displacement), np.nan)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class StaticTest(_Rows):
    """Displacements of a turning rotor under constant loads, one row a load (Figs 26 to 28).

    Attributes:
        run: name of the run, shape ``(R,)`` like all that follow.
        speed: rotative speed, rad/s.
        load_plane: plane of the load.
        load: ``Px + j Py = P exp(j g)``, N.
        plane: plane of the probes.
        displacement: displacement from the centre of the bearing or seal, ``x + j y``, m.
        sigma: standard deviation of x and of y, m, NaN if unknown.
        attributes, source: see :class:`PerturbationTest`.
    """

    title: ClassVar[str] = "static-load test"

    load_plane: Text
    load: ComplexArray
    plane: Text
    displacement: ComplexArray
    sigma: Float

    @property
    def motion(self) -> ComplexArray:
        """The displacements."""
        return self.displacement

    @property
    def same_place(self) -> Index:
        """Number of the run, speed and load of each row, shape ``(R,)``."""
        return distinguished(self.run, self.speed, self.load_plane, self.load)[1]

    @property
    def sizes(self) -> tuple[tuple[str, Float, str], ...]:
        """Loads and positions."""
        return ("load", np.abs(self.load), "N"), ("position", np.abs(self.displacement) * 1e6, "um")

    def excursion(self, plane: str, clearance: float) -> Float:
        """See any experiment."""
        return np.where(self.plane == plane, np.abs(self.displacement), np.nan)

    @property
    def force_planes(self) -> tuple[str, ...]:
        """Planes of the load in order of appearance."""
        return tuple(dict.fromkeys(self.load_plane.tolist()))


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ImpulseTest(_Rows):
    """Free vibration after an impulse: frequency and damping of a mode, one row an impulse (Fig. 29).

    The journal rests at ``eccentricity``, or, where that is NaN, at ``position``.

    Attributes:
        run: name of the run, shape ``(R,)`` like all that follow.
        speed: rotative speed, rad/s.
        frequency: damped natural frequency, rad/s; off-centre motion turns both ways, so its sign does not count.
        damping_ratio: ``zeta = -Re s / |s|`` of the eigenvalue s; negative where the rotor is unstable.
        eccentricity: static eccentricity of the journal, NaN where ``position`` is given.
        position: static position of the journal, ``x + j y``, m, NaN where ``eccentricity`` is given.
        sigma: standard deviation of the real and of the imaginary part of s, 1/s, NaN if unknown.
        attributes, source: see :class:`PerturbationTest`.
    """

    title: ClassVar[str] = "impulse test"

    frequency: Float
    damping_ratio: Float
    eccentricity: Float
    position: ComplexArray
    sigma: Float

    def __post_init__(self) -> None:
        super().__post_init__()
        bad = np.abs(self.damping_ratio) >= 1
        if bad.any():
            raise ValueError(
                f"{self.source or 'impulse test'}: damping_ratio {self.damping_ratio[bad][0]:g} in row "
                f"{np.flatnonzero(bad)[0] + 1}; a mode that vibrates has one between -1 and 1"
            )

    def excursion(self, plane: str, clearance: float) -> Float:
        """Where the journal rests."""
        return np.where(np.isnan(self.eccentricity), np.abs(self.position), self.eccentricity * clearance)

    @property
    def eigenvalue(self) -> ComplexArray:
        """Eigenvalues ``s = |w_d| (-zeta / sqrt(1 - zeta^2) + j)``, 1/s, shape ``(R,)``."""
        w = np.abs(self.frequency)
        return np.asarray(w * (1j - self.damping_ratio / np.sqrt(1 - self.damping_ratio**2)))

    @property
    def frequency_ratio(self) -> Float:
        """Damped frequency over rotative speed, which the paper reports as lam(eps); good to the damping ratio."""
        return np.abs(self.frequency) / np.abs(self.speed)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class RingDownTest(_Rows):
    """Records of free vibration after impulses, one row a sample, one run a record.

    :func:`rotorfit.ring_down_modes` reduces it to an :class:`ImpulseTest`; fits do so by themselves.

    Attributes:
        run: name of the record, shape ``(R,)`` like all that follow.
        speed: rotative speed, rad/s, one value in each record.
        time: s, equally spaced in each record.
        x, y: displacements of the journal, m; they settle at its static position.
        eccentricity: static eccentricity; NaN where it follows from where x and y settle.
        attributes, source: see :class:`PerturbationTest`.
    """

    title: ClassVar[str] = "ring-down records"

    time: Float
    x: Float
    y: Float
    eccentricity: Float


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class CoefficientTable(_Rows):
    """Coefficients of an isotropic bearing or seal by speed and eccentricity, from a seal code or a test report.

    ``kxx = kyy``, ``kxy = -kyx`` and so on, with the signs of the fluid force: positive kxy drives forward whirl.

    Attributes:
        run: name of the conditions, rows that differ in eccentricity alone having the same, shape ``(R,)`` like all
            that follow.
        speed: rotative speed, rad/s.
        eccentricity: orbit radius over clearance.
        kxx, kxy: N/m.
        cxx, cxy: N s/m.
        mxx: kg.
        sigma: standard deviation of each coefficient as a fraction of it, for instance 3e-7 for a table of six digits.
        attributes, source: see :class:`PerturbationTest`.
    """

    title: ClassVar[str] = "table of coefficients"

    eccentricity: Float
    kxx: Float
    kxy: Float
    cxx: Float
    cxy: Float
    mxx: Float
    sigma: Float


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class LineTest(_Rows):
    """Spectral lines of a rotor whose stiffness turns with it, and of its twist: one row is one line of one signal.

    A force at w makes motion at w, at its image 2 Om - w, and twist at w - Om, w - 2 Om, ...; lines without a force
    (1x, 2x) stand in rows with force zero.

    Attributes:
        run: name of the run, shape ``(R,)`` like all that follow.
        speed: rotative speed Om, rad/s.
        frequency: perturbation frequency w, rad/s, signed; zero where there is no force.
        force_plane: plane of the force.
        force: ``F exp(j delta)`` of eq. (2), N.
        plane: plane of the reading.
        direction: ``z`` (lateral, x + jy) or ``twist``.
        line: name of the line: ``w``, ``2Om-w``, ``1x``, ``2x``, ... or of the twist ``w-Om``, ``w-2Om``, ``2w-2Om``.
        response: complex amplitude relative to ``exp(j nu t)``, nu the line's signed frequency, m or rad; of the twist
            ``phi = Re(response exp(j nu t))``.
        sigma: standard deviation of its real and of its imaginary part, NaN if unknown.
        attributes, source: see :class:`PerturbationTest`.
    """

    title: ClassVar[str] = "line test"
    START_UP: ClassVar[int] = 5  # speeds of a line without force from which it was read over a start-up

    frequency: Float
    force_plane: Text
    force: ComplexArray
    plane: Text
    direction: Text
    line: Text
    response: ComplexArray
    sigma: Float

    def __post_init__(self) -> None:
        super().__post_init__()
        unknown = sorted(set(self.direction.tolist()) - {"z", "twist"})
        if unknown:
            raise ValueError(f"{self.source or 'the test'}: direction {unknown} unknown; allowed: z, twist")

    @property
    def force_planes(self) -> tuple[str, ...]:
        """Planes of the force in order of appearance."""
        return tuple(words(self.force_plane)[0])


Experiment = PerturbationTest | DisplacementTest | StaticTest | ImpulseTest | RingDownTest | CoefficientTable | LineTest


def perturbation_test(
    *,
    run: Sequence[str] | Text,
    speed: Any,
    frequency: Any,
    force_plane: Sequence[str] | Text,
    force: Any,
    plane: Sequence[str] | Text,
    direction: Sequence[str] | Text,
    response: Any,
    sigma: Any = np.nan,
    force_direction: str | Sequence[str] | Text = "circular",
    force_angle: Any = None,
    further_forces: Sequence[tuple[tuple[Any, ...], ...]] | Records = (),
    attributes: Mapping[str, Any] | None = None,
    source: str = "",
) -> PerturbationTest:
    """Build a :class:`PerturbationTest` from arrays or scalars, scalars spread over all rows.

    A reading under several forces at once is written once for each: rows that agree in run, speed, frequency, plane,
    direction and response, with different planes of the force.

    Args:
        run, speed, frequency, force_plane, force, plane, direction, response, sigma, force_direction: SI units, shape
            ``(R,)`` or scalar, see :class:`PerturbationTest`.
        force_angle: angles at which circular forces point at t = 0, from x towards y, forward and backward alike, rad;
            ``force`` is then their size. It goes with readings z: ``z = H(w) F exp(j force_angle)`` at signed w. Left
            out, ``force`` is ``F exp(j delta)`` of eq. (2), whose delta is minus that angle where w < 0.
        further_forces: pairs (plane, N), or (plane, N, direction), of each row, in place of rows written once for each
            force; without a direction it is that of ``force``.
        attributes: further columns by name.
        source: where the data came from, for messages.

    Raises:
        ValueError: columns of unequal length, an unknown direction, or a reading that contradicts itself.

    Example:
        >>> test = rf.perturbation_test(
        ...     run="fwd", speed=150.0, frequency=[40.0, 80.0], force_plane="journal", force=5.0,
        ...     plane="journal", direction="z", response=[2e-4 - 1e-4j, 1e-4 - 1e-4j], sigma=1e-7,
        ... )
        >>> len(test), test.planes
        (2, ('journal',))
    """
    given = {
        "run": (run, str),
        "speed": (speed, float),
        "frequency": (frequency, float),
        "force_plane": (force_plane, str),
        "force": (force, complex),
        "plane": (plane, str),
        "direction": (direction, str),
        "response": (response, complex),
        "sigma": (sigma, float),
        "force_direction": (force_direction, str),
    }
    if force_angle is not None:
        given["force"] = (_phasor(force, force_angle, frequency, force_direction), complex)
    columns = {name: _column(name, values, kind) for name, (values, kind) in given.items()}
    lengths = {name: column.shape for name, column in columns.items() if column.size != 1}
    if len(set(lengths.values())) > 1 or any(len(shape) > 1 for shape in lengths.values()):
        listed = ", ".join(f"{name} {' x '.join(map(str, shape))}" for name, shape in lengths.items())
        raise ValueError(f"{source or 'the test'}: columns must be single values or lists of one length; got {listed}")
    shape = np.broadcast_shapes((1,), *[column.shape for column in columns.values()])
    spread: dict[str, Any] = {name: np.broadcast_to(column, shape).copy() for name, column in columns.items()}
    from rotorfit.lab.data.several_forces import gathered

    rows = zip(further_forces, spread["force_direction"].tolist(), strict=True) if len(further_forces) else ()
    further = records(tuple((at, F, *(rest or [axis])) for at, F, *rest in acting) for acting, axis in rows)
    test = PerturbationTest(
        **spread,
        attributes={name: np.broadcast_to(np.asarray(v), shape).copy() for name, v in (attributes or {}).items()},
        source=source,
        further_forces=further,
    )
    return test if len(further_forces) else gathered(test)


def _phasor(size: Any, angle: Any, frequency: Any, along: Any) -> ComplexArray:
    """``F exp(j delta)`` of forces that point at an angle at t = 0."""
    if np.any(np.asarray(along) != "circular"):
        raise ValueError("force_angle is the angle of a circular force; along an axis give the phasor as force")
    if np.iscomplexobj(size):
        raise ValueError("force_angle goes with the size of the force; force is complex and has an angle already")
    turn = np.where(np.asarray(frequency, dtype=float) < 0, -1j, 1j)
    return np.asarray(np.asarray(size, dtype=float) * np.exp(turn * np.asarray(angle, dtype=float)))


def _column(name: str, values: Any, kind: type) -> NDArray[Any]:
    try:
        return np.asarray(values, dtype=kind)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{name} must be numbers in SI units, one for each reading: {error}") from error


def plane_groups(test: PerturbationTest) -> list[list[str]]:
    """Groups of planes that runs connect, a run connecting the plane of its force with those it measures."""
    groups: list[set[str]] = []
    first, _ = distinguished(test.force_plane, test.plane, test.several)
    columns = (test.force_plane, test.plane, test.further_forces)
    for forced, measured, further in zip(*[column[first].tolist() for column in columns], strict=True):
        connected = {forced, measured, *[plane for plane, *_ in further]}
        joined = connected.union(*[group for group in groups if group & connected])
        groups = [group for group in groups if not group & joined] + [joined]
    return [sorted(group) for group in groups]
