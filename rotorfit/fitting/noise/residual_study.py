"""The record of a study of residuals: numbers, and on request its sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.estimators.inference.smooth_causes import Cause
from rotorfit.estimators.significance import P_WARNING
from rotorfit.fitting.noise import words
from rotorfit.fitting.noise.record import FoundNoise, Miss, NoiseVerdict, ResponseNoise, RunEffect
from rotorfit.models.array_types import Float
from rotorfit.version import renamed

MODEL_LIMITED_REDCHI = 2.0
"""redchi above which a result that has nothing else to go by says that the model, not the noise, limits the fit."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ResidualStudy:
    """Study of the residuals of a fit, and the basis of its error bars.

    Attributes:
        verdict: what the residuals are, beside ``causes``.
        causes: fixed causes that explain what the fit misses; the results are those of the model without them.
        correlation: of residuals at neighbouring lines of a sweep: near zero for noise, whatever its shape.
        lags: the same at distances 1, 2, ... as far as it is more than chance.
        response_noise: noise of the responses by restricted likelihood, where it replaced that of the data alone.
        noise_ratio: for each block, size of the residuals over the noise given, or found in the data alone, where a
            misfit may as well be noise behind overlapping filters.
        found: what the fit was repeated with: other noise, differences from run to run; ``None`` for neither.
        possible_effects: differences of runs that chance explains as well: the errors allow for them, the estimate does
            without.
        run_count: runs that were compared, zero where they could not be.
        misses: responses and frequencies where the model misses most.
        run_left_out: name of the one run without which the misfit would be a third or less, and redchi without it.
        robust: whether standard errors follow the scatter of the residuals line by line (HC3).
        scatter_freedom: degrees of freedom of the noise within runs, infinite where it was given.
        runs: name, estimate and standard error of each effect of a run.
        shares, freedom: parts of ``covar`` and the degrees of freedom of each part's variance.
    """

    verdict: NoiseVerdict
    causes: tuple[Cause, ...] = ()
    correlation: float = 0.0
    lags: tuple[float, ...] = ()
    response_noise: tuple[ResponseNoise, ...] = ()
    noise_ratio: tuple[Float, ...] = ()
    found: FoundNoise | None = None
    possible_effects: tuple[RunEffect, ...] = ()
    run_count: int = 0
    misses: tuple[Miss, ...] = ()
    run_left_out: tuple[str, float] | None = None
    robust: bool = False
    scatter_freedom: float = float("inf")
    runs: tuple[tuple[str, float, float], ...] = ()
    shares: tuple[Float, ...] = ()
    freedom: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "verdict", NoiseVerdict(self.verdict))  # files hold its value

    @property
    def effects(self) -> tuple[RunEffect, ...]:
        """Differences from run to run."""
        return () if self.found is None else self.found.effects

    @property
    def explained(self) -> bool:
        """True if fixed causes explain what the fit misses."""
        return bool(self.causes) and self.verdict is not NoiseVerdict.MISFIT

    @property
    def between(self) -> tuple[tuple[str, float], ...]:
        """Kind and standard deviation of each difference from run to run."""
        return tuple((effect.kind, effect.sd) for effect in self.effects)

    @property
    def perhaps_filtered(self) -> bool:
        """True if what a fit misses looks like noise behind overlapping filters."""
        return bool(self.noise_ratio)

    @property
    def correlated(self) -> bool:
        """True if standard errors include that the noise is, or may be, correlated along the sweeps."""
        return self.verdict is NoiseVerdict.CORRELATED or self.perhaps_filtered

    def degrees(self, gradient: Float) -> float:
        """Degrees of freedom of the variance of a derived quantity (Satterthwaite), infinite for a known one.

        Args:
            gradient: its derivative by the fitted vector, shape ``(p,)``.
        """
        return _satterthwaite([float(gradient @ share @ gradient) for share in self.shares], self.freedom)

    def own_degrees(self) -> tuple[float, ...]:
        """The same of each entry of the fitted vector."""
        variances = (np.diag(share).tolist() for share in self.shares)
        return tuple(_satterthwaite(parts, self.freedom) for parts in zip(*variances, strict=True))

    # ---- sentences -----------------------------------------------------------------------------------------------

    @property
    def sentences(self) -> tuple[str, ...]:
        """Fixed causes, differences of runs and uneven scatter in words."""
        return (
            *words.causes(self.causes, whole=self.explained),
            *words.sentences(self.effects, self.possible_effects, self.run_count, robust=self.robust),
        )

    @property
    def notable(self) -> tuple[str, ...]:
        """Those of them that are warnings."""
        return (*words.causes(self.causes, whole=self.explained), *words.differences(self.effects))

    @property
    def places(self) -> tuple[str, ...]:
        """``misses`` in words."""
        return tuple(map(words.place, self.misses))

    @property
    def odd_run(self) -> str:
        """``run_left_out`` in words; empty where there is none."""
        return "" if self.run_left_out is None else words.odd_run(*self.run_left_out)

    def warnings(self, redchi: float) -> list[str]:
        """Warnings about the noise.

        Args:
            redchi: of the fit, by the noise of the data.
        """
        large = redchi > MODEL_LIMITED_REDCHI
        return [*self.notable, *words.verdict_warning(self.verdict, redchi, self.correlation, large=large)]

    def __str__(self) -> str:
        return "; ".join([words.VERDICTS[self.verdict], *self.sentences])

    # ---- names of version 0.1.0 ----------------------------------------------------------------------------------

    @property
    def levels(self) -> tuple[ResponseNoise, ...]:
        """``response_noise``."""
        renamed("fit.noise.levels", "response_noise")
        return self.response_noise

    @property
    def perhaps(self) -> tuple[RunEffect, ...]:
        """``possible_effects``."""
        renamed("fit.noise.perhaps", "possible_effects")
        return self.possible_effects


def is_misfit(study: ResidualStudy | None, widening: float) -> bool:
    """True if the model limits a fit, not the noise: by a missing cause, the memory of residuals, or their size."""
    if study is None:
        return widening > MODEL_LIMITED_REDCHI
    return study.verdict is NoiseVerdict.MISFIT or bool(study.causes)


def largest_redchi(study: ResidualStudy | None, nfree: int, known_from: float) -> float:
    """redchi that noise alone exceeds once in a thousand tests: a quantile of the F distribution. ``nfree`` readings
    tell it, fewer where neighbours correlate; its own noise is known from ``known_from`` readings, infinite for noise
    that was given. Of many of both the sampling error of redchi is ``sqrt(2/nfree + 2/known_from)``."""
    from scipy.special import fdtri  # late: loading it takes longer than a fit

    lags = () if study is None else study.lags
    independent = nfree / (1 + 2 * sum(lag * lag for lag in lags))  # squares of normal errors correlate by lag^2
    known_well = 1e9  # readings from which a noise is as good as known
    return float(fdtri(independent, min(known_from, known_well), 1 - P_WARNING)) if nfree > 0 else float("nan")


def _satterthwaite(parts: Sequence[float], freedom: Sequence[float]) -> float:
    """Degrees of freedom of a sum of variances, which are known with so many each."""
    parts = [max(part, 0.0) for part in parts]
    uncertain = sum(part**2 / own for part, own in zip(parts, freedom, strict=True))
    return sum(parts) ** 2 / uncertain if uncertain > 0 else float("inf")
