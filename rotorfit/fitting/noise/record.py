"""What a fit found out about the noise, as records: part of the settings that lay the problem out, part for readers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.parameters import bare_name

RUN_KINDS = {
    "run_force": ("1", "relative error of the force in this run"),
    "run_phase": ("rad", "error of the phase reference in this run"),
    "run_K0": ("1", "relative change of K0 in this run"),
    "run_D": ("1", "relative change of D in this run"),
    "run_lam": ("1", "relative error of the speed label, or change of lam, in this run"),
    "run_fluid": ("1", "relative change of K0 and D together (viscosity) in this run"),
}
"""Unit and meaning of each kind of nuisance entry that stands for what differs from run to run, ``kind[run]``."""


def is_run_effect(name: str) -> bool:
    """Whether an entry of the fitted vector stands for what differs from run to run; such are no parameters."""
    return bare_name(name) in RUN_KINDS


class NoiseVerdict(StrEnum):
    """What the residuals are; the value is the sentence."""

    AS_FOUND = "the residuals are noise, as it was given or found in the data alone"
    SHAPED = "the residuals are noise of another size or shape than found in the data alone, and were weighed by it"
    LARGER = "the residuals are noise, but larger than the readings' sigma says"
    FOLLOWING = "the residuals have the noise's size but follow one another along the sweeps, as overlapping filters do"
    MISFIT = "the residuals follow one another along the sweeps and exceed the noise: the model does not fit"


@dataclass(frozen=True, eq=False, kw_only=True)
class RunEffect:
    """One kind of difference from run to run, a random effect."""

    kind: str  # one of :data:`RUN_KINDS`, or "phase" for the offsets that phase_offsets asks for
    sd: float  # its standard deviation between runs
    freedom: float  # degrees of freedom of that estimate
    runs: tuple[str, ...]  # names of the runs
    # for each block, change of the logarithm of its predictions by a unit, shape ``(R,)``
    sensitivities: tuple[ComplexArray, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the nuisance entries."""
        return tuple(f"{self.kind}[{run}]" for run in self.runs)


@dataclass(frozen=True, eq=False, kw_only=True)
class FoundNoise:
    """Noise that the residuals show and the data alone do not."""

    # for each block, factor on the noise of its readings as given or found in the data, shape ``(R,)``
    factors: tuple[Float, ...]
    effects: tuple[RunEffect, ...] = ()  # what differs from run to run
    before: Float  # the estimate that the noise of the data alone gave, to which goodness of fit refers


@dataclass(frozen=True, kw_only=True)
class ResponseNoise:
    """Noise of some responses, ``sigma^2 = constant^2 + (share |response|)^2``."""

    responses: tuple[str, ...]  # their names
    constant: float  # in the unit of the readings
    share: float  # relative to the response, or to what ``along`` says
    along: str  # what the share is of
    unit: str = ""  # of the readings, in SI; empty where they differ


def _satterthwaite(parts: Sequence[float], freedom: Sequence[float]) -> float:
    """Degrees of freedom of a sum of variances, which are known with so many each."""
    parts = [max(part, 0.0) for part in parts]
    uncertain = sum(part**2 / own for part, own in zip(parts, freedom, strict=True))
    return sum(parts) ** 2 / uncertain if uncertain > 0 else float("inf")


@dataclass(frozen=True, eq=False, kw_only=True)
class Noise:
    """What a fit rests on, as far as noise goes.

    Attributes:
        verdict: what the residuals are.
        correlation: of residuals at neighbouring lines of a sweep: near zero for noise, whatever its shape.
        lags: the same at distances 1, 2, ... as far as it is more than chance.
        levels: noise of the responses by restricted likelihood, where it replaced that of the data alone.
        between: kind and standard deviation of what differs from run to run.
        perhaps: what runs may differ by though chance explains it as well: the errors allow for it, the estimate does
            without.
        runs: name, estimate and standard error of each effect of a run.
        places: responses and frequencies where the model misses most, in words.
        odd_run: sentence on the one run without which the misfit would be a third or less; empty where there is none.
        robust: whether standard errors follow the scatter of the residuals line by line (HC3).
        scatter_freedom: degrees of freedom of the noise within runs, infinite where it was given.
        shares, freedom: parts of ``covar`` and the degrees of freedom of each part's variance.
        sentences, notable: all this in words, and what of it is a warning.
    """

    verdict: NoiseVerdict
    correlation: float = 0.0
    lags: tuple[float, ...] = ()
    levels: tuple[ResponseNoise, ...] = ()
    between: tuple[tuple[str, float], ...] = ()
    perhaps: tuple[RunEffect, ...] = ()
    runs: tuple[tuple[str, float, float], ...] = ()
    places: tuple[str, ...] = ()
    odd_run: str = ""
    robust: bool = False
    scatter_freedom: float = float("inf")
    shares: tuple[Float, ...] = ()
    freedom: tuple[float, ...] = ()
    sentences: tuple[str, ...] = ()
    notable: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "verdict", NoiseVerdict(self.verdict))  # files hold its words

    def degrees(self, gradient: Float) -> float:
        """Degrees of freedom of the variance of a derived quantity (Satterthwaite), infinite for a known one.

        Args:
            gradient: its derivative by the fitted vector, shape ``(p,)``.
        """
        return _satterthwaite([float(gradient @ share @ gradient) for share in self.shares], self.freedom)

    def own_degrees(self, count: int) -> tuple[float, ...]:
        """The same of each entry of the fitted vector.

        Args:
            count: its length.
        """
        variances = [np.diag(share).tolist() for share in self.shares]
        each = zip(*variances, strict=True) if variances else [()] * count
        return tuple(_satterthwaite(parts, self.freedom) for parts in each)

    def __str__(self) -> str:
        return "; ".join([self.verdict.value, *self.sentences])
