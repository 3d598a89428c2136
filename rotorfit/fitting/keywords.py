"""Keywords that are handed on to another function: their names and types, and the refusal of others.

An editor completes them where they are handed on; what they do is said at the function that takes them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypedDict

from rotorfit.data.figure_keywords import PlotKeywords
from rotorfit.estimators.minimisation.objective import Method
from rotorfit.estimators.misfit.problem import Loss
from rotorfit.fitting.settings import PhaseOffsets
from rotorfit.models.parameters import unknown_name

if TYPE_CHECKING:
    from rotorfit.data.experiments import Experiment
    from rotorfit.estimators.inference.ensemble_sampler import SamplerProgress
    from rotorfit.estimators.inference.log_posterior import Noise
    from rotorfit.fitting.assumptions.calibration import Calibration


class FitKeywords(TypedDict, total=False):
    """Keywords of :func:`rotorfit.fit` but for ``known``; see there."""

    bounds: Mapping[str, tuple[float | None, float | None]] | None
    priors: Mapping[str, Any] | None
    per: Mapping[str, str] | None
    loss: Loss
    start: Mapping[str, float] | None
    phase_offsets: PhaseOffsets
    baseline: Experiment | None
    stator_mass_kg: float | None
    calibration: Calibration | None
    assumptions: Mapping[str, float] | None
    method: Method
    max_iterations: int


class SamplerKeywords(TypedDict, total=False):
    """Keywords of :func:`rotorfit.sample` for one model or several; see there."""

    seed: int | None
    walkers: int | None
    ess: float
    max_steps: int
    noise: Noise | None
    progress: bool | Callable[[SamplerProgress], None]
    moves: Sequence[tuple[Any, float]] | None
    accelerate: bool | None


class SampleKeywords(SamplerKeywords, total=False):
    """All keywords of :func:`rotorfit.sample`; see there."""

    refine: bool
    checkpoint: str | os.PathLike[str] | None


class PredictKeywords(TypedDict, total=False):
    """Keywords of :meth:`rotorfit.FitResult.predict`; see there."""

    force_plane: str | None
    force: complex | None
    mr: complex | None
    plane: str | None
    direction: str | None
    level: float
    whole: bool
    statistical: bool
    at: Mapping[str, Any] | None


class JudgeKeywords(TypedDict, total=False):
    """Keywords of :meth:`rotorfit.FitResult.stability_report`; see there."""

    max_speed_rpm: float | None
    min_speed_rpm: float | None
    min_decrement: float
    min_threshold_ratio: float
    cross_coupling: Mapping[str, float] | None
    min_cross_coupling_ratio: float
    unbalance_g_mm: Mapping[str, float] | None
    plane: str | None
    max_amplitude_um: float | None
    sensitivity: str | None
    max_sensitivity: float
    cases: Mapping[str, Mapping[str, float]] | None
    level: float
    at: Mapping[str, Any] | None


class BodeKeywords(PlotKeywords, total=False):
    """Keywords of :meth:`rotorfit.FitResult.plot_bode`; see there."""

    against: str
    mr: float | None


class DrivePointKeywords(PlotKeywords, total=False):
    """Keywords of :meth:`rotorfit.FitResult.plot_drive_point`; see there."""

    plane: str | None
    mr: float | None


class StiffnessKeywords(PlotKeywords, total=False):
    """Keywords of :meth:`rotorfit.FitResult.plot_dynamic_stiffness`; see there."""

    against: str


class WhirlKeywords(PlotKeywords, total=False):
    """Keywords of :meth:`rotorfit.FitResult.plot_whirl`; see there."""

    max_speed_rpm: float | None
    group: int


def check_keywords(function: str, given: Iterable[str], keywords: type, *own: str) -> None:
    """Refuse a keyword that a function does not take."""
    allowed = (*own, *keywords.__annotations__)
    for name in given:
        if name not in allowed:
            raise TypeError(unknown_name(f"keyword of {function}", name, allowed))
