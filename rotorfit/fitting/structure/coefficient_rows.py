"""Coefficients of a fitted bearing or seal as engineers tabulate them, with errors and correlations."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.estimators.atomic_file import whole_file
from rotorfit.fitting.quantities import Quantity
from rotorfit.io.tables.result_tables import frame_csv
from rotorfit.models.array_types import Float
from rotorfit.models.digits import plus_minus, significant
from rotorfit.models.parameters import unknown_name
from rotorfit.models.shafts.plane_forces import COEFFICIENTS
from rotorfit.models.text_table import Printed, text_table
from rotorfit.units import RPM_PER_RAD_S

if TYPE_CHECKING:
    from pandas import DataFrame

UNITS = {"K": "N/m", "C": "N s/m", "M": "kg"}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Coefficients:
    """Stiffness, damping and inertia of the force at a plane at one speed: see :meth:`FitResult.coefficients`.

    ``F = K r + C r' + M r''`` with r = (x, y), F what the rotor exerts on the fluid; positive Kxy and negative Kyx
    drive forward whirl.

    Attributes:
        speed: rotative speed, rad/s.
        condition: the speed in words, after what else parameters were fitted per: ``pressure_bar=5, 3000 rpm``.
        group: number of the parameter group.
        plane: name of the plane.
        values: Kxx, Kxy, Kyx, Kyy, Cxx, ... Myy, SI units, shape ``(12,)``.
        covariance: of these, shape ``(12, 12)``; infinite on the diagonal where the data do not determine one.
        by_name: each with its standard error.
        propagated: the error of a quantity from its value, its slopes by ``values`` and its unit.
    """

    speed: float
    condition: str
    group: int
    plane: str
    values: Float
    covariance: Float
    by_name: Mapping[str, Quantity]
    propagated: Callable[[float, Float, str], Quantity]

    def __getitem__(self, name: str) -> Quantity:
        if name not in self.by_name:
            raise KeyError(unknown_name("coefficient", name, COEFFICIENTS))
        return self.by_name[name]

    @cached_property
    def correlation(self) -> Float:
        """Correlations of the coefficients, zero beside one that is known, shape ``(12, 12)``."""
        size = np.sqrt(np.diag(self.covariance))
        scale = np.outer(size, size)
        good = (scale > 0) & np.isfinite(scale)
        found = np.divide(self.covariance, scale, out=np.zeros_like(scale), where=good)
        np.fill_diagonal(found, 1.0)
        return np.asarray(found)

    @property
    def whirl_frequency_ratio(self) -> Quantity:
        """Whirl frequency over speed at which the force alone would let a mass whirl, by Lund's formula.

        ``k = (Kxx Cyy + Kyy Cxx - Cyx Kxy - Cxy Kyx) / (Cxx + Cyy)``, its square over the speed's being ``((k - Kxx)
        (k - Kyy) - Kxy Kyx) / (Cxx Cyy - Cxy Cyx)``; Kxy / (Cxx Om) of an isotropic force without inertia. NaN where
        the square is negative (no whirl) and at standstill.
        """

        def ratio(v: Float) -> float:
            (kxx, kxy, kyx, kyy), (cxx, cxy, cyx, cyy) = v[:4], v[4:8]
            determinant = cxx * cyy - cxy * cyx
            if not (cxx + cyy and determinant and self.speed):
                return math.nan
            k = (kxx * cyy + kyy * cxx - cyx * kxy - cxy * kyx) / (cxx + cyy)
            square = ((k - kxx) * (k - kyy) - kxy * kyx) / determinant / self.speed**2
            return math.sqrt(square) if square >= 0 else math.nan

        return self._of(ratio, "1")

    def effective_stiffness(self, frequency: float) -> Quantity:
        """Stiffness that forward circular whirl meets, N/m: Re of the dynamic stiffness at a frequency.

        Args:
            frequency: of the whirl, rad/s, negative for backward whirl.
        """
        w = frequency

        def stiffness(v: Float) -> float:
            return float((v[0] + v[3]) + w * (v[5] - v[6]) - w**2 * (v[8] + v[11])) / 2

        return self._of(stiffness, "N/m")

    def effective_damping(self, frequency: float) -> Quantity:
        """Damping that forward circular whirl meets, N s/m: Im of the dynamic stiffness over the frequency.

        Args:
            frequency: of the whirl, rad/s, negative for backward whirl, not zero.

        Raises:
            ValueError: a frequency of zero.
        """
        w = frequency
        if w == 0:
            raise ValueError("effective damping is that of whirl at a frequency; at zero there is none")

        def damping(v: Float) -> float:
            return float((v[4] + v[7]) - (v[1] - v[2]) / w + w * (v[9] - v[10])) / 2

        return self._of(damping, "N s/m")

    def _of(self, function: Callable[[Float], float], unit: str) -> Quantity:
        """A quantity of the coefficients; its slopes by central differences, exact for what is at most quadratic."""
        value = function(self.values)
        if not math.isfinite(value):
            return Quantity(math.nan, math.nan, unit)
        step = 1e-6 * np.repeat([np.abs(self.values[k : k + 4]).max() or 1.0 for k in (0, 4, 8)], 4)
        moved = [[function(self.values + sign * own) for sign in (1, -1)] for own in np.diag(step)]
        slopes = np.array([(up - down) / (2 * size) for (up, down), size in zip(moved, step.tolist(), strict=True)])
        return self.propagated(value, slopes, unit)

    def __repr__(self) -> str:
        return f"<Coefficients at {self.plane}, {significant(self.speed * RPM_PER_RAD_S, 4)} rpm>"

    def __str__(self) -> str:
        return "\n".join(table_of([self]))


@dataclass(frozen=True, eq=False, repr=False)
class CoefficientRows(Printed):
    """Coefficients at several speeds: see :meth:`FitResult.coefficient_table`.

    Attributes:
        rows: one a speed.
    """

    rows: tuple[Coefficients, ...]

    def to_dataframe(self) -> DataFrame:
        """A row a condition: ``speed_rpm``, coefficients in SI units, ``<name>_stderr``, ``whirl_frequency_ratio``."""
        from pandas import DataFrame

        return DataFrame([_columns(row) for row in self.rows])

    def to_csv(self, path: str | Path) -> None:
        """Write the table as CSV.

        Args:
            path: the file.
        """
        with whole_file(Path(path)) as draft:
            draft.write_text(frame_csv(self.to_dataframe()), encoding="utf-8")

    def __str__(self) -> str:
        return "\n".join(table_of(self.rows))


def _columns(row: Coefficients) -> dict[str, Any]:
    found: dict[str, Any] = {
        "plane": row.plane,
        "condition": row.condition,
        "speed_rpm": round(row.speed * RPM_PER_RAD_S, 6),
    }
    for name in (*COEFFICIENTS, "whirl_frequency_ratio"):
        own = row[name] if name in COEFFICIENTS else row.whirl_frequency_ratio
        found |= {name: own.value, f"{name}_stderr": own.stderr}
    return found


def table_of(rows: Sequence[Coefficients]) -> list[str]:
    """Lines of a table, one column a speed."""
    heads = ["", *[row.condition for row in rows], ""]
    lines = [heads]
    for name in COEFFICIENTS:
        if any(row[name].value or row[name].stderr for row in rows):
            lines.append([name, *[_shown(row[name]) for row in rows], UNITS[name[0]]])
    lines.append(["whirl frequency ratio", *[_shown(row.whirl_frequency_ratio) for row in rows], "1"])
    return text_table(lines, "<22" + " >22" * len(rows) + "  <6")


def _shown(found: Quantity) -> str:
    if math.isnan(found.value):
        return "none"
    if found.stderr == 0:
        return f"{found.value:.6g} known"
    if not math.isfinite(found.stderr):
        return "not determined"
    return plus_minus(found.value, found.stderr)
