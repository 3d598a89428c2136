"""The budget of a fit: what the error of each number is made of, as the GUM asks for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.digits import two_digits, with_error
from rotorfit.base.equality import ByValue
from rotorfit.base.names import unknown_name
from rotorfit.base.significance import quantile
from rotorfit.base.text_table import Table, Tabled
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.identify.fitting.causes.slopes import onset_slopes
from rotorfit.identify.fitting.propagation import covariance_of
from rotorfit.identify.fitting.quantities import Quantity
from rotorfit.identify.fitting.result import FitResult

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True)
class BudgetRow:
    """One result with the shares of its error, which add up as squares.

    Attributes:
        name, value, unit: the result.
        stderr: its standard error.
        noise: share by the noise of the readings (GUM type A).
        bounded: share by causes that had to be found from the data.
        on_trust: share by the size that each cause is given before the data (type B), by name.
        slopes: change of the result by a unit of each cause, the fitted values following it, by name.
        low, high: ends of the 95 % interval.
        freedom: degrees of freedom of the standard error, infinite where the noise is known.
    """

    name: str
    value: float
    unit: str
    stderr: float
    noise: float
    bounded: float
    on_trust: dict[str, float]
    slopes: dict[str, float]
    low: float
    high: float
    freedom: float = math.inf

    @property
    def trust(self) -> float:
        """Share by all sizes given before the data."""
        return math.hypot(*self.on_trust.values())

    @property
    def systematic(self) -> float:
        """Share by all causes."""
        return math.hypot(self.bounded, self.trust)

    @property
    def coverage(self) -> float:
        """Coverage factor of 95 %: 1.96, or that of Student's t where few readings tell the noise."""
        return quantile(0.95, self.freedom)


@dataclass(frozen=True, repr=False, eq=False)
class Budget(ByValue, Tabled):
    """Budget of a fit.

    Attributes:
        rows: one a result: fitted parameters, then the threshold speed.
        correlation: of the results, causes included, shape ``(n, n)``.
    """

    rows: tuple[BudgetRow, ...]
    correlation: Float

    def __getitem__(self, name: str) -> BudgetRow:
        for row in self.rows:
            if row.name == name:
                return row
        raise KeyError(unknown_name("result", name, [row.name for row in self.rows]))

    @property
    def main_causes(self) -> tuple[str, ...]:
        """Causes on trust that are at least a tenth of the variance of some result, the weightiest first."""
        least = 0.1
        weight: dict[str, float] = {}
        for row in self.rows:
            for name, share in row.on_trust.items():
                weight[name] = max(weight.get(name, 0.0), (share / row.stderr) ** 2 if row.stderr else 0.0)
        return tuple(sorted((n for n, w in weight.items() if w >= least), key=lambda n: -weight[n]))

    def to_dataframe(self) -> DataFrame:
        """A row a result, a column a share."""
        from pandas import DataFrame

        return DataFrame(
            [
                {**{n: v for n, v in vars(row).items() if n not in ("on_trust", "slopes")}, **row.on_trust}
                for row in self.rows
            ]
        )

    def parts(self) -> list[str | Table]:
        """What is printed."""
        causes = self.main_causes
        lines = [["", "value", "+-", "noise", "bounded", *causes, "unit"]]
        for row in self.rows:
            shares = (row.noise, row.bounded, *(abs(row.on_trust.get(name, 0.0)) for name in causes))
            value, error = with_error(row.value, row.stderr)
            lines.append([row.name, value, error, *map(two_digits, shares), row.unit])
        return [Table(lines, " ".join(["<18 >12 >10 >10 >10", *[">10"] * len(causes), "<1"]))]


def budget_of(fit: FitResult) -> Budget:
    """The budget of a fit, from its errors share by share."""
    names = [name for name in fit.problem.space.names if fit.params[name].resolved]
    rows, solved = [_row(name, fit.params[name]._quantity) for name in names], fit.settings.solved
    slopes = np.eye(fit.x.size)[[fit.var_names.index(name) for name in names]]
    by_causes = np.zeros((len(names), len(solved.causes) if solved else 0))
    if fit.model.speed_dependent and len(fit.thetas) == 1 and fit.success:
        onset = fit.threshold_speed()
        if math.isfinite(onset.value) and math.isfinite(onset.stderr):
            rows.append(_row("threshold speed", onset, RPM_PER_RAD_S, "rpm"))
            there = fit.onset(0)
            own = np.zeros(fit.x.size) if there is None else fit.problem.space.pull_back(there.gradient, 0)
            beside = (
                onset_slopes(fit.model, fit.theta(), there, solved)
                if solved and there
                else np.zeros(by_causes.shape[1])
            )
            slopes, by_causes = np.vstack([slopes, own]), np.vstack([by_causes, beside])
    covariance = covariance_of(fit, slopes, by_causes)
    error = np.sqrt(np.diag(covariance))
    scale = np.outer(error, error)
    correlation = np.divide(covariance, scale, out=np.eye(len(rows)), where=scale > 0)
    return Budget(tuple(rows), correlation)


def _row(name: str, found: Quantity, scale: float = 1.0, unit: str = "") -> BudgetRow:
    low, high = (scale * end for end in found.interval(0.95))
    bar = found.error
    return BudgetRow(
        name=name,
        value=scale * found.value,
        unit=unit or found.unit,
        stderr=scale * found.stderr,
        noise=scale * (found.stderr if bar is None else bar.noise),
        bounded=0.0 if bar is None else scale * bar.bounded,
        on_trust={} if bar is None else {cause: scale * share for cause, share in bar.on_trust.items()},
        slopes={} if bar is None else {cause: scale * slope for cause, slope in bar.slopes.items()},
        low=low,
        high=high,
        freedom=found.freedom,
    )
