"""Random and systematic uncertainty apart: the budget of a fit (GUM type A and type B)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant, with_error
from rotorfit.base.text_table import Printed, Wide, text_table
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.inference.covariance import spreading, standard_error
from rotorfit.identify.fitting.assumptions.calibration import NUISANCE_KINDS, Calibration
from rotorfit.identify.fitting.fit import solve_again
from rotorfit.identify.fitting.judge import inverse_curvature
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.result import FitResult
from rotorfit.models.parameters import bare_name

PRIORS, STRUCTURE = "priors", "structure"


@dataclass(frozen=True, kw_only=True)
class Share:
    """Standard uncertainty of one quantity, by origin."""

    name: str  # name, unit, value: the quantity
    unit: str
    value: float
    random: float  # from the noise of the readings (type A), widened as ``stderr`` is
    systematic: float  # from calibration and other knowledge from before (type B)
    combined: float  # root of the sum of both squares; ``stderr`` of the fit
    # systematic part by source: each nuisance entry, "priors" for those of parameters, "structure" for the choice among
    # candidate models
    sources: Mapping[str, float]

    @property
    def notable(self) -> dict[str, float]:
        """Standard uncertainty by source, zero where it is nothing beside the combined one."""
        negligible_share = 1e-4  # share of the combined uncertainty that a table shows as zero
        return {
            source: part if part > negligible_share * self.combined else 0.0 for source, part in self.sources.items()
        }

    def times(self, factor: float, unit: str) -> Share:
        """The same in another unit."""
        numbers = {name: factor * getattr(self, name) for name in ("value", "random", "systematic", "combined")}
        sources = {source: factor * part for source, part in self.sources.items()}
        return replace(self, unit=unit, sources=sources, **numbers)


def _alike(name: str, unit: str, value: float, size: float) -> Share:
    """Shares without sources, all of one size."""
    return Share(name=name, unit=unit, value=value, random=size, systematic=size, combined=size, sources={})


@dataclass(frozen=True, eq=False, repr=False)
class Budget(Printed):
    """Uncertainty budget.

    Every error, of a reading or of a calibration, moves the estimate by its sensitivity times its size. With ``H`` the
    curvature of the cost, ``I`` the information of the readings and ``P`` that of the priors, ``H = I + P``, the
    covariance ``inv(H)`` is the sum ``inv(H) I inv(H) + inv(H) P inv(H)``: type A and type B. With a robust loss the
    scatter of the slopes stands for the ``I`` in the middle.

    Attributes:
        fit: the fit with the errors of calibration as nuisance entries.
        calibration: their uncertainties.
    """

    fit: FitResult
    calibration: Calibration

    @cached_property
    def _sources(self) -> dict[str, Float]:
        """Change of the estimate for an error of one standard deviation, source by source, shape ``(p, k)``."""
        fit, names = self.fit, self.fit.var_names
        first, moved = len(fit.problem.space.names), inverse_curvature(fit)
        columns: dict[str, list[Float]] = {}
        between = [] if fit.settings.noise is None else [n for e in fit.settings.noise.effects for n in e.names]
        for prior in fit.problem.priors:
            if names[prior.entry] in between:  # what differs from run to run is random
                continue
            curvature = prior.terms(float(fit.x[prior.entry]))[2]
            source = names[prior.entry] if prior.entry >= first else PRIORS
            columns.setdefault(source, []).append(moved[:, prior.entry] * math.sqrt(curvature))
        if fit.model_uncertainty is not None:
            size = np.sqrt(np.diag(fit.covar)[:first])
            size = np.where(size > 0, size, 1.0)
            own = size[:, None] * spreading(fit.model_uncertainty / np.outer(size, size))
            columns[STRUCTURE] = list(np.pad(own, ((0, fit.x.size - first), (0, 0))).T)
        return {source: np.column_stack(parts) for source, parts in columns.items()}

    @cached_property
    def systematic(self) -> Float:
        """Covariance of type B, shape ``(p, p)``."""
        parts = list(self._sources.values())
        return np.asarray(sum(part @ part.T for part in parts))

    @property
    def random(self) -> Float:
        """Covariance of type A, shape ``(p, p)``."""
        return self.fit.covar - self.systematic

    def share(self, name: str) -> Share:
        """Shares of a fitted parameter or nuisance entry.

        Args:
            name: of a fitted parameter or nuisance entry, ``"lam"``.

        Raises:
            ValueError: nothing of that name was fitted.
        """
        if name not in self.fit.var_names:
            raise ValueError(f"{name} was not fitted; the budget has {', '.join(self.fit.var_names)}")
        p = self.fit.params[name]
        slope = np.zeros(self.fit.x.size)
        slope[self.fit.var_names.index(name)] = 1.0
        return self._share(name, p.unit, p.value, slope, p.resolved)

    def threshold_speed(self, at: Mapping[str, Any] | None = None) -> Share:
        """Shares of the threshold speed, rad/s; NaN where the rotor is stable at every speed searched.

        Args:
            at: group of parameters, ``{"speed_rpm": 1000}``; needed where some were fitted per attribute.
        """
        fit = self.fit
        group = fit.group(at)
        onset = fit.onset(group)
        if onset is None:
            return _alike("threshold speed", "rad/s", math.nan, math.nan)
        slope = fit.problem.space.pull_back(onset.gradient, group)
        resolved = math.isfinite(fit.threshold_of(group).stderr)
        return self._share("threshold speed", "rad/s", onset.speed, slope, resolved)

    def _share(self, name: str, unit: str, value: float, slope: Float, resolved: bool) -> Share:
        if not resolved:
            return _alike(name, unit, value, math.inf)
        sources = {source: float(np.linalg.norm(slope @ part)) for source, part in self._sources.items()}
        total = float(standard_error(slope, self.fit.covar)) ** 2
        systematic = min(sum(part**2 for part in sources.values()), total)
        return Share(
            name=name,
            unit=unit,
            value=value,
            random=math.sqrt(total - systematic),
            systematic=math.sqrt(systematic),
            combined=math.sqrt(total),
            sources=sources,
        )

    @property
    def shares(self) -> dict[str, tuple[float, float]]:
        """Random and systematic standard uncertainty of each fitted parameter, as ``write_report`` takes them."""
        names = self.fit.problem.space.names
        return {name: (share.random, share.systematic) for name, share in ((n, self.share(n)) for n in names)}

    def table(self) -> str:
        """The budget as a table: one row a parameter, one column a source."""
        fit = self.fit
        rows = [self.share(name) for name in fit.problem.space.names]
        if fit.model.speed_dependent and fit.problem.space.index.shape[0] == 1:
            onset = self.threshold_speed()
            rows += [onset.times(RPM_PER_RAD_S, "rpm")] if math.isfinite(onset.value) else []
        sources = list(self._sources)
        table: list[list[str | Wide]] = [["parameter", "value", "combined", "random", "system.", *sources, "unit"]]
        for row in rows:
            if not math.isfinite(row.combined):
                table.append([row.name, Wide("not determined by the data", 2)])
                continue
            parts = (row.combined, row.random, row.systematic, *row.notable.values())
            errors = [significant(part, 2) for part in parts]
            table.append([row.name, with_error(row.value, row.combined)[0], *errors, row.unit])
        return "\n".join(text_table(table, " ".join(["<22 >14 >10 >10 >10", *[">10"] * len(sources), "<1"])))

    def summary(self) -> str:
        """The table with what was assumed, and what the data say of the calibration."""
        lines = ["standard uncertainties: random (GUM type A, noise) and systematic (type B, calibration), by source"]
        lines += [self.table(), "errors of calibration: assumed, and what the data leave of them"]
        names = self.fit.problem.space.nuisance
        sd = {prior.entry: float(prior.distribution.std()) for prior in self.fit.problem.priors}
        rows = []
        for name in names:
            i = self.fit.var_names.index(name)
            kind = bare_name(name)
            if i not in sd or kind not in NUISANCE_KINDS:
                continue
            p = self.fit.params[name]
            unit, factor = ("deg", 180 / math.pi) if p.unit == "rad" else ("%", 100.0)
            value, error = significant(p.value * factor, 3, sign=True), significant(p.stderr * factor, 2)
            found = f"found {value} +- {error} {unit}, {NUISANCE_KINDS[kind][1]}"
            rows.append(["", name, f"0 +- {significant(sd[i] * factor, 3)} {unit}", found])
        return "\n".join([*lines, *text_table(rows, "<0 <19 <12 <1")])

    def __str__(self) -> str:
        return self.summary()


def budget(fit: FitResult, calibration: Calibration) -> Budget:
    """Fit again with the errors of a calibration as nuisance entries, and part the uncertainty by origin."""
    if fit.method == "closed form":
        raise ValueError("a budget needs an optimised fit: use the result of rf.fit, not of rf.closed_form")
    settings = replace(fit.settings, calibration=calibration)
    problem = build_problem(fit.model, fit.experiments, settings)
    return Budget(solve_again(replace(fit, settings=settings), problem), calibration)
