"""Description of a parameter by its model."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Parameter:
    """One physical parameter of a model.

    Attributes:
        name: symbol of the paper, for instance ``K0`` or ``lam``.
        unit: SI unit, ``"1"`` for a ratio.
        meaning: a few words for tables and reports.
        scale: typical size in ``unit``, used where data give none.
        lower, upper: physical limits, infinite where physics sets none.
        default: value used when the parameter is neither known nor asked to be fitted, ``None`` to fit it.
        nominal: value that convention gives it where data cannot (sigma = 1), offered in advice.
    """

    name: str
    unit: str
    meaning: str
    scale: float = 1.0
    lower: float = -math.inf
    upper: float = math.inf
    default: float | None = None
    nominal: float | None = None

    def __post_init__(self) -> None:
        if not self.scale > 0:
            raise ValueError(f"parameter {self.name}: scale must be positive, got {self.scale}")
        if not self.lower < self.upper:
            raise ValueError(f"parameter {self.name}: lower limit {self.lower} is not below upper {self.upper}")

    @property
    def frequency_power(self) -> int:
        """Power with which it grows where all frequencies of a rotor grow and its masses stay: 2 for a stiffness."""
        above, _, below = self.unit.partition("/")
        times = {"N": 2, "s": -1, "s^2": -2}
        powers = [sum(times.get(unit, 0) for unit in part.split()) for part in (above, below)]
        return powers[0] - powers[1]


MATRIX_UNITS = {"K": "N/m", "M": "kg", "D": "N s/m"}
"""Units of the entries of stiffness, mass and damping matrices."""


def bare_name(name: str) -> str:
    """Name of a parameter without its group: ``K0`` of ``K0[speed_rpm=1000]``."""
    return name.partition("[")[0]
