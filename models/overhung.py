"""Overhung rotor with a strong gyroscopic effect (Figs 30 to 32)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

from rotorfit.models.complexes import J
from rotorfit.models.model import Coordinate, Matrix, RotorModel
from rotorfit.models.one_mode import one_per_coordinate
from rotorfit.models.parameters import Parameter
from rotorfit.models.probes import probe_parameters


class Overhung(RotorModel):
    """Disk displacement z and tilt phi = dx/ds + j dy/ds of an overhung disk.

    ``kappa = [[k11 + j w d1 - M w^2, k12], [k12, k22 + j w d2 + Om w Ip - It w^2]]``. At zero speed Ip is not
    observable.

    Args:
        planes: name of the disk plane.
        coupling_mass: allow for ``-w^2 m12`` beside k12, which a shaft with mass leaves when condensed to the disk.
        betas: a factor of the disk's probe, ``beta1``, known to be 1 unless freed.
    """

    name: ClassVar[str] = "overhung"
    caveats_without_tilts = (
        "without readings of the tilt the data hold k12 squared only: its sign is a convention, that of its start, "
        "positive unless start={'k12': ...}, bounds or known= say otherwise",
    )

    def __init__(self, planes: Sequence[str] = ("disk",), *, coupling_mass: bool = False, betas: bool = False) -> None:
        self.betas = betas
        self.coupling_mass = coupling_mass
        self.planes = one_per_coordinate(planes, 1, self.name)
        self.parameters = (
            Parameter("M", "kg", "disk mass", scale=5.0, lower=0.0),
            Parameter("It", "kg m^2", "transverse moment of inertia", scale=0.1, lower=0.0),
            Parameter("Ip", "kg m^2", "polar moment of inertia", scale=0.2, lower=0.0),
            Parameter("k11", "N/m", "stiffness, force for displacement", scale=1e5),
            Parameter("k12", "N", "coupling stiffness, force for tilt", scale=1e4),
            Parameter("k22", "N m", "stiffness, moment for tilt", scale=1e4),
            Parameter("d1", "N s/m", "damping of the displacement", scale=10.0),
            Parameter("d2", "N m s", "damping of the tilt", scale=1.0),
            *(
                (Parameter("m12", "kg m", "coupling mass of displacement and tilt", scale=0.1),)
                if coupling_mass
                else ()
            ),
            *(probe_parameters(self.planes, ()) if betas else ()),
        )

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Displacement and tilt of the disk."""
        return Coordinate(self.planes[0], "z"), Coordinate(self.planes[0], "r")

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """See :meth:`RotorModel.equation`."""
        stiffness = [[p.k11, p.k12], [p.k12, p.k22]]
        damping = [[p.d1, 0.0], [0.0, p.d2 - J * (p.Ip * speed)]]
        m12 = p.m12 if self.coupling_mass else 0.0
        mass = [[p.M, m12], [m12, p.It]]
        return stiffness, damping, mass
