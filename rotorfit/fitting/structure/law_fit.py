"""A law of eccentricity from a table of coefficients alone, without a rotor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorfit.data.experiments import CoefficientTable
from rotorfit.fitting.fit import fit
from rotorfit.fitting.result import FitResult
from rotorfit.models import Law, OneMode
from rotorfit.models.array_types import Float


def fit_law(law: Law, table: CoefficientTable, *, per: Sequence[str] = ("K0", "D", "Mf"), by: str = "run") -> FitResult:
    """Fit a law of eccentricity to tabulated bearing or seal coefficients.

    The exponents or factors of the law and lam are shared by all rows; the parameters in ``per`` have a value for
    each run. By default a run is one speed of one seal, since computed and measured K0 and D change with speed.

    Args:
        law: the law, for instance ``rf.models.Muszynska()``.
        table: the coefficients.
        per: parameters that take one value for each value of ``by``.
        by: attribute of the table, or ``"run"``.

    Raises:
        KeyError: unknown parameter or attribute.
        ValueError: coefficients that are not finite or of unknown accuracy.

    Example:
        >>> table = rf.datasets.seal_muszynska_tum()
        >>> law = rf.fit_law(rf.models.Muszynska(), table)
        >>> round(law.params["n_K"].value, 3)
        2.0
    """
    # The eccentricities are ratios already: any clearance serves.
    model = OneMode(law=law, clearance_um=1.0)
    K0, D, Mf, lam = (float(np.median(column)) for column in _at_smallest_eccentricity(table))
    start = {"K0": K0, "D": D, "Mf": Mf, "lam": lam} | law.start(K0, D)
    nothing: dict[str, float | None] = {"M": 0.0, "K": 0.0, "Ds": 0.0}
    return fit(model, table, known=nothing, per=dict.fromkeys(per, by), start=start)


def _at_smallest_eccentricity(table: CoefficientTable) -> tuple[Float, ...]:
    """K0, D, Mf and lam by eq. (13) of the rows nearest to the centre."""
    rows = table.select(table.eccentricity == table.eccentricity.min())
    lam = rows.kxy / (rows.cxx * rows.speed)
    return rows.kxx + rows.mxx * (lam * rows.speed) ** 2, rows.cxx, rows.mxx, lam
