"""Coefficients of one seal or bearing over several mountings: their mean, and how much a mounting changes them.

Repeats without taking the seal out agree far better than the next mounting will. A coefficient of mounting i is ``y_i =
mu + b_i + e_i``, e_i with the variance of its fit, b_i that of the mountings (random effects; R. Paule and J. Mandel,
J. Res. NBS 87, 1982): the one at which the weighted sum of squares about the mean is its expectation, m - 1.
Its interval is where that sum is a quantile of chi-squared (W. Viechtbauer, Statistics in Medicine 26, 2007), that of
the mean has Student's t (J. Hartung and G. Knapp, Statistics in Medicine 20, 2001).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant
from rotorfit.base.equality import ByValue
from rotorfit.base.text_table import text_table
from rotorfit.identify.fitting.quantities import Quantity
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.structure.coefficients import UNITS, Coefficients, Tabulated
from rotorfit.models.coefficient_tables import COEFFICIENTS

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True, eq=False)
class MountedCoefficient:
    """One coefficient over m mountings."""

    mean: Quantity  # over mountings, its error with their scatter; ``mean.interval()`` has Student's t
    scatter: float  # standard deviation between mountings, beyond the errors of the fits
    scatter_interval: tuple[float, float]  # its 95 % interval
    single: Float  # coefficient and error of each mounting, shape ``(m, 2)``

    def next_mounting(self, level: float = 0.95) -> tuple[float, float]:
        """Interval for the coefficient of a seal that is mounted next, which such intervals hold so often."""
        spread = math.hypot(self.scatter, self.mean.stderr)
        freedom = max(self.mean.freedom - 1, 1.0)  # Higgins, Thompson and Spiegelhalter, J. R. Stat. Soc. A 172, 2009
        return Quantity(self.mean.value, spread, self.mean.unit, freedom).interval(level)


@dataclass(frozen=True, eq=False, repr=False)
class Mountings(ByValue, Tabulated):
    """Coefficients over mountings, condition by condition: see :func:`rotorfit.mountings`.

    Attributes:
        rows: for each condition its name and the coefficients by name.
        count: mountings.
    """

    rows: tuple[tuple[str, Mapping[str, MountedCoefficient]], ...]
    count: int

    def __getitem__(self, condition: str) -> Mapping[str, MountedCoefficient]:
        found = dict(self.rows)
        if condition not in found:
            raise KeyError(f"no condition {condition!r}; there are {', '.join(found)}")
        return found[condition]

    def to_dataframe(self) -> DataFrame:
        """A row for each condition and coefficient: mean, errors, scatter, 95 % intervals, SI units."""
        from pandas import DataFrame

        columns = ["condition", "coefficient", "mean", "stderr", "mean_low", "mean_high"]
        columns += ["scatter", "scatter_low", "scatter_high", "next_low", "next_high"]
        rows = []
        for condition, by_name in self.rows:
            for name, found in by_name.items():
                mean = (found.mean.value, found.mean.stderr, *found.mean.interval())
                scatter = (found.scatter, *found.scatter_interval)
                rows.append((condition, name, *mean, *scatter, *found.next_mounting()))
        return DataFrame(rows, columns=columns)

    def __str__(self) -> str:
        lines = [["condition", "", "mean", "scatter between mountings, 95 %", ""]]
        for condition, by_name in self.rows:
            for name, found in by_name.items():
                low, high = found.scatter_interval
                scatter = f"{significant(found.scatter, 3)}, {significant(low, 3)} to {significant(high, 3)}"
                mean = found.mean.shown().number
                lines.append([condition, name, mean, scatter, found.mean.unit])
        return "\n".join([*text_table(lines, "<16 <4 >22 >34  <6"), f"{self.count} mountings"])

    def __repr__(self) -> str:
        return f"<Mountings: {self.count} of {', '.join(condition for condition, _ in self.rows)}>"


def mountings(fits: Sequence[FitResult], *, plane: str | None = None) -> Mountings:
    """Coefficients of one seal or bearing over several mountings, with the scatter between them as a random effect.

    Args:
        fits: one for each mounting, of the same model and conditions (speeds, or what ``per=`` names).
        plane: name of the plane, where forces were fitted at several.

    Returns:
        for each condition the mean of each coefficient that was fitted, with an error that holds the scatter, the
        scatter with its interval, and the interval for the next mounting.

    Raises:
        ValueError: fewer than two fits, fits of other conditions, or a fit that does not determine a coefficient.

    Example:
        >>> found = rf.mountings([fit, fit])
        >>> found.count
        2
    """
    if len(fits) < 2:
        raise ValueError(
            f"the scatter between mountings needs two fits or more, one for each mounting; got {len(fits)}"
        )
    tables = [{row.condition: row for row in fit.coefficient_table(plane=plane).rows} for fit in fits]
    for number, table in enumerate(tables[1:], 2):
        if set(table) != set(tables[0]):
            raise ValueError(
                f"mounting {number} was tested at {', '.join(table)}, mounting 1 at {', '.join(tables[0])}: give fits "
                "of the same conditions"
            )
    rows = []
    for condition in tables[0]:
        one = [table[condition] for table in tables]
        names = [name for name in COEFFICIENTS if any(row[name].stderr for row in one)]
        rows.append((condition, {name: _over_mountings(name, condition, one) for name in names}))
    return Mountings(tuple(rows), len(fits))


def _over_mountings(name: str, condition: str, rows: Sequence[Coefficients]) -> MountedCoefficient:
    from scipy.stats import chi2  # late: loading it takes longer than a fit

    single = np.array([[row[name].value, row[name].stderr] for row in rows])
    for number, known in enumerate(np.isfinite(single).all(axis=1), 1):
        if not known:
            raise ValueError(f"the data of mounting {number} do not determine {name} at {condition}")
    # What a size rests on alone (gain of the probes) is the same for all mountings, and no scatter between them.
    shared = np.array([0.0 if (error := row[name].error) is None else error.trust for row in rows])
    y, within = single[:, 0], np.maximum(single[:, 1] ** 2 - shared**2, 0.0)
    free = y.size - 1
    between = _variance_at(free, y, within)
    weight = 1 / (between + within)
    mean = float(weight @ y / weight.sum())
    widened = max(1.0, float(weight @ (y - mean) ** 2) / free)
    ends = [math.sqrt(_variance_at(float(chi2.ppf(p, free)), y, within)) for p in (0.975, 0.025)]
    stderr = math.hypot(math.sqrt(widened / float(weight.sum())), float(np.mean(shared)))
    return MountedCoefficient(
        mean=Quantity(mean, stderr, UNITS[name[0]], float(free)),
        scatter=math.sqrt(between),
        scatter_interval=(ends[0], ends[1]),
        single=single,
    )


def _variance_at(wanted: float, y: Float, within: Float) -> float:
    """Variance between mountings at which the weighted sum of squares about the mean is as wanted, zero if none is."""
    from scipy.optimize import brentq  # late: it loads much of SciPy

    def excess(between: float) -> float:
        weight = 1 / (between + within)
        return float(weight @ (y - weight @ y / weight.sum()) ** 2) - wanted

    if excess(0.0) <= 0:
        return 0.0
    high = float(np.sum((y - y.mean()) ** 2)) / wanted  # there the sum is less, whatever the errors within
    return float(brentq(excess, 0.0, high, xtol=1e-12 * high))
