"""Threshold speeds of many draws, by the rules of the fit's own: a threshold beyond the tests is reported as such."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rotorfit.fitting.assumptions.onset import is_extrapolated
from rotorfit.fitting.result import FitResult
from rotorfit.models.array_types import Float
from rotorfit.models.motion.stability import threshold_speeds


@dataclass(frozen=True, eq=False, kw_only=True)
class Onsets:
    """Onset of instability of each draw."""

    speed: Float  # rad/s, shape ``(N,)``
    whirl_ratio: Float  # frequency of the whirl over the speed, NaN without an onset, shape ``(N,)``
    note: str  # what limits the numbers, in words; empty where there is nothing


def onsets_of(fit: FitResult, theta: Float, group: int, seed: int) -> Onsets:
    """Threshold speeds of draws of one parameter group.

    After refinement candidates differ by more than the draws of one of them do, where the onset lies beyond the
    tested speeds or frequencies. As in :meth:`~rotorfit.FitResult.threshold_speed` that difference is an error of the
    result: extrapolated draws are scattered by it, and those whose onset lies outside the band of a model that holds in
    the band only are drawn from the onset of the candidate that holds beyond.
    """
    speed, whirl = threshold_speeds(fit.model, theta, band=fit.stability_band)
    ratio = whirl / np.where(speed > 0, speed, np.nan)
    found = np.isfinite(speed)
    candidate = fit.settings.onsets[group] if fit.settings.onsets else None
    limited = math.isfinite(fit.stability_band)
    if limited and candidate is None and math.isnan(fit.threshold_of(group).value):
        speed = np.full_like(speed, np.nan)
    if candidate is not None:
        normal = np.random.default_rng(seed).standard_normal(speed.size)
        beyond = found & is_extrapolated(fit, speed, whirl)
        speed[beyond] += candidate.difference * normal[beyond]
        if limited and math.isfinite(candidate.speed):
            speed[~found] = candidate.speed + math.hypot(candidate.stderr, candidate.difference) * normal[~found]
            ratio[~found] = candidate.whirl_ratio
    return Onsets(speed=speed, whirl_ratio=ratio, note=fit.onset_note(group))
