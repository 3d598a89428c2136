"""How fitted parameters change with the conditions of the runs: weighted lines and polynomials, group by group."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import Polynomial

from rotorfit.base.array_types import COLLINEAR, Float, Index
from rotorfit.base.digits import plus_minus, significant
from rotorfit.base.text_table import Wide, text_table
from rotorfit.estimators.inference.covariance import standard_error, widening
from rotorfit.estimators.inference.wandering import walk, wandering
from rotorfit.identify.fitting.quantities import Quantity
from rotorfit.lab.data.findings import listed

if TYPE_CHECKING:
    from rotorfit.studies.campaigns.runs import RunFit


LARGEST_SCATTER = 4.0
"""Scatter about a line up to which it explains the runs, and from which single ones are looked at."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Trend:
    """One parameter of one group of runs against an attribute."""

    parameter: str  # name of the parameter
    unit: str  # its unit
    against: str  # attribute on the axis
    group: str  # value of the attribute that makes the group, empty without groups
    x: Float  # attribute, shape ``(R,)``, ascending
    # value, stderr: parameter and its standard error, shape ``(R,)``; of several attributes, less what the others do
    value: Float
    stderr: Float
    runs: tuple[str, ...]  # names of the runs
    # change of the parameter per unit of the attribute, NaN with fewer than two conditions; of a curve that at the mean
    # of all runs
    slope: Quantity
    # chi-squared of the runs about the line over its degrees of freedom, NaN with no more runs than coefficients; far
    # above one, the parameter depends on more than this attribute, or in another curve
    scatter: float
    step: float  # by which the parameter wanders from one run to the next, in their order, beside its errors
    _centre: float
    _coefficients: Float  # of the powers of the distance from the centre
    _covar: Float

    @property
    def coefficients(self) -> tuple[Quantity, ...]:
        """Of the powers of the attribute, the constant first; their errors are correlated."""
        shift = _powers(-self._centre, 1.0, self.degree)
        errors = np.sqrt(np.diag(shift @ self._covar @ shift.T))
        units = (f"{self.unit} per {self.against}^{k}".removesuffix("^1") for k in range(1, errors.size))
        values = (shift @ self._coefficients).tolist()
        return tuple(map(Quantity, values, errors.tolist(), (self.unit, *units)))

    @property
    def degree(self) -> int:
        """Degree of the polynomial, zero with one condition."""
        return self._coefficients.size - 1

    @property
    def words(self) -> str:
        """The polynomial as it is written: ``radial: K0 = 2000 +- 30 + (3.1 +- 0.2) flow + (0.40 +- 0.02) flow^2``."""
        first, *others = self.coefficients
        terms = [
            f"({plus_minus(c.value, c.stderr)}) {self.against}{'' if k == 1 else f'^{k}'}"
            for k, c in enumerate(others, 1)
        ]
        name = f"{self.group}: {self.parameter}".removeprefix(": ")
        return " + ".join([f"{name} = {plus_minus(first.value, first.stderr)}", *terms])

    @property
    def far(self) -> tuple[str, ...]:
        """Runs far from where most lie, by the repeated medians of Siegel 1982, which they do not pull along."""
        if not self.scatter > LARGEST_SCATTER:
            return ()
        from scipy.stats import siegelslopes  # late: loading it takes longer than a trend

        slope, level = siegelslopes(self.value, self.x) if np.ptp(self.x) > 0 else (0.0, np.median(self.value))
        off = np.abs(self.value - level - slope * self.x)
        usual_share = 0.75  # share of the runs whose distances from the line count as usual
        usual = np.quantile(off, usual_share)  # of a bent trend too, whose ends are further off than most
        # Distance from the line over the usual one and the run's own error, from which a run is named
        outlying_distance = 6.0
        return tuple(np.array(self.runs)[off > outlying_distance * np.hypot(usual, self.stderr)].tolist())

    def at(self, x: float) -> Quantity:
        """Parameter at a value of the attribute, its error widened where the runs scatter more than their errors
        say, and where neighbours go together."""
        basis = np.power(x - self._centre, np.arange(self._coefficients.size), dtype=float)
        error = float(standard_error(basis, self._covar))
        return Quantity(float(basis @ self._coefficients), error, self.unit)


def trends_of(
    runs: Sequence[RunFit], parameter: str, unit: str, against: Sequence[str], group: str, centre: Float, degree: int
) -> list[Trend]:
    """Weighted sum of polynomials through the runs of one group, one trend for each attribute with the others held at
    ``centre``. Values of a trend are those of the runs less what the other attributes' polynomials say of them."""
    x = np.array([[float(run.attributes[name]) for name in against] for run in runs])
    value = np.array([run.params[parameter].value for run in runs])
    stderr = np.array([run.params[parameter].stderr for run in runs])
    away = x - centre
    surface = _surface(away, value, stderr, degree)
    if surface is None:
        which = f"the runs{f' with {group}' if group else ''}"
        if len(against) > 1:
            raise ValueError(
                f"{which} do not tell {', '.join(against)} apart: they change together, or there are too few runs; "
                "give fewer of them"
            )
        raise ValueError(
            f"{which} do not give {parameter} a polynomial of degree {degree}: that needs {degree + 1} values of "
            f"{against[0]} well apart, there are {np.unique(x).size}; give a lower degree"
        )
    attribute, coefficients_of_all, covar_of_all, scatter, step = surface
    found = []
    for k, name in enumerate(against):
        chosen = np.r_[0, np.flatnonzero(attribute == k)]
        coefficients, covar = coefficients_of_all[chosen], covar_of_all[np.ix_(chosen, chosen)]
        slope = (coefficients[1], np.sqrt(covar[1, 1])) if chosen.size > 1 else (np.nan, np.nan)
        order = np.argsort(x[:, k], kind="stable")
        others = np.flatnonzero((attribute >= 0) & (attribute != k))  # powers of the other attributes, ascending
        powers = away[:, attribute[others]] ** np.tile(np.arange(1, degree + 1), others.size // degree)
        adjusted = value - powers @ coefficients_of_all[others]
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
                slope=Quantity(float(slope[0]), float(slope[1]), f"{unit} per {name}"),
                scatter=scatter,
                step=step,
                _centre=float(centre[k]),
                _coefficients=coefficients,
                _covar=covar,
            )
        )
    return found


