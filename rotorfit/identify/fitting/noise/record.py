"""Noise that a fit found beside that of the data: part of the settings that lay the problem out."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.models.parameters import bare_name

RUN_KINDS = {
    "run_force": "force or gain",
    "run_phase": "their phase reference",
    "run_K0": "K0",
    "run_D": "D",
    "run_lam": "speed label or lam",
    "run_fluid": "viscosity (K0 and D together)",
}
"""Quantity in which runs differ by each kind of nuisance entry ``kind[run]``; relative, but for phases in rad."""


def is_run_effect(name: str) -> bool:
    """True if an entry of the fitted vector stands for a difference from run to run; such are no parameters."""
    return bare_name(name) in RUN_KINDS


class NoiseVerdict(StrEnum):
    """Verdict on the residuals."""

    AS_FOUND = "as found"  # noise, as it was given or found in the data alone
    SHAPED = "shaped"  # noise estimated anew from the residuals
    LARGER = "larger"  # noise that exceeds the sigma given with the data
    CORRELATED = "correlated"  # noise of the right size that is correlated along the sweeps
    MISFIT = "misfit"  # correlated along the sweeps and larger than the noise: the model does not fit


@dataclass(frozen=True, eq=False, kw_only=True)
class RunEffect:
    """One kind of difference from run to run, a random effect."""

    kind: str  # one of :data:`RUN_KINDS`, or "phase" for the offsets that phase_offsets asks for
    sd: float  # its standard deviation between runs
    freedom: float  # degrees of freedom of that estimate
    runs: tuple[str, ...]  # names of the runs
    values: tuple[float, ...] = ()  # estimate for each run; empty where runs possibly do not differ
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
    effects: tuple[RunEffect, ...] = ()  # differences from run to run
    before: Float  # the estimate that the noise of the data alone gave, to which goodness of fit refers


@dataclass(frozen=True, kw_only=True)
class ResponseNoise:
    """Noise of some responses, ``sigma^2 = constant^2 + (share |response|)^2``."""

    responses: tuple[str, ...]  # their names
    constant: float  # in the unit of what was read, accelerations for instance
    share: float  # relative to the response, or to what ``along`` says
    along: str  # what the share is of
    unit: str = ""  # of the readings, in SI; empty where they differ


@dataclass(frozen=True, kw_only=True)
class Miss:
    """Part of a response that the model misses."""

    response: str  # its name
    low: float  # frequencies, rad/s
    high: float
