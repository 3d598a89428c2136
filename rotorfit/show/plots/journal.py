"""A fit's data and its model at the journal alone, however many planes the rotor has."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index, Text
from rotorfit.base.significance import CHANCE_ERRORS
from rotorfit.estimators.blocks.nonlinear import OrbitResponses
from rotorfit.estimators.blocks.observations import Block
from rotorfit.estimators.blocks.response import probe_factors
from rotorfit.identify.fitting.headline import rig_name
from rotorfit.identify.fitting.propagation import stderr_of
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.summary import natural
from rotorfit.models import RotorModel
from rotorfit.models.coefficient_tables import law_changes_with_speed
from rotorfit.models.motion.journal import journal, line_stiffness


@dataclass(frozen=True, eq=False, kw_only=True)
class JournalLines:
    """Measured motion of the journal under circular forces or constant loads, and the fit's, all shape ``(L,)``."""

    group: Index  # parameter group of each line
    run: Text  # run of each line
    speed: Float  # rad/s
    frequency: Float  # rad/s, zero under constant loads
    force: ComplexArray  # largest force of the line, N
    position: ComplexArray  # measured amplitude, or position, of the journal, the probe's factor taken out, m
    sigma: Float  # its noise
    eccentricity: Float  # measured
    fitted_eccentricity: Float  # that of the fit
    stiffness: ComplexArray
    stiffness_sigma: Float  # its noise
    linear: ComplexArray  # what the fitted model has there at zero eccentricity


def journal_lines(fit: FitResult, *, static: bool) -> Iterator[JournalLines]:
    """Lines of each block in which the journal was measured.

    With h the drive-point receptance of the centred rotor and ``A0 = (H F)_b`` its response, the journal's drive-point
    stiffness is ``A0 / (h A_b)``: it is force over response where the journal itself is forced.
    """
    for block in fit.problem.blocks:
        base = block.responses
        if base is None or base.imposed or not isinstance(block, OrbitResponses):
            continue
        seat = journal(fit.model)
        rows = np.flatnonzero((base.coordinate == seat.at) & ((base.frequency[base.line] == 0) == static))
        if not rows.size:
            continue
        line, theta = base.line[rows], fit.thetas
        vectors, w, speed = theta[base.group[line]], base.frequency[line], base.speed[line]
        H = fit.model.receptance(vectors, w, speed)
        h, force = H[:, seat.at, seat.at], base.force[line]
        factor = probe_factors(base, theta)[rows]
        centred, position = np.einsum("lj,lj->l", H[:, seat.at], force), base.measured[rows] / factor
        sigma = base.sigma[rows] / np.abs(factor)
        stiffness = centred / (h * position)
        yield JournalLines(
            group=base.group[line],
            run=base.run[rows],
            speed=speed,
            frequency=w,
            force=force[np.arange(line.size), np.argmax(np.abs(force), axis=1)],
            position=position,
            sigma=sigma,
            eccentricity=np.abs(position) / seat.clearance,
            fitted_eccentricity=block.orbits(theta)[0, line],
            stiffness=stiffness,
            stiffness_sigma=sigma * np.abs(stiffness / position),
            linear=1 / h,
        )


def drive_stiffness(
    model: RotorModel, theta: Float, s: complex | ComplexArray, speed: float, eccentricity: Float
) -> tuple[ComplexArray, ComplexArray]:
    """Drive-point stiffness of the journal, other planes free, and its derivatives by the parameters.

    Returns:
        N/m, shape ``(E,)``, and ``(E, P)``.
    """
    at, graph = journal(model).at, line_stiffness(model)
    w, speeds = np.broadcast_to(s, eccentricity.shape).imag, np.full(eccentricity.size, speed)
    H = model.receptance(np.tile(theta, (eccentricity.size, 1)), w, speeds, eccentricity)
    value = 1 / H[:, at, at]
    slope = np.zeros((theta.size + 1, eccentricity.size), dtype=complex)
    by_kappa = graph.slopes(theta, w, speeds, eccentricity)
    for place, row, column, part in zip(graph.inputs, graph.rows, graph.columns, by_kappa, strict=True):
        # d(1/H_bb) = H_b. dkappa H_.b / H_bb^2
        slope[place] += H[:, at, row] * H[:, column, at] * value**2 * part
    return np.asarray(value), slope[:-1].T


def half_width(fit: FitResult, group: int, slope: Float, by_causes: Float) -> Float:
    """Half-width of the 95 % band of a quantity, shape ``(E,)``, by its derivatives by the parameters, ``(E, P)``, and
    by the sizes of the causes that act on the rotor, the parameters held, ``(E, k)``."""
    return CHANCE_ERRORS * stderr_of(fit, fit.problem.space.pull_back(slope, group), by_causes)


def eccentricities(fit: FitResult) -> Float:
    """Eccentricities that the data have, NaN where the journal was not read."""
    found = [np.zeros(0)]
    for block in fit.problem.blocks:
        found.append(block.measured_eccentricity(fit.thetas))
    return np.concatenate(found)


def reach(fit: FitResult) -> float:
    """Largest eccentricity that the data have."""
    largest = float(np.nanmax(eccentricities(fit), initial=0.0))
    if largest <= 0:
        raise ValueError("no data of this fit tell an eccentricity of the journal: there is nothing to plot")
    return largest


def rig_of(fit: FitResult) -> str:
    """The rig's name for matplotlib, as titles begin."""
    from rotorfit.show.plots.style import literal  # loads matplotlib, which a report without figures does not

    return literal(rig_name(fit))


def group_label(fit: FitResult, group: int) -> str:
    """``attribute=value`` of a parameter group, empty where there is but one; values from files hold any characters."""
    return ", ".join(fit.problem.space.labels[group])


def groups_in_order(fit: FitResult) -> list[int]:
    """Parameter groups, sorted by the numbers in their labels."""
    return sorted(range(len(fit.problem.space.index)), key=lambda group: natural(group_label(fit, group)))


def law_series(fit: FitResult) -> list[tuple[int, float | None]]:
    """Curves that the law of a fit has: parameter group and speed, rad/s, None for a law that no speed changes."""
    groups = groups_in_order(fit)
    if not law_changes_with_speed(fit.model):
        return [(group, None) for group in groups]
    found: list[tuple[int, float | None]] = []
    for group in groups:
        tested = np.unique(np.round(np.concatenate([speeds_of(block, group) for block in fit.problem.blocks]), 2))
        shown = np.unique(np.linspace(0, tested.size - 1, 5).round().astype(int))  # of a start-up a few
        found += [(group, float(speed)) for speed in tested[shown]]
    return found


def speeds_of(block: Block, group: int) -> Float:
    """Rotative speeds of the readings of a group, rad/s."""
    source: Any = block.responses or block
    line = getattr(source, "line", np.arange(np.size(source.speed)))
    return np.asarray(source.speed[line][block.reading_group == group], dtype=float)
