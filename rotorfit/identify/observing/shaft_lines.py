"""From line tests, and perturbation tests of a shaft that is not round, to observations."""

from __future__ import annotations

import numpy as np

from rotorfit.base.array_types import Index
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.blocks.row_keys import distinguished
from rotorfit.estimators.blocks.shaft_lines import LineResponses, PairResponses, is_image_line
from rotorfit.identify.observing.rows import check_finite, of_rows
from rotorfit.lab.data.experiments import LineTest
from rotorfit.models import AnisotropicShaft, RotorModel, Turning, TurningOnSupports
from rotorfit.models.shafts.combination_lines import line_order


def lines_of_test(model: RotorModel, test: LineTest, group: Index) -> LineResponses | PairResponses:
    """Observations of a line test."""
    where = test.source or test.title
    if not isinstance(model, AnisotropicShaft | Turning):
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
    if isinstance(model, AnisotropicShaft):
        for direction, line in dict.fromkeys(zip(test.direction.tolist(), test.line.tolist(), strict=True)):
            line_order(direction, line)
    if isinstance(model, AnisotropicShaft) and model.torsion is None and (test.direction == "twist").any():
        raise ValueError(f"{where} has readings of the twist, the model has none; use AnisotropicShaft() with torsion")
    check_finite(test, test.speed, test.frequency, test.force, test.response)
    if not (test.sigma > 0).all():
        raise ValueError(f"{where}: the noise of {np.sum(~(test.sigma > 0))} readings is not known; give their sigma")
    names = zip(test.run.tolist(), test.plane.tolist(), test.direction.tolist(), test.line.tolist(), strict=True)
    titles = (f"{run} / {'twist' if way == 'twist' else plane} {line}" for run, plane, way, line in names)
    rows = of_rows(model, test, titles)
    if isinstance(model, Turning):
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


def _pairs(model: Turning, test: LineTest, group: Index, label: Index, labels: tuple[str, ...]) -> PairResponses:
    """Readings at w, 2 Om - w and others as responses in turning coordinates."""
    known = [f"z {name}" for name in model.line_places]
    others = sorted(
        {f"{d} {name}" for d, name in zip(test.direction.tolist(), test.line.tolist(), strict=True)} - {*known}
    )
    if others:
        kind = "" if isinstance(model, TurningOnSupports) else " in round supports"
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


def main_lines(model: AnisotropicShaft, base: Responses) -> LineResponses:
    """Responses to circular forces as lines at w, the image at 2 Om - w not having been measured."""
    line = base.line
    synchronous = np.abs(base.frequency - base.speed) <= 1e-4 * np.abs(base.speed)
    if synchronous.any():
        raise ValueError(
            f"{model.name}: at w = Om a line and its image 2 Om - w are one; give synchronous responses as line 1x of "
            "a LineTest, or leave them out"
        )
    return LineResponses(
        model=model,
        speed=base.speed[line],
        frequency=base.frequency[line],
        force=base.force[line, 0],
        direction=np.full(line.size, "z"),
        line=np.full(line.size, "w"),
        reading_group=base.reading_group,
        measured=base.measured,
        sigma=base.sigma,
        label=base.label,
        labels=base.labels,
        run=base.run,
    )
