"""How fitted parameters change with the conditions of the runs: weighted straight lines, group by group."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rotorfit.fitting.result import Quantity
from rotorfit.text_table import Wide, text_table

if TYPE_CHECKING:
    from rotorfit.campaigns.runs import RunFit

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Trend:
    """One parameter of one group of runs against an attribute.

    Attributes:
        parameter: name of the parameter.
        unit: its unit.
        against: attribute on the axis.
        group: value of the attribute that makes the group, empty without groups.
        x: attribute, shape ``(R,)``, ascending.
        value, stderr: parameter and its standard error, shape ``(R,)``.
        runs: names of the runs.
        slope: change of the parameter per unit of the attribute, NaN with fewer than two conditions.
        scatter: chi-squared of the runs about the line over its degrees of freedom, NaN with fewer than three runs;
            far above one, the parameter depends on more than this attribute, or not in a straight line.
    """

    parameter: str
    unit: str
    against: str
    group: str
    x: Float
    value: Float
    stderr: Float
    runs: tuple[str, ...]
    slope: Quantity
    scatter: float
    _centre: float
    _coefficients: Float
    _covar: Float

    def at(self, x: float) -> Quantity:
        """Parameter on the line, its error widened where the runs scatter more than their errors say."""
        basis = np.array([1.0, x - self._centre])[: self._coefficients.size]
        variance = float(basis @ self._covar @ basis)
        return Quantity(float(basis @ self._coefficients), float(np.sqrt(variance)), self.unit)


def trend_of(runs: Sequence[RunFit], parameter: str, unit: str, against: str, group: str) -> Trend:
    """Weighted straight line through the runs of one group.

    Args:
        runs: runs with a resolved value of the parameter and a number for the attribute.
        parameter, unit: what is followed.
        against: attribute with numbers.
        group: label of the group.
    """
    ordered = sorted(runs, key=lambda run: float(run.attributes[against]))
    x = np.array([float(run.attributes[against]) for run in ordered])
    value = np.array([run.params[parameter].value for run in ordered])
    stderr = np.array([run.params[parameter].stderr for run in ordered])
    weight = 1 / stderr**2
    centre = float(np.sum(weight * x) / weight.sum())
    columns = 2 if np.ptp(x) > 0 else 1
    design = np.column_stack([np.ones_like(x), x - centre])[:, :columns] / stderr[:, None]
    coefficients, *_ = np.linalg.lstsq(design, value / stderr, rcond=None)
    covar = np.linalg.inv(design.T @ design)
    free = x.size - columns
    scatter = float(np.sum((value / stderr - design @ coefficients) ** 2) / free) if free > 0 else float("nan")
    covar = covar * max(1.0, scatter if free > 0 else 1.0)
    slope = Quantity(float("nan"), float("nan"), f"{unit} per {against}")
    if columns == 2:
        slope = Quantity(float(coefficients[1]), float(np.sqrt(covar[1, 1])), slope.unit)
    names = tuple(run.name for run in ordered)
    return Trend(
        parameter=parameter,
        unit=unit,
        against=against,
        group=group,
        x=x,
        value=value,
        stderr=stderr,
        runs=names,
        slope=slope,
        scatter=scatter,
        _centre=centre,
        _coefficients=coefficients,
        _covar=covar,
    )


def trend_table(trends: Sequence[Trend]) -> str:
    """Slopes of all trends, and the groups of a parameter compared where they were all tested."""
    if not trends:
        return "no run has a resolved value"
    rows: list[list[str | Wide]] = [["parameter", "group", "runs", "slope", "scatter", "at the middle"]]
    for parameter in dict.fromkeys(t.parameter for t in trends):
        mine = [t for t in trends if t.parameter == parameter]
        middle = _middle(mine)
        for t in mine:
            slope = _text(t.slope) if np.isfinite(t.slope.value) else "one condition"
            scatter = f"{t.scatter:.2f}" if np.isfinite(t.scatter) else "-"
            rows.append([parameter, t.group, str(t.x.size), slope, scatter, _text(t.at(middle))])
        rows += [["", Wide(sentence, 5, remark=True)] for sentence in _comparisons(mine, middle)]
    first = trends[0]
    table = text_table(rows, "<10 <1 >6 >26 >9 >26")
    return "\n".join(
        [*table, f"slopes per {first.against}; scatter is chi-squared per degree of freedom about the line"]
    )


def _middle(trends: Sequence[Trend]) -> float:
    """Middle of the range that all groups cover, of the whole range where they do not overlap."""
    low, high = max(t.x[0] for t in trends), min(t.x[-1] for t in trends)
    if low > high:
        low, high = min(t.x[0] for t in trends), max(t.x[-1] for t in trends)
    return float(low + high) / 2


def _comparisons(trends: Sequence[Trend], middle: float) -> list[str]:
    sentences = []
    for i, first in enumerate(trends):
        for second in trends[i + 1 :]:
            a, b = first.at(middle), second.at(middle)
            error = float(np.hypot(a.stderr, b.stderr))
            sentences.append(
                f"{second.group} - {first.group} at {first.against} = {middle:.4g}: "
                f"{b.value - a.value:.4g} +- {error:.2g} {first.unit} ({abs(b.value - a.value) / error:.1f} s.e.)"
            )
    return sentences


def _text(quantity: Quantity) -> str:
    return f"{quantity.value:.5g} +- {quantity.stderr:.2g}"
