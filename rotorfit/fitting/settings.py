"""What the user asked of a fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from rotorfit.estimators.misfit.losses import Loss

if TYPE_CHECKING:
    from rotorfit.fitting.calibration import Calibration
    from rotorfit.fitting.noise.record import FoundNoise

PhaseOffsets: TypeAlias = bool | Literal["common"]
"""An offset of the phase reference for every run but the first, one common to all, or none."""


def check_phase_offsets(given: object) -> None:
    """Refuse what is no choice of phase offsets."""
    if given not in (True, False, "common"):
        raise ValueError(f"phase_offsets is {given!r}; allowed: False, True (one a run but the first), 'common'")


@dataclass(frozen=True, kw_only=True)
class Onset:
    """Onset of instability as a ladder of models tells it."""

    speed: float  # threshold speed, rad/s
    stderr: float  # its standard error by the rung itself, rad/s
    difference: float  # from it to the rungs beside it, rad/s; an error of its own where the onset is extrapolated
    whirl_ratio: float  # whirl frequency at onset over threshold speed


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """What the user asked for, and what was found out while doing it; it lays the problem out again."""

    known: Mapping[str, float | None] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    priors: Mapping[str, Any] = field(default_factory=dict)
    per: Mapping[str, str] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    loss: Loss = "linear"
    phase_offsets: PhaseOffsets = False
    max_iterations: int = 200
    levels: Mapping[str, float] = field(default_factory=dict)
    onsets: tuple[Onset, ...] = ()
    calibration: Calibration | None = None  # uncertainties that enter as nuisance entries
    assumptions: Mapping[str, float] = field(default_factory=dict)
    noise: FoundNoise | None = None

    @property
    def asked(self) -> FitSettings:
        """What goes for another model of the same data too: without what the fit found for itself, and assumptions."""
        return replace(self, levels={}, onsets=(), noise=None, assumptions={})

    @property
    def levelled(self) -> bool:
        """Whether the noise was scaled to the residuals, or what runs differ by joined it."""
        return bool(self.levels) or self.noise is not None
