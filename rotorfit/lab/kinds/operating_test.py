"""Operating vibration: spectra of a rotor that turbulence shakes, without an exciter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.accessors import Accessor
from rotorfit.base.array_types import ComplexArray, Float, Index, Text
from rotorfit.estimators.blocks.observations import Block
from rotorfit.estimators.blocks.operating import OperatingSpectra, packed
from rotorfit.estimators.blocks.row_keys import distinguished
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.table_columns import FREQUENCY, PURE, Column, Layout
from rotorfit.lab.observing.rows import check_finite, check_planes
from rotorfit.models import RotorModel

FORWARD, BACKWARD = "forward", "backward"
_POWER = {"um2_per_hz": 1e-12, "m2_per_hz": 1.0}


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class OperatingTest(Experiment):
    """Cross-spectra of a rotor that turbulence shakes: one row is one entry of the matrix of one cell of frequencies.

    The signals of a cell at w are ``z(w)`` of each plane, forward, and ``conj z(-w)``, backward. The matrix is
    Hermitian: rows hold its upper half, diagonal included. :func:`rotorfit.operating_spectra` makes it of recordings.

    Attributes:
        run: name of the recording, shape ``(R,)`` like all that follow.
        speed: rotative speed, rad/s.
        frequency: middle of the cell, rad/s, positive.
        plane, sense: of the entry's first signal, ``forward`` or ``backward``.
        other_plane, other_sense: of the second, which is conjugated.
        power: average cross-periodogram, a two-sided density, m^2/Hz.
        freedom: complex degrees of freedom of the average: how many independent lines of a spectrum it is of.
        attributes, source: see :class:`PerturbationTest`.
    """

    title: ClassVar[str] = "operating vibration"
    layout: ClassVar[Layout] = Layout(
        columns=(
            Column("frequency", (FREQUENCY,)),
            *map(Column, ("plane", "sense", "other_plane", "other_sense")),
            Column("power", (("power", "um2_per_Hz", _POWER), ("power_imag", "um2_per_Hz", _POWER))),
            Column("freedom", (("freedom", "ratio", PURE),)),
        ),
        marks=("freedom",),
        run="operation",
        known="speed_rpm, frequency_rpm, plane, sense, other_plane, other_sense, power_um2_per_Hz, "
        "power_imag_um2_per_Hz, freedom_ratio, optional run",
    )
    reducer: ClassVar[str] = "operating_spectra"
    tells_noise: ClassVar[bool] = True

    plot = Accessor()

    frequency: Float
    plane: Text
    sense: Text
    other_plane: Text
    other_sense: Text
    power: ComplexArray
    freedom: Float

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("sense", "other_sense"):
            unknown = sorted(set(getattr(self, name).tolist()) - {FORWARD, BACKWARD})
            if unknown:
                raise ValueError(
                    f"{self.source or 'the test'}: {name} {unknown} unknown; allowed: {FORWARD}, {BACKWARD}"
                )

    def observe(self, model: RotorModel, group: Index) -> Block:
        """See any experiment."""
        return _observed(self, model, group)

    @property
    def line_of_rows(self) -> Index:
        """See any experiment: the cell of each row."""
        return self.alike("run", "speed", "frequency")[1]

    def matrices(self, planes: tuple[str, ...]) -> tuple[Index, ComplexArray]:
        """First row of each cell in which all signals of some planes were read, and its matrix, ``(C, 2n, 2n)``.

        Args:
            planes: their names, in the order of the matrix: all forward, then all backward.
        """
        first, cell = self.alike("run", "speed", "frequency")
        names = [f"{plane} {way}" for way in (FORWARD, BACKWARD) for plane in planes]
        number = {name: i for i, name in enumerate(names)}
        pairs = (
            zip(planes_of.tolist(), ways.tolist(), strict=True)
            for planes_of, ways in ((self.plane, self.sense), (self.other_plane, self.other_sense))
        )
        row, column = (np.array([number.get(f"{p} {way}", -1) for p, way in some], dtype=np.intp) for some in pairs)
        here = (row >= 0) & (column >= 0)
        matrix = np.full((first.size, len(names), len(names)), complex(np.nan))
        matrix[cell[here], column[here], row[here]] = self.power[here].conj()
        matrix[cell[here], row[here], column[here]] = self.power[here]
        whole = np.isfinite(matrix).all(axis=(1, 2))
        return first[whole], matrix[whole]


def operating_test(
    run: str, speed: float, planes: tuple[str, ...], cells: Any, attributes: Mapping[str, Any], source: str
) -> OperatingTest:
    """The test of one recording's cells."""
    m, count = 2 * len(planes), cells.frequency.size
    row, column = np.triu_indices(m)
    names = np.array([*planes, *planes])
    ways = np.repeat([FORWARD, BACKWARD], len(planes))
    rows = row.size * count

    def each(values: NDArray[Any]) -> NDArray[Any]:
        return np.tile(values, count)

    return OperatingTest(
        run=np.full(rows, run),
        speed=np.full(rows, speed),
        frequency=np.repeat(2 * np.pi * cells.frequency, row.size),
        plane=each(names[row]),
        sense=each(ways[row]),
        other_plane=each(names[column]),
        other_sense=each(ways[column]),
        power=cells.power[:, row, column].reshape(-1),
        freedom=np.repeat(cells.freedom, row.size),
        attributes={name: np.full(rows, value) for name, value in attributes.items()},
        source=source,
    )


def _observed(test: OperatingTest, model: RotorModel, group: Index) -> OperatingSpectra:
    where = test.source or test.title
    check_finite(test, test.speed, test.frequency, test.power, test.freedom)
    planes = tuple(plane for plane in model.read_planes if plane in test.planes)
    check_planes(model, test, test.planes, (), forces="forces")
    if model.frame != "z":
        raise ValueError(f"{where}: {model.name} keeps x and y apart; operating vibration needs a model in z = x + jy")
    if model.eccentricity_dependent:
        raise ValueError(f"{where}: {model.name} changes with eccentricity; operating vibration is of a linear rotor")
    first, matrix = test.matrices(planes)
    if not first.size:
        raise ValueError(f"{where}: no cell has all entries of the matrix of {', '.join(planes)}")
    m = 2 * len(planes)
    cells = test.select(first)
    if not (cells.freedom >= m).all():
        raise ValueError(
            f"{where}: {cells.freedom.min():.2g} degrees of freedom a cell are fewer than its {m} signals: longer "
            "recordings, or wider cells (width_hz=)"
        )
    share = m * m // 2
    names = [f"{plane} power" for plane in planes] + ["cross-spectra"] * (share - len(planes))
    labels = tuple(dict.fromkeys(f"{run} / {name}" for run in cells.runs for name in dict.fromkeys(names)))
    label = [labels.index(f"{run} / {name}") for run in cells.run.tolist() for name in names]
    return OperatingSpectra(
        model=model,
        measured=packed(matrix),
        sigma=np.ones(first.size * share),
        label=np.array(label, dtype=np.intp),
        labels=labels,
        run=np.repeat(cells.run, share),
        speed=cells.speed,
        frequency=cells.frequency,
        degrees=cells.freedom,
        group=group[first],
        setting=distinguished(cells.run, cells.speed)[1],
        coordinate=np.array([model.coordinate(plane, "z") for plane in planes], dtype=np.intp),
    )
