"""Tests of spectral lines: of a rotor whose stiffness turns with it, and of its twist."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float, Index, Text
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.blocks.row_keys import distinguished
from rotorfit.estimators.blocks.shaft_lines import LineResponses, PairResponses, is_image_line
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.table_columns import FORCED, Layout, in_units_of
from rotorfit.lab.observing.rows import check_finite, of_rows
from rotorfit.models import AnisotropicShaft, RotorModel
from rotorfit.models.shafts.combination_lines import line_order


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class LineTest(Experiment):
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
    layout: ClassVar[Layout] = Layout(columns=FORCED)
    reducer: ClassVar[str] = "shaft_lines"
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
        return tuple(self.category("force_plane").names)

    def observe(self, model: RotorModel, group: Index) -> Block:
        """See any experiment."""
        return _observed(self, model, group)

    @property
    def reduced_with(self) -> Mapping[str, float]:
        """The run-out, um."""
        values = self.attributes.get("runout_um")
        return {} if values is None else {"runout_um": float(values[0])}

    @property
    def reads_twist(self) -> bool:
        """See any experiment."""
        return bool((self.direction == "twist").any())

    @property
    def reads_start_up(self) -> bool:
        """See any experiment."""
        return min(np.unique(self.speed[self.line == name]).size for name in ("1x", "2x")) >= self.START_UP

    def table_columns(self) -> dict[str, NDArray[Any]]:
        """See any experiment."""
        values = {"real": self.response.real, "imag": self.response.imag, "sigma": self.sigma}
        return super().table_columns() | {"line": self.line} | in_units_of(self.direction, values)

    def unread(self, sigma: Float) -> Experiment:
        """See any experiment."""
        return replace(self, sigma=sigma)


def _observed(test: LineTest, model: RotorModel, group: Index) -> LineResponses | PairResponses:
    where = test.source or test.title
    if not model.turns:
        raise ValueError(
            f"{where} has combination lines, which {model.name} does not have; use AnisotropicShaft, or "
            f"Turning({type(model).__name__}(...))"
        )
    planes = sorted({*test.planes, *test.force_planes} - set(model.planes))
    if planes:
        raise ValueError(
            f"{where} has the plane {', '.join(planes)}, {model.name} has {', '.join(model.planes)}; map the name with "
            f"{type(model).__name__}(planes=({planes[0]!r},))"
        )
    if not model.line_places:
        for direction, line in dict.fromkeys(zip(test.direction.tolist(), test.line.tolist(), strict=True)):
            line_order(direction, line)
    if isinstance(model, AnisotropicShaft) and model.torsion is None and test.reads_twist:
        raise ValueError(f"{where} has readings of the twist, the model has none; use AnisotropicShaft() with torsion")
    check_finite(test, test.speed, test.frequency, test.force, test.response)
    if not (test.sigma > 0).all():
        raise ValueError(f"{where}: the noise of {np.sum(~(test.sigma > 0))} readings is not known; give their sigma")
    names = zip(test.run.tolist(), test.plane.tolist(), test.direction.tolist(), test.line.tolist(), strict=True)
    titles = (f"{run} / {'twist' if way == 'twist' else plane} {line}" for run, plane, way, line in names)
    rows = of_rows(model, test, titles)
    if not isinstance(model, AnisotropicShaft):
        return _pairs(model, test, group, rows["label"], rows["labels"])
    return LineResponses(
        **rows,
        frequency=test.frequency,
        force=np.where(test.frequency < 0, test.force.conj(), test.force),
        direction=test.direction,
        line=test.line,
        reading_group=group,
        measured=test.response,
        sigma=test.sigma,
    )


def _pairs(model: RotorModel, test: LineTest, group: Index, label: Index, labels: tuple[str, ...]) -> PairResponses:
    """Readings at w, 2 Om - w and others as responses in turning coordinates."""
    known = [f"z {name}" for name in model.line_places]
    others = sorted(
        {f"{d} {name}" for d, name in zip(test.direction.tolist(), test.line.tolist(), strict=True)} - {*known}
    )
    if others:
        kind = "" if model.line_count > 2 else " in round supports"
        raise ValueError(
            f"{test.source or test.title} has the lines {', '.join(others)}; a rotor with a turning element{kind} has "
            f"{', '.join(known[:-1])} and {known[-1]}: select those rows"
        )
    force = np.where(test.frequency < 0, test.force.conj(), test.force)
    first, line = distinguished(test.run, test.speed, test.frequency, test.force_plane, force, group)
    order = np.argsort(line, kind="stable")  # readings of a line stand together
    rows = test.select(order)
    n = len(model.coordinates)
    drive = np.zeros((first.size, len(model.turning.coordinates)), dtype=complex)
    places = [model.coordinate(plane, "z") for plane in test.force_plane[first].tolist()]
    drive[np.arange(first.size), places] = force[first]
    image = is_image_line(rows.line)
    place = np.array([model.line_places[name] for name in rows.line.tolist()], dtype=np.intp)
    coordinate = np.array([model.coordinate(plane, "z") for plane in rows.plane.tolist()], dtype=np.intp)
    base = Responses(
        model=model.turning,
        speed=test.speed[first],
        frequency=(test.frequency - test.speed)[first],
        force=drive,
        group=group[first],
        line=line[order],
        coordinate=coordinate + n * place,
        measured=np.where(image, rows.response.conj(), rows.response),
        sigma=rows.sigma,
        label=label[order],
        labels=labels,
        run=rows.run,
    )
    columns = {"speed": rows.speed, "frequency": rows.frequency, "force": force[order]}
    return PairResponses(base=base, **columns, direction=rows.direction, line=rows.line)
