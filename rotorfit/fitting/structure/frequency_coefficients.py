"""Stiffness and damping of a fluid frequency by frequency, as measured, beside the fitted coefficients.

``K(w) + jw C(w)`` is the measured dynamic stiffness less that of the rig. Constant coefficients make ``K - w^2 M`` and
C of it; what leaves their band changes with frequency, as gas seals do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.estimators.inference.covariance import standard_error
from rotorfit.estimators.starting.force_balance import stiffness_matrices
from rotorfit.fitting.structure.coefficients import Tabulated, coefficient_rows, of_a_rig
from rotorfit.models.array_types import Float

if TYPE_CHECKING:
    from pandas import DataFrame

    from rotorfit.fitting.result import FitResult


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
class FrequencyRows(Tabulated):
    """Stiffness and damping against frequency of all conditions: see :meth:`FitResult.frequency_coefficients`.

    Attributes:
        rows: one a condition.
    """

    rows: tuple[FrequencyCoefficients, ...]

    def to_dataframe(self) -> DataFrame:
        """A row for each condition and frequency, SI units, ``frequency_hz``."""
        from pandas import DataFrame, concat

        tables = []
        for row in self.rows:
            columns: dict[str, object] = {"condition": row.condition, "frequency_hz": row.frequency / (2 * np.pi)}
            for letter, kind in (("K", "stiffness"), ("C", "damping")):
                for (number, entry), prefix in product(enumerate(ENTRIES), ("", "fitted_")):
                    name = f"{prefix}{letter}{entry}"
                    columns[name] = getattr(row, f"{prefix}{kind}")[number]
                    columns[f"{name}_stderr"] = getattr(row, f"{prefix}{kind}_stderr")[number]
            tables.append(DataFrame(columns))
        return concat(tables, ignore_index=True)


def frequency_coefficients_of(fit: FitResult, speeds: Sequence[float] | None) -> FrequencyRows:
    """See :meth:`FitResult.frequency_coefficients`."""
    if not of_a_rig(fit) or fit.model.frame == "z" or len(fit.model.coordinates) != 2:
        raise ValueError(
            "stiffness and damping against frequency are those of a seal or bearing alone, forced and read along x and "
            f"y: fit Anisotropic of one plane, with the rig taken out (baseline, stator_mass_kg); not {fit.model.name}"
        )
    found = []
    for at in coefficient_rows(fit, speeds, None).rows:
        for block in fit.problem.responses:
            whole = stiffness_matrices(block)
            mine = np.abs(whole.speed - at.speed) <= 1e-3 * max(at.speed, 1.0)
            mine &= block.group[whole.first_line] == at.group
            w = whole.frequency[mine]
            if not w.size:
                continue
            beside = 0.0 if block.beside is None else block.beside[whole.first_line[mine]]
            kappa = (whole.kappa[mine] - beside).reshape(-1, 4).T
            sigma = whole.sigma[mine].reshape(-1, 4).T
            slopes = np.zeros((4, w.size, 12))
            for entry in range(4):
                slopes[entry, :, entry] = 1.0
                slopes[entry, :, 8 + entry] = -(w**2)
            found.append(
                FrequencyCoefficients(
                    condition=at.condition,
                    frequency=w,
                    stiffness=kappa.real,
                    damping=kappa.imag / w,
                    stiffness_stderr=sigma,
                    damping_stderr=sigma / w,
                    fitted_stiffness=slopes @ at.values,
                    fitted_stiffness_stderr=standard_error(slopes, at.covariance),
                    fitted_damping=np.repeat(at.values[4:8, None], w.size, axis=1),
                    fitted_damping_stderr=np.repeat(np.sqrt(np.diag(at.covariance)[4:8])[:, None], w.size, axis=1),
                )
            )
    if not found:
        raise ValueError(
            "no line was forced and read along both axes, or forward and backward, so that its stiffness cannot be "
            "measured by itself; force both ways at the same frequencies and speeds"
        )
    return FrequencyRows(tuple(found))


def measured_by_frequency(fit: FitResult) -> bool:
    """True if some line was forced and read along both axes, so that it has a stiffness of its own."""
    return any(stiffness_matrices(block).frequency.size for block in fit.problem.responses)
