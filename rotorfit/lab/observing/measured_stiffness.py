"""Measured dynamic stiffness, frequency by frequency (eqs 5 and 7), without any model of the rotor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from rotorfit.estimators.starting.force_balance import StiffnessMatrices, stiffness_matrices
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.several_forces import refuse_several
from rotorfit.lab.observing.circular import observe
from rotorfit.models import Anisotropic, RotorModel
from rotorfit.models.model import Coordinate


class IsotropicPlanes(RotorModel):
    """Coordinates ``z`` of some planes, for observing a test of a rotor of which nothing is known."""

    name: ClassVar[str] = "isotropic planes"
    parameters = ()

    def __init__(self, planes: Sequence[str], tilts: Sequence[str] = ()) -> None:
        self.planes = tuple(planes)
        self._tilts = tuple(tilts)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Displacement of every plane, then the slopes at those that have them."""
        return (*(Coordinate(p, "z") for p in self.planes), *(Coordinate(p, "r") for p in self._tilts))

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> list[list[list[float]]]:
        """Unit stiffness; only the coordinates are used."""
        return [np.eye(len(self.coordinates)).tolist()]


def dynamic_stiffness(
    test: PerturbationTest, planes: Sequence[str] | None = None, *, isotropic: bool = True
) -> StiffnessMatrices:
    """Invert the measured responses to the dynamic stiffness matrix at every frequency (eq. 7).

    Args:
        test: responses with the force at each of the planes in turn.
        planes: planes in the order of the rows, by default those of the test.
        isotropic: combine each x/y pair to the component in the force's direction (n planes, signed frequency);
            otherwise keep x and y apart (2n coordinates x then y, forward and backward runs together, frequency
            positive).

    Returns:
        frequencies and speeds in rad/s, kappa of shape ``(N, n, n)`` or ``(N, 2n, 2n)`` in N/m, and its standard
        deviation from the propagated noise.

    Raises:
        ValueError: no frequency at which all planes were forced and measured; the message says what is missing.

    Example:
        >>> measured = rf.dynamic_stiffness(rig, planes=["disk", "journal"])
        >>> measured.kappa.shape[1:]
        (2, 2)
    """
    names = tuple(planes or test.planes)
    model: RotorModel = IsotropicPlanes(names) if isotropic else Anisotropic(names)
    refuse_several(test, "the inversion by eq. (7)")
    chosen = test.select(np.isin(test.plane, names) & np.isin(test.force_plane, names))
    if not len(chosen):
        raise ValueError(f"no readings at planes {', '.join(names)} under a force there; the test has {test.planes}")
    result = stiffness_matrices(observe(model, chosen, np.zeros(len(chosen), dtype=np.intp)))
    if not result.frequency.size:
        reason = _why_none(chosen, names, isotropic=isotropic)
        raise ValueError(f"eq. (7) needs a force at each of the planes {', '.join(names)} in turn: {reason}")
    order = np.lexsort([result.frequency, result.speed])
    return StiffnessMatrices(
        frequency=result.frequency[order],
        speed=result.speed[order],
        kappa=result.kappa[order],
        sigma=result.sigma[order],
        first_line=result.first_line[order],
    )


def _why_none(test: PerturbationTest, planes: tuple[str, ...], *, isotropic: bool) -> str:
    """The cause where no frequency gives a matrix."""
    unforced = sorted(set(planes) - set(test.force_planes))
    if unforced:
        return f"no force at {', '.join(unforced)}"
    w = test.frequency if isotropic else np.abs(test.frequency)
    lines = [set(np.round(w[test.force_plane == plane], 6).tolist()) for plane in planes]
    if not set.intersection(*lines):
        return "the runs have no frequency in common"
    return (
        "the responses at their common frequencies are singular or incomplete: the forces move the planes in proportion"
        if isotropic
        else "x and y have to be read under a forward and a backward force at one frequency"
    )
