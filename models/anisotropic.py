"""The general anisotropic rotor with n measuring planes (eqs 1 to 9)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Literal

from rotorfit.models.model import Matrix, RotorModel
from rotorfit.models.one_mode import one_per_coordinate
from rotorfit.models.parameters import MATRIX_UNITS, Parameter

_MEANING = {"K": "stiffness", "D": "damping", "M": "inertia"}
_SCALE = {"K": 1e4, "D": 10.0, "M": 1.0}


class Anisotropic(RotorModel):
    """Full stiffness, damping and inertia matrices of eq. (1) in x and y at n planes.

    ``Kxy_12`` is the force in x at plane 1 for a displacement in y at plane 2; with one plane the index is left out.

    Args:
        planes: names of the measuring planes.
    """

    name: ClassVar[str] = "anisotropic"
    frame: Literal["z", "xy"] = "xy"

    def __init__(self, planes: Sequence[str] = ("journal",)) -> None:
        names = (planes,) if isinstance(planes, str) else tuple(planes)
        self.planes = one_per_coordinate(names, max(len(names), 1), self.name)
        self.parameters = tuple(
            Parameter(self._entry(kind, row, column), MATRIX_UNITS[kind], _MEANING[kind] + " coefficient", _SCALE[kind])
            for kind in "KDM"
            for row in range(2 * len(names))
            for column in range(2 * len(names))
        )

    def _entry(self, kind: str, row: int, column: int) -> str:
        count = len(self.planes)
        (q, r), (p, s) = divmod(row, count), divmod(column, count)
        separator = "" if count < 10 else "_"
        index = "" if count == 1 else f"_{r + 1}{separator}{s + 1}"
        return f"{kind}{'xy'[q]}{'xy'[p]}{index}"

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """See :meth:`RotorModel.equation`."""
        size = range(2 * len(self.planes))
        return [[[getattr(p, self._entry(kind, row, column)) for column in size] for row in size] for kind in "KDM"]
