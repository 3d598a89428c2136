"""A virtual rig whose motion is recorded: a rotor integrated in time, with its instruments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from rotorfit.models import RotorModel
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.simulation.instruments import Instruments
from rotorfit.simulation.linear_path import linear_path
from rotorfit.simulation.nonlinear_path import nonlinear_path
from rotorfit.simulation.rig import VirtualRig
from rotorfit.simulation.turning_speeds import Wander

Force = Callable[[Float], ComplexArray]


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordedRig:
    """A rotor with its instruments."""

    virtual: VirtualRig  # the rotor
    instruments: Instruments  # what measures it
    residual: float  # unbalance of the rotor itself, kg m

    def path(
        self, speed: Callable[[Float], Float], force: Callable[[Float], ComplexArray], plane: str, count: int
    ) -> dict[str, ComplexArray]:
        """Motion of each plane under a force at one of them."""
        return self.path_of(speed, {plane: force}, count)

    def path_of(
        self, speed: Callable[[Float], Float], forces: Mapping[str, Callable[[Float], ComplexArray]], count: int
    ) -> dict[str, ComplexArray]:
        """Motion of each plane under forces at several."""
        model, theta = self.virtual.model, self.virtual.theta
        integrated = nonlinear_path if model.eccentricity_dependent else linear_path
        along = [(_along(model, plane), force) for plane, force in forces.items()]

        def generalised(t: Float) -> ComplexArray:
            return np.asarray(sum(spread(force(t)) for spread, force in along))

        path = integrated(model, theta, speed=speed, force=generalised, rate=self.instruments.sample_rate, count=count)
        path = path * model.functions.factors(theta)
        if model.frame == "z":
            return {c.plane: path[:, i] for i, c in enumerate(model.coordinates) if c.axis == "z"}
        axes = {(c.plane, c.axis): path[:, i].real for i, c in enumerate(model.coordinates)}
        return {plane: axes[plane, "x"] + 1j * axes[plane, "y"] for plane in model.planes}

    def shaft(self, speed: float) -> Wander:
        """The shaft's rotation at a speed, rad/s, that wanders as the instruments say."""
        return Wander.drawn(speed, self.instruments.wander, self.rng)

    @property
    def rng(self) -> np.random.Generator:
        """Source of noise and chance."""
        return self.virtual.rng


def _along(model: RotorModel, plane: str) -> Callable[[ComplexArray], ComplexArray]:
    """From a force ``Fx + j Fy`` in time to generalised forces, shape ``(T, n)``."""
    vector = np.zeros(len(model.coordinates), dtype=complex)
    if model.frame == "z":
        vector[model.coordinate(plane, "z")] = 1.0
        return lambda f: f[:, None] * vector
    x, y = model.coordinate(plane, "x"), model.coordinate(plane, "y")

    def apart(f: ComplexArray) -> ComplexArray:
        both = np.zeros((f.size, vector.size), dtype=complex)
        both[:, x], both[:, y] = f.real, f.imag
        return both

    return apart
