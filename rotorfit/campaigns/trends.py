"""How fitted parameters change with the conditions of the runs: weighted straight lines, group by group."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.data.findings import listed
from rotorfit.estimators.inference.covariance import standard_error, widening
from rotorfit.fitting.digits import plus_minus
from rotorfit.fitting.quantities import Quantity
from rotorfit.models.array_types import Float, Index
from rotorfit.models.text_table import Wide, text_table

if TYPE_CHECKING:
    from rotorfit.campaigns.runs import RunFit

_LARGEST_SCATTER = 4.0
"""Scatter about the line from which single runs are looked at."""
_USUAL_SHARE = 0.75
"""Share of the runs whose distances from the line count as usual."""
_OUTLYING_DISTANCE = 6.0
"""Distance from the line over the usual one and the run's own error, from which a run is named."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Trend:
    """One parameter of one group of runs against an attribute.

    Attributes:
        parameter: name of the parameter.
        unit: its unit.
        against: attribute on the axis.
        group: value of the attribute that makes the group, empty without groups.
        x: attribute, shape ``(R,)``, ascending.
        value, stderr: parameter and its standard error, shape ``(R,)``; of several attributes, less what the others do.
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

    @property
    def far(self) -> tuple[str, ...]:
        """Runs far from where most lie, by the repeated medians of Siegel 1982, which they do not pull along."""
        if not self.scatter > _LARGEST_SCATTER:
            return ()
        from scipy.stats import siegelslopes  # late: loading it takes longer than a trend

        slope, level = siegelslopes(self.value, self.x) if np.ptp(self.x) > 0 else (0.0, np.median(self.value))
        off = np.abs(self.value - level - slope * self.x)
        usual = np.quantile(off, _USUAL_SHARE)  # of a bent trend too, whose ends are further off than most
        return tuple(np.array(self.runs)[off > _OUTLYING_DISTANCE * np.hypot(usual, self.stderr)].tolist())

    def at(self, x: float) -> Quantity:
        """Parameter at a value of the attribute, its error widened where the runs scatter more than their errors
        say."""
        basis = np.array([1.0, x - self._centre])[: self._coefficients.size]
        error = float(standard_error(basis, self._covar))
        return Quantity(float(basis @ self._coefficients), error, self.unit)


def trends_of(
    runs: Sequence[RunFit], parameter: str, unit: str, against: Sequence[str], group: str, centre: Float
) -> list[Trend]:
    """Weighted plane through the runs of one group, one trend for each attribute with the others held at ``centre``.
    Values of a trend are those of the runs less what the other attributes' slopes say of them."""
    x = np.array([[float(run.attributes[name]) for name in against] for run in runs])
    value = np.array([run.params[parameter].value for run in runs])
    stderr = np.array([run.params[parameter].stderr for run in runs])
    plane = _plane(x - centre, value, stderr)
    if plane is None:
        raise ValueError(
            f"the runs{f' with {group}' if group else ''} do not tell {', '.join(against)} apart: they change "
            "together, or there are too few runs; give fewer of them"
        )
    slopes = np.zeros(len(against))
    slopes[plane.moving] = plane.coefficients[1:]
    found = []
    for k, name in enumerate(against):
        others = np.where(np.arange(len(against)) == k, 0.0, slopes)
        place = plane.moving.tolist().index(k) + 1 if k in plane.moving else 0
        chosen = [0, place] if place else [0]
        slope = (float(slopes[k]), float(np.sqrt(plane.covar[place, place]))) if place else (float("nan"),) * 2
        order = np.argsort(x[:, k], kind="stable")
        adjusted = value - (x - centre) @ others
        found.append(
            Trend(
                parameter=parameter,
                unit=unit,
                against=name,
                group=group,
                x=x[order, k],
                value=adjusted[order],
                stderr=stderr[order],
                runs=tuple(runs[i].name for i in order),
                slope=Quantity(*slope, f"{unit} per {name}"),
                scatter=plane.scatter,
                _centre=float(centre[k]),
                _coefficients=plane.coefficients[chosen],
                _covar=plane.covar[np.ix_(chosen, chosen)],
            )
        )
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class _Plane:
    """A plane through the values of runs."""

    moving: Index  # attributes that change, and so have a slope
    coefficients: Float  # value at the centre, then the slopes, shape ``(m + 1,)``
    covar: Float  # their covariance, widened where the runs scatter more than their errors say
    scatter: float  # chi-squared over the degrees of freedom, NaN where none are left


