"""Fits of the same data side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.base.accessors import Accessor
from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant
from rotorfit.base.equality import ByValue
from rotorfit.base.text_table import Table, Tabled
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.data.rows import Experiment

if TYPE_CHECKING:
    from pandas import DataFrame

_ERRORS = "errors include causes beside the models; fit.params[name].noise is the share by the noise"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Comparison(ByValue, Tabled):
    """Fits of the same data, see :func:`compare`.

    Attributes:
        fits: by the name under which they are shown, the smallest AIC first.
        weights: Akaike weight of each, the share of ``exp(-AIC/2)``.
    """

    fits: Mapping[str, FitResult]
    weights: Mapping[str, float]

    plot = Accessor()

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that any of the fits estimates."""
        return tuple(dict.fromkeys(p.name for fit in self.fits.values() for p in fit.params.values() if p.vary))

    def to_dataframe(self) -> DataFrame:
        """A row a fit: AIC, weight, redchi, then values, standard errors and systematic shares.

        Example:
            >>> list(rf.compare([fit]).to_dataframe().columns[:3])
            ['fit', 'model', 'fitted']
        """
        from pandas import DataFrame

        rows = []
        for name, fit in self.fits.items():
            row = {"fit": name, "model": fit.model.name, "fitted": fit.nvarys, "redchi": fit.redchi, "aic": fit.aic}
            row |= {"bic": fit.bic, "weight": self.weights[name], "success": fit.success}
            for parameter in self.parameters:
                p = fit.params.get(parameter)
                parts = {"": "value", "_stderr": "stderr", "_systematic": "systematic"}
                row |= {f"{parameter}{end}": getattr(p, part, np.nan) for end, part in parts.items()}
            rows.append(row)
        return DataFrame(rows)

    def parts(self) -> list[str | Table]:
        """What is printed."""
        best = min(fit.aic for fit in self.fits.values())
        rows = [["", *self.fits], ["fitted values", *(str(fit.nvarys) for fit in self.fits.values())]]
        rows.append(["redchi", *(significant(fit.redchi, 4) for fit in self.fits.values())])
        rows.append(["AIC - smallest", *(f"{fit.aic - best:.1f}" for fit in self.fits.values())])
        rows.append(["Akaike weight", *(f"{self.weights[name]:.3f}" for name in self.fits)])
        for parameter in self.parameters:
            rows.append([parameter, *(_shown(fit, parameter) for fit in self.fits.values())])
        width = max(22, *(len(name) + 1 for name in self.fits))
        table = Table(rows, "<16 " + " ".join([f">{width}"] * len(self.fits)))
        failed = [name for name, fit in self.fits.items() if not fit.success]
        shares = [] if not any(fit.causes.rows for fit in self.fits.values()) else [_ERRORS]
        return [table, *shares, *(f"{name} did not converge" for name in failed)]


def compare(fits: FitResult | Sequence[FitResult] | Mapping[str, FitResult]) -> Comparison:
    """Fits of the same data side by side: AIC, weights, parameters.

    Args:
        fits: results of :func:`rotorfit.fit`, or by the names under which they are shown; by default these are the
            models' names.

    Raises:
        TypeError: something that is no fit.
        ValueError: no fits, or fits of different data or with different losses, whose AIC cannot be compared.

    Example:
        >>> both = rf.compare({"as printed": fit, "again": fit})
        >>> both.weights["again"]
        0.5
    """
    several = (fits,) if isinstance(fits, FitResult) else fits
    given = tuple(several.values() if isinstance(several, Mapping) else several)
    for fit in given:
        if not isinstance(fit, FitResult):
            raise TypeError(f"compare takes results of rf.fit, or of rf.load_fit(path), not {type(fit).__name__}")
    named = dict(zip(several, given, strict=True)) if isinstance(several, Mapping) else _named(given)
    if not named:
        raise ValueError("there are no fits to compare")
    base, first = next(iter(named.items()))
    for name, fit in named.items():
        if not _same_data(first, fit):
            raise ValueError(f"{name} is a fit of other data than {base}: their AIC cannot be compared")
        if fit.problem.loss != first.problem.loss:
            raise ValueError(
                f"{name} was fitted with loss {fit.problem.loss}, {base} with {first.problem.loss}: their AIC cannot "
                "be compared"
            )
    order = sorted(named, key=lambda name: named[name].aic)
    aic: Float = np.array([named[name].aic for name in order])
    weights = np.exp(-(aic - aic[0]) / 2)
    shares = (weights / weights.sum()).tolist()
    return Comparison(fits={name: named[name] for name in order}, weights=dict(zip(order, shares, strict=True)))


def _named(fits: Sequence[FitResult]) -> dict[str, FitResult]:
    """Fits by the names of their models, numbered where these are the same."""
    names = [fit.model.name for fit in fits]
    return {
        name if names.count(name) == 1 else f"{name} {i}": fit
        for i, (name, fit) in enumerate(zip(names, fits, strict=True), 1)
    }


def _same_data(one: FitResult, other: FitResult) -> bool:
    """True if both were fitted to the same readings: the numeric columns hold the same numbers."""
    if one.ndata != other.ndata or len(one.experiments) != len(other.experiments):
        return False

    def same(a: Experiment, b: Experiment) -> bool:
        if a is b or type(a) is not type(b):
            return a is b
        columns = ((v, vars(b)[n]) for n, v in vars(a).items() if isinstance(v, np.ndarray) and v.dtype.kind in "fc")
        return all(isinstance(w, np.ndarray) and np.array_equal(v, w, equal_nan=True) for v, w in columns)

    return all(map(same, one.experiments, other.experiments))


def _shown(fit: FitResult, name: str) -> str:
    p = fit.params.get(name)
    if p is None:
        return ""
    return p.shown().number if p.vary else f"{p.shown().number} known"
