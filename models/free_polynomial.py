"""Any linear rotor with as many modes as its planes allow: matrices without a rotor behind them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.models.complexes import J
from rotorfit.models.model import Matrix, RotorModel
from rotorfit.models.parameters import Parameter


class FreePolynomial(RotorModel):
    """Dynamic stiffness ``M s^2 + C s + K`` with any complex C and K and one mass at each plane.

    It is complete for rotors whose planes move in as many modes forward and backward: operating vibration of n planes
    gives 2n eigenvalues with errors, :meth:`FitResult.modes`, without a rotor model. Its numbers hold at one speed. The
    masses are no rotor's: spectra of forces that nobody measured leave them open, and they are 1 kg unless given.

    Args:
        planes: names of the measured planes.
    """

    name: ClassVar[str] = "free-polynomial"
    has_causes = False
    at_one_speed = True
    leads = ("frequencies", "least damping")

    def __init__(self, planes: Sequence[str] = ("disk", "journal")) -> None:
        self.planes = (planes,) if isinstance(planes, str) else tuple(planes)
        if not self.planes or len(set(self.planes)) != len(self.planes):
            raise ValueError(
                f"free-polynomial needs at least one plane, each with a name of its own; got {self.planes}"
            )
        self.parameters = (
            *(Parameter(f"M_{plane}", "kg", f"mass of {plane}", lower=0.0, default=1.0) for plane in self.planes),
            *(
                Parameter(f"{letter}_{row}_{column}{part}", unit, f"{what} of {row} by motion of {column}", scale)
                for letter, unit, what, scale in (("C", "N s/m", "damping", 100.0), ("K", "N/m", "stiffness", 1e4))
                for row in self.planes
                for column in self.planes
                for part in ("", "_im")
            ),
        )

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """See :meth:`RotorModel.equation`."""
        names = [[f"{row}_{column}" for column in self.planes] for row in self.planes]
        C, K = (
            [[getattr(p, f"{letter}_{name}") + J * getattr(p, f"{letter}_{name}_im") for name in row] for row in names]
            for letter in "CK"
        )
        masses = [getattr(p, f"M_{plane}") for plane in self.planes]
        M = [[mass if i == j else 0.0 for j in range(len(masses))] for i, mass in enumerate(masses)]
        return K, C, M

    def with_modes(self, s: ComplexArray, shapes: ComplexArray) -> Float | None:
        """See :meth:`RotorModel.with_modes`."""
        n = len(self.planes)
        if shapes.shape != (n, 2 * n):
            return None
        both = -(shapes * s**2) @ np.linalg.inv(np.concatenate([shapes, shapes * s]))
        return self.with_matrices(both[:, n:], both[:, :n])

    def with_matrices(self, C: ComplexArray, K: ComplexArray) -> Float:
        """Parameters of the rotor with masses of 1 kg.

        Args:
            C, K: matrices of damping and stiffness over these masses, shape ``(n, n)``.
        """
        parts = (np.ascontiguousarray(matrix).reshape(-1).view(float) for matrix in (C, K))
        return np.concatenate([np.ones(len(self.planes)), *parts])
