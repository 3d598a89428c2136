"""Any experiment: rows of readings in read-only arrays, and the plain answers to what rooms ask of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index, Text
from rotorfit.base.digits import significant
from rotorfit.base.equality import ByValue
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.blocks.row_keys import combined, in_order, numbers, words
from rotorfit.estimators.blocks.set_speeds import SPEED_TOLERANCE, set_speeds
from rotorfit.lab.data.table_columns import RUN, Layout

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

    from rotorfit.estimators.blocks.observations import Block
    from rotorfit.lab.data.experiments import PerturbationTest
    from rotorfit.lab.data.findings import Finding
    from rotorfit.models import RotorModel


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


class Category(NamedTuple):
    """Distinct entries of a column, and the number of each row's among them."""

    names: list[Any]  # texts and records in the order of the rows; of numbers none
    number: Index  # of numbers in ascending order, shape ``(R,)``


NO_COLUMNS = ("source", "findings", "attributes", "speed_tolerance")
"""Fields of an experiment that are no array with an entry a row."""
PLACEHOLDER = 1e-9 + 0j
"""Reading, m or N, in place of those of a test that was not made: inside any clearance."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Experiment(ByValue, ABC):
    """Read-only arrays of one length, one row a reading."""

    title: ClassVar[str]
    layout: ClassVar[Layout]  # its columns in a tidy table
    reads: ClassVar[Literal["motion", "force", ""]] = ""  # what a row reads whose noise may grow with it
    reducer: ClassVar[str] = "responses"  # the function of rotorfit that makes such tests of recordings
    tells_noise: ClassVar[bool] = False  # whether its rows are records that show their noise

    source: str = ""
    findings: tuple[Finding, ...] = ()  # what was found odd where it was read, or in the recordings that it is made of
    attributes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    speed_tolerance: float = SPEED_TOLERANCE
    run: Text
    speed: Float

    @abstractmethod
    def observe(self, model: RotorModel, group: Index) -> Block:
        """The readings in a model's coordinates, with their noise.

        Args:
            model: the rotor.
            group: parameter group of each row, shape ``(R,)``.
        """

    def table_columns(self) -> dict[str, NDArray[Any]]:
        """Columns of a tidy CSV by name, in rpm, um (urad for slopes and twist), N, degrees and s."""
        columns = (*RUN, *self.layout.columns)
        return {name: own for one in columns for name, own in one.written(getattr(self, one.name)).items()}

    @property
    def perturbation(self) -> PerturbationTest | None:
        """The responses to forces that it is, None of other kinds."""
        return None

    def corrected(self, correct: Callable[[PerturbationTest], PerturbationTest]) -> Experiment:
        """The experiment with responses to forces corrected, as it is where it holds none.

        Args:
            correct: from responses to forces to others.
        """
        return self

    def forced_at(self, plane: str) -> Bool:
        """Rows on which a further force acts at a plane beside that of its column, shape ``(R,)``.

        Args:
            plane: its name.
        """
        return np.zeros(len(self), dtype=bool)

    @property
    def swept(self) -> bool:
        """True if every row is of one frequency of a motion that was driven or imposed."""
        return self.motion.size == self.frequencies.size > 0

    @property
    def drives_both_ways(self) -> bool:
        """True if a force does not turn, so that motion forward and backward answers to it."""
        return False

    def own_findings(self) -> Iterator[Finding]:
        """What is wrong or odd about such a test in particular, of rows that are finite."""
        return iter(())

    @property
    def line_of_rows(self) -> Index:
        """Line of each row among the observations that are made of it, shape ``(R,)``."""
        return np.arange(len(self))

    @property
    def reduced_with(self) -> Mapping[str, float]:
        """Options by which its ``reducer`` made it of recordings."""
        return {}

    @property
    def reads_twist(self) -> bool:
        """True if the twist of a shaft was read."""
        return False

    @property
    def reads_start_up(self) -> bool:
        """True if lines of a shaft without a force were read over a start-up, where run-out shows."""
        return False

    def unread(self, sigma: Float) -> Experiment:
        """The test as planned, without readings but those of a journal at rest and of the mode that an impulse excites.

        Args:
            sigma: noise that its readings will have, in their unit, shape ``(R,)``.
        """
        return self

    def stored_rows(self) -> Experiment:
        """The experiment as files hold it."""
        return self

    def from_stored_rows(self) -> Experiment:
        """What was read of a file as the experiment that :meth:`stored_rows` was made of."""
        return self

    @cached_property
    def set_speed(self) -> Float:
        """Speed that the rotor was set to, rad/s: means of logged speeds within ``speed_tolerance``, shape ``(R,)``."""
        frequency = self.frequencies if len(self.frequencies) else np.zeros(len(self))
        return set_speeds(self.speed, frequency, self.category("run").number, self.speed_tolerance)

    def category(self, column: str) -> Category:
        """A column as categories, found once.

        Args:
            column: its name; ``set_speed`` counts too.
        """
        if column not in self._categories:
            given = getattr(self, column)
            found = words(given) if given.dtype.kind in "UO" else ([], numbers(given))
            self._categories[column] = Category(*found)
        return self._categories[column]

    @cached_property
    def _categories(self) -> dict[str, Category]:
        return {}

    def alike(self, *columns: str) -> tuple[Index, Index]:
        """First row of each distinct combination of entries, in the order of the rows, and the number of each row's.

        Args:
            columns: their names.
        """
        return in_order(combined(*[self.category(name).number for name in columns]))

    @cached_property
    def runs(self) -> tuple[str, ...]:
        """Names of the runs in order of appearance."""
        return tuple(self.category("run").names)

    @cached_property
    def planes(self) -> tuple[str, ...]:
        """Measured planes in order of appearance, none for experiments that name no plane."""
        return tuple(self.category("plane").names) if self.plane_of_rows.size else ()

    @property
    def plane_of_rows(self) -> Text:
        """Plane that each row was measured at, shape ``(R,)``, empty for experiments that name no plane."""
        return np.asarray(getattr(self, "plane", np.array([], dtype=str)))

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

    def to_xarray(self) -> Dataset:
        """The readings as an ``xarray.Dataset``, complex and in SI units, with what says where they are as coordinates.

        Example:
            >>> float(abs(rig.to_xarray().response).max()) == float(abs(rig.response).max())
            True
        """
        from rotorfit.lab.io.netcdf import to_xarray

        return to_xarray(self)

    def to_dataframe(self) -> DataFrame:
        """The experiment as a table with the columns of a tidy CSV, which :func:`rotorfit.read` takes too.

        Example:
            >>> len(rig.to_dataframe()) == len(rig)
            True
        """
        from rotorfit.lab.io.files import to_dataframe

        return to_dataframe(self)

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
        return [f.name for f in fields(self) if f.name not in NO_COLUMNS]

    def __len__(self) -> int:
        return len(self.run)

    def select(self, rows: NDArray[Any]) -> Self:
        """The experiment restricted to rows, given as a boolean mask or as indices."""
        chosen: dict[str, Any] = {name: getattr(self, name)[rows] for name in self._columns()}
        attributes = {name: values[rows] for name, values in self.attributes.items()}
        findings = tuple(replace(found, rows=(), lines=()) for found in self.findings)  # these were of all rows
        return replace(self, attributes=attributes, findings=findings, **chosen)

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


def short_source(source: str) -> str:
    """Where a test came from, of more files than a line holds the first one."""
    files, most = source.partition(" with ")[0].split(", "), 4
    return f"{files[0]} and {len(files) - 1} more" if len(files) > most else source


def in_words(value: Any) -> str:
    """A value of an attribute as the names of parameters have it."""
    return f"{value:.10g}" if isinstance(value, (int, float)) else str(value)