def _plane(x: Float, value: Float, stderr: Float) -> _Plane | None:
    """The plane over attributes ``(R, A)``, counted from the centre; ``None`` where several cannot be separated."""
    spread = np.ptp(x, axis=0)
    moving = np.flatnonzero(spread > 0)
    design = np.column_stack([np.ones(len(x)), x[:, moving] / spread[moving]]) / stderr[:, None]
    if np.linalg.matrix_rank(design / np.linalg.norm(design, axis=0), tol=1e-6) < design.shape[1]:
        if x.shape[1] > 1:
            return None
        moving, design = moving[:0], design[:, :1]
    coefficients, *_ = np.linalg.lstsq(design, value / stderr, rcond=None)
    free = design.shape[0] - design.shape[1]
    scatter = float(np.sum((value / stderr - design @ coefficients) ** 2) / free) if free > 0 else float("nan")
    size = np.concatenate([[1.0], 1 / spread[moving]])
    covar = np.linalg.inv(design.T @ design) * widening(scatter, "linear") * np.outer(size, size)
    return _Plane(moving=moving, coefficients=coefficients * size, covar=np.asarray(covar), scatter=scatter)


def trend_table(trends: Sequence[Trend]) -> str:
    """Slopes of all trends, and the groups of a parameter compared where they were all tested."""
    if not trends:
        return "no run has a resolved value"
    names = list(dict.fromkeys(t.against for t in trends))
    rows: list[list[str | Wide]] = [["parameter", "group", "against", "runs", "slope", "scatter", "at the middle"]]
    for parameter, against in dict.fromkeys((t.parameter, t.against) for t in trends):
        mine = [t for t in trends if (t.parameter, t.against) == (parameter, against)]
        middle = _middle(mine)
        for t in mine:
            slope = plus_minus(t.slope.value, t.slope.stderr) if np.isfinite(t.slope.value) else "one condition"
            scatter = f"{t.scatter:.2f}" if np.isfinite(t.scatter) else "-"
            at = t.at(middle)
            rows.append([parameter, t.group, against, str(t.x.size), slope, scatter, plus_minus(at.value, at.stderr)])
        rows += [["", Wide(sentence, 6, remark=True)] for sentence in (*_comparisons(mine, middle), *_far(mine))]
    table = text_table(rows, "<10 <1 <1 >6 >26 >9 >26")
    held = ", each with the others held" if len(names) > 1 else ""
    return "\n".join(
        [*table, f"slopes per {' and per '.join(names)}{held}; scatter is chi-squared per degree of freedom"]
    )


def _middle(trends: Sequence[Trend]) -> float:
    """Middle of the range that all groups cover, of the whole range where they do not overlap."""
    low, high = max(t.x[0] for t in trends), min(t.x[-1] for t in trends)
    if low > high:
        low, high = min(t.x[0] for t in trends), max(t.x[-1] for t in trends)
    return float(low + high) / 2


def _far(trends: Sequence[Trend]) -> list[str]:
    return [
        f"far from the line of the others{f' with {t.group}' if t.group else ''}: {listed(t.far)}"
        for t in trends
        if t.far
    ]


def _comparisons(trends: Sequence[Trend], middle: float) -> list[str]:
    sentences = []
    for i, first in enumerate(trends):
        for second in trends[i + 1 :]:
            a, b = first.at(middle), second.at(middle)
            error = float(np.hypot(a.stderr, b.stderr))
            unit = "" if first.unit == "1" else f" {first.unit}"
            sentences.append(
                f"{second.group} - {first.group} at {first.against} = {middle:.4g}: "
                f"{plus_minus(b.value - a.value, error)}{unit} ({abs(b.value - a.value) / error:.1f} s.e.)"
            )
    return sentences