def _surface(x: Float, value: Float, stderr: Float, degree: int) -> tuple[Index, Float, Float, float, float] | None:
    """A constant and a polynomial in each attribute, ``(R, A)`` and counted from the centre, through the values of
    runs: which attribute each coefficient belongs to, -1 for the constant; the value at the centre, then coefficients
    of the powers of each attribute that changes, ascending; their covariance, widened where the runs scatter more than
    their errors say, and by a walk from run to run; chi-squared over the degrees of freedom, NaN where none are left;
    the step of the walk. ``None`` where the terms cannot be separated."""
    spread, middle = np.ptp(x, axis=0), x.mean(axis=0)
    moving = np.flatnonzero(spread > COLLINEAR * np.abs(x).max(axis=0))
    attribute, power = np.repeat(moving, degree), np.tile(np.arange(1, degree + 1), moving.size)
    own = (x[:, attribute] - middle[attribute]) / spread[attribute]
    design = np.column_stack([np.ones(len(x)), own**power]) / stderr[:, None]
    if np.linalg.matrix_rank(design / np.linalg.norm(design, axis=0), tol=1e-6) < design.shape[1]:
        return None
    coefficients, *_ = np.linalg.lstsq(design, value / stderr, rcond=None)
    free = design.shape[0] - design.shape[1]
    scatter = float(np.sum((value / stderr - design @ coefficients) ** 2) / free) if free > 0 else float("nan")
    attribute = np.r_[-1, attribute]
    to_centre = np.eye(design.shape[1])
    for k in moving:
        mine = np.flatnonzero(attribute == k)
        to_centre[np.ix_(np.r_[0, mine], mine)] = _powers(-middle[k] / spread[k], 1 / spread[k], degree)[:, 1:]
    covar = np.linalg.inv(design.T @ design) * widening(scatter, "linear")
    step, onto = wandering(design * stderr[:, None], value, stderr), np.linalg.pinv(design) / stderr
    covar = to_centre @ (covar + step * onto @ walk(len(x)) @ onto.T) @ to_centre.T
    return attribute, to_centre @ coefficients, covar, scatter, float(np.sqrt(step))


def _powers(shift: float, scale: float, degree: int) -> Float:
    """Column k holds the coefficients of ``(shift + scale x)^k`` in powers of x."""
    linear = Polynomial([shift, scale])
    return np.array([np.pad((linear**k).coef, (0, degree - k)) for k in range(degree + 1)]).T


def common_middle(trends: Sequence[Trend]) -> float:
    """Middle of the range that all groups cover, of the whole range where they do not overlap."""
    low, high = max(t.x[0] for t in trends), min(t.x[-1] for t in trends)
    if low > high:
        low, high = min(t.x[0] for t in trends), max(t.x[-1] for t in trends)
    return float(low + high) / 2


def trend_table(trends: Sequence[Trend]) -> str:
    """Slopes of all trends, and the groups of a parameter compared where they were all tested."""
    if not trends:
        return "no run has a resolved value"
    names = list(dict.fromkeys(t.against for t in trends))
    rows: list[list[str | Wide]] = [["parameter", "group", "against", "runs", "slope", "scatter", "at the middle"]]
    for parameter, against in dict.fromkeys((t.parameter, t.against) for t in trends):
        mine = [t for t in trends if (t.parameter, t.against) == (parameter, against)]
        middle = common_middle(mine)
        for t in mine:
            slope = plus_minus(t.slope.value, t.slope.stderr) if np.isfinite(t.slope.value) else "one condition"
            scatter = f"{t.scatter:.2f}" if np.isfinite(t.scatter) else "-"
            at = t.at(middle)
            rows.append([parameter, t.group, against, str(t.x.size), slope, scatter, plus_minus(at.value, at.stderr)])
        remarks = [*(t.words for t in mine if t.degree > 1), *_comparisons(mine, middle)]
        with_group = [(f" with {t.group}" if t.group else "", t.far) for t in mine]
        remarks += [f"far from the line of the others{which}: {listed(far)}" for which, far in with_group if far]
        rows += [["", Wide(sentence, 6, remark=True)] for sentence in remarks]
    table = text_table(rows, "<10 <1 <1 >6 >26 >9 >26")
    held = ", each with the others held" if len(names) > 1 else ""
    where = ", at the mean of the runs" if any(t.degree > 1 for t in trends) else ""
    return "\n".join(
        [*table, f"slopes per {' and per '.join(names)}{held}{where}; scatter is chi-squared per degree of freedom"]
    )


def _comparisons(trends: Sequence[Trend], middle: float) -> list[str]:
    sentences = []
    for i, first in enumerate(trends):
        for second in trends[i + 1 :]:
            a, b = first.at(middle), second.at(middle)
            error = float(np.hypot(a.stderr, b.stderr))
            unit = "" if first.unit == "1" else f" {first.unit}"
            sentences.append(
                f"{second.group} - {first.group} at {first.against} = {significant(middle, 4)}: "
                f"{plus_minus(b.value - a.value, error)}{unit} ({abs(b.value - a.value) / error:.1f} s.e.)"
            )
    return sentences
