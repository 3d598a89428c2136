"""Tests in which a circular orbit is imposed and the force is measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index, Text
from rotorfit.base.units import UNITS
from rotorfit.estimators.blocks.nonlinear import OrbitResponses
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.lab.data.linear_force import directional, directional_noise
from rotorfit.lab.data.rows import PLACEHOLDER, Experiment
from rotorfit.lab.data.table_columns import FREQUENCY, Column, Layout, noise
from rotorfit.lab.observing.circular import rows_in_words, with_noise
from rotorfit.lab.observing.rows import check_clearance, of_rows
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import journal


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class DisplacementTest(Experiment):
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
    layout: ClassVar[Layout] = Layout(
        columns=(
            Column("frequency", (FREQUENCY,)),
            Column("plane"),
            Column(
                "displacement",
                (("amplitude", "um", UNITS["displacement"]), ("phase", "deg", UNITS["phase"])),
                polar=True,
            ),
            *(
                Column(name, ((name, "N", UNITS["force"]), (f"{name}_phase", "deg", UNITS["phase"])), polar=True)
                for name in ("force_x", "force_y")
            ),
            noise("N", UNITS["force"]),
        ),
        marks=("force_x_", "force_y_"),
        run="",
        known=(
            "run, speed_rpm, frequency_rpm, plane, amplitude_um, phase_deg, force_x_N, force_x_phase_deg, force_y_N, "
            "force_y_phase_deg, optional sigma_N"
        ),
    )
    reads: ClassVar[Literal["motion", "force", ""]] = "force"

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

    def observe(self, model: RotorModel, group: Index) -> Block:
        """See any experiment."""
        return _imposed(model, _observed(self, model, group))

    def unread(self, sigma: Float) -> Experiment:
        """See any experiment."""
        forces = np.full(len(self), PLACEHOLDER)
        turning = np.where(self.frequency < 0, 1j, -1j) * forces
        return replace(self, force_x=forces, force_y=turning, sigma=sigma)


def _observed(test: DisplacementTest, model: RotorModel, group: Index) -> Responses:
    if model.frame != "z":
        raise ValueError(f"{model.name} keeps x and y apart; an imposed circular orbit needs an isotropic model")
    if set(test.planes) - set(model.planes):
        raise ValueError(
            f"{test.source or 'experiment'} has planes {', '.join(test.planes)}; the model {model.name} has "
            f"{', '.join(model.planes)}: map names (planes=, --planes)"
        )
    count = len(test)
    planes, plane = test.category("plane")
    coordinate = np.array([model.coordinate(name, "z") for name in planes], dtype=np.intp)[plane]
    values = np.concatenate([test.force_x, test.force_y])
    rows = np.vstack([np.where(np.isnan(values), -1, np.arange(2 * count)).reshape(2, count), np.full(count, -1)]).T
    right, wrong = directional(values, rows, test.frequency < 0)
    sigma = directional_noise(np.tile(test.sigma, 2), rows)
    where = test.source or "experiment"
    if not np.isfinite(right).all():
        raise ValueError(f"{where}: forces are not all finite")
    if not test.displacement.all():
        raise ValueError(
            f"{where}: the imposed orbit is zero ({rows_in_words(test.displacement == 0)}); these readings have no "
            "dynamic stiffness, remove them"
        )
    imposed = np.zeros((count, len(model.coordinates)), dtype=complex)
    imposed[np.arange(count), coordinate] = np.where(test.frequency < 0, test.displacement.conj(), test.displacement)
    pairs = zip(test.run.tolist(), test.plane.tolist(), strict=True)
    block = Responses(
        **of_rows(model, test, (f"{run} / force at {plane}" for run, plane in pairs)),
        frequency=test.frequency,
        force=imposed,
        group=group,
        line=np.arange(count),
        coordinate=coordinate,
        measured=right,
        sigma=sigma,
        imposed=True,
        sigma_given=not np.isnan(sigma).any(),
    )
    return block if block.sigma_given else with_noise(block, wrong, False)


def _imposed(model: RotorModel, base: Responses) -> Block:
    if not model.eccentricity_dependent:
        return base
    seat = journal(model)
    if (base.coordinate != seat.at).any():
        raise ValueError(
            f"{model.name} changes with the eccentricity at {model.coordinates[seat.at].plane}; a circular orbit has "
            f"to be imposed there, or the eccentricity is not known"
        )
    eps = np.abs(base.force[:, seat.at]) / seat.clearance
    check_clearance(eps, seat.clearance, "imposed orbits")
    return OrbitResponses(base, eps[None], "given", np.arange(eps.size, dtype=np.intp))
