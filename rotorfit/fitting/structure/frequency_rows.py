"""Stiffness and damping of a fluid frequency by frequency, as measured, beside the fitted coefficients.

``K(w) + jw C(w)`` is the measured dynamic stiffness less that of the rig. Constant coefficients make ``K - w^2 M`` and
C of it; what leaves their band changes with frequency, as gas seals do.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.estimators.atomic_file import whole_file
from rotorfit.io.tables.result_tables import frame_csv
from rotorfit.models.array_types import Float

if TYPE_CHECKING:
    from pandas import DataFrame

ENTRIES = ("xx", "xy", "yx", "yy")


@dataclass(frozen=True, kw_only=True, eq=False)
class FrequencyCoefficients:
    """Stiffness and damping against frequency in one condition; entries xx, xy, yx, yy along the first axis.

    Attributes:
        condition: its name.
        frequency: rad/s, shape ``(L,)``.
        stiffness, damping: as measured, N/m and N s/m, shape ``(4, L)``.
        stiffness_stderr, damping_stderr: from the noise of readings, forces and dry run.
        fitted_stiffness, fitted_damping: by the fitted coefficients, ``K - w^2 M`` and C.
        fitted_stiffness_stderr, fitted_damping_stderr: their standard errors.
    """

    condition: str
    frequency: Float
    stiffness: Float
    damping: Float
    stiffness_stderr: Float
    damping_stderr: Float
    fitted_stiffness: Float
    fitted_damping: Float
    fitted_stiffness_stderr: Float
    fitted_damping_stderr: Float


@dataclass(frozen=True, eq=False)
class FrequencyRows:
    """Stiffness and damping against frequency of all conditions: see :meth:`FitResult.frequency_coefficients`.

    Attributes:
        rows: one a condition.
    """

    rows: tuple[FrequencyCoefficients, ...]

    def to_dataframe(self) -> DataFrame:
        """A row for each condition and frequency, SI units, ``frequency_hz``."""
        from pandas import DataFrame, concat

        return concat([DataFrame(_columns(row)) for row in self.rows], ignore_index=True)

    def to_csv(self, path: str | Path) -> None:
        """Write the table as CSV.

        Args:
            path: the file.
        """
        with whole_file(Path(path)) as draft:
            draft.write_text(frame_csv(self.to_dataframe()), encoding="utf-8")


def _columns(row: FrequencyCoefficients) -> dict[str, object]:
    found: dict[str, object] = {"condition": row.condition, "frequency_hz": row.frequency / (2 * np.pi)}
    for letter, kind in (("K", "stiffness"), ("C", "damping")):
        for number, entry in enumerate(ENTRIES):
            for prefix in ("", "fitted_"):
                name = f"{prefix}{letter}{entry}"
                found[name] = getattr(row, f"{prefix}{kind}")[number]
                found[f"{name}_stderr"] = getattr(row, f"{prefix}{kind}_stderr")[number]
    return found
