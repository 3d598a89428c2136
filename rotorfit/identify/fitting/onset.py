"""Threshold speed of a fitted rotor: where it becomes unstable, how sure that is, and what it depends on."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.blocks.set_speeds import ONLY_1X
from rotorfit.identify.fitting.causes.slopes import onset_slopes, onset_term_slopes, onset_with_causes
from rotorfit.identify.fitting.judge import why_not_refined
from rotorfit.identify.fitting.propagation import propagated, with_error
from rotorfit.identify.fitting.quantities import Quantity
from rotorfit.identify.fitting.result import FitResult
from rotorfit.models import eigenvalues
from rotorfit.models.motion.off_centre import off_centre_threshold
from rotorfit.models.motion.stability import eigenvalue_gradient
from rotorfit.models.shafts.angular_rates import HIGHEST_RATE


def onset_of(fit: FitResult, group: int) -> Quantity:
    """Threshold speed of one parameter group, rad/s."""
    onset = fit.onset(group)
    candidate = fit.settings.onsets[group] if fit.settings.onsets else None
    if onset is None and math.isfinite(fit.stability_band):
        # Terms that hold in the tested band only say nothing of an onset beyond it.
        if candidate is None or not math.isfinite(candidate.speed):
            return Quantity(math.nan, math.inf, "rad/s")
        return Quantity(candidate.speed, math.hypot(candidate.stderr, candidate.difference), "rad/s", fit.freedom)
    if onset is None:
        return Quantity(math.nan, _growth_error(fit, group), "rad/s")
    found = propagated(fit, group, onset.speed, onset.gradient, "rad/s", speed=onset.speed)
    solved = fit.settings.solved
    if solved is not None and onset.speed:  # not unstable from standstill on
        theta = fit.thetas[group]
        speed = onset_with_causes(fit.model, theta, onset, solved, fit.stability_band)
        terms = onset_term_slopes(fit.model, theta, onset, solved)
        found = propagated(fit, group, speed, onset.gradient, "rad/s", speed=onset.speed, by_causes=terms)
    if candidate is None or not is_extrapolated(fit, onset.speed, onset.whirl_frequency):
        return found
    there = 0.0  # share of the variance by the choice among candidates that the covariance holds already
    if fit.model_uncertainty is not None:
        slope = fit.problem.space.pull_back(onset.gradient, group)[: len(fit.model_uncertainty)]
        there = float(slope @ fit.model_uncertainty @ slope)
    more = math.sqrt(max(0.0, candidate.difference**2 - there))
    return Quantity(found.value, math.hypot(found.stderr, more), "rad/s", found.freedom)


def off_centre_onset(fit: FitResult, group: int, eccentricity: float) -> Quantity:
    """Threshold speed of one parameter group with its journal held at a static eccentricity, rad/s."""
    theta, solved = fit.thetas[group], fit.settings.solved
    onset = off_centre_threshold(fit.model, theta, eccentricity, band=fit.stability_band)
    if onset is None:
        return Quantity(math.nan, math.nan, "rad/s")
    centred = fit.onset(group) if solved is not None else None
    if centred is None or solved is None:
        return propagated(fit, group, onset.speed, onset.gradient, "rad/s")
    # Causes change it by the same share as that of the centred journal.
    share = onset.speed / centred.speed
    slope = fit.problem.space.pull_back(onset.gradient, group)
    by_causes = share * onset_slopes(fit.model, theta, centred, solved)
    return with_error(fit, share * fit.threshold_of(group).value, slope, by_causes, "rad/s")


def onset_by_causes(fit: FitResult, group: int) -> tuple[float, Float]:
    """Change of a threshold speed by causes of no size, and its slopes by sizes, shape ``(k,)``: the line through what
    those that were found do in full."""
    onset, solved = fit.onset(group), fit.settings.solved
    if onset is None or solved is None:
        return 0.0, np.zeros(0 if solved is None else len(solved.causes))
    theta = fit.thetas[group]
    there = onset_with_causes(fit.model, theta, onset, solved, fit.stability_band) - onset.speed
    slopes = onset_slopes(fit.model, theta, onset, solved)
    return there - float(slopes @ solved.errors.value), slopes


def is_extrapolated(fit: FitResult, speed: ArrayLike, whirl: ArrayLike) -> Any:
    """True if onsets lie beyond the tests, so that they depend on the structure of the model."""
    return (np.abs(whirl) > fit.band) | _is_far(fit, speed)


def _is_far(fit: FitResult, speed: ArrayLike) -> Any:
    """True if a speed lies so far above the tested ones that terms growing with speed are hardly seen in the data."""
    highest = float(fit.speeds.max(initial=0.0))
    far_ratio = 3.0  # onset over the highest tested speed from which it is called far
    return (np.asarray(speed) > far_ratio * highest) & (highest > 0)


def onset_note(fit: FitResult, group: int) -> str:
    """Limits of the threshold speed of a parameter group; empty where its whirl lies in the tested band."""
    if not fit.model.speed_dependent or not math.isfinite(fit.band):
        return ""
    only_1x = math.isinf(onset_of(fit, group).stderr) and all(test.synchronous for test in fit.experiments)
    return ONLY_1X if only_1x else _limits(fit, group)


def _limits(fit: FitResult, group: int) -> str:
    onset = fit.onset(group)
    if onset is None and math.isfinite(fit.stability_band):
        if math.isnan(onset_of(fit, group).value):
            return "any onset lies outside the tested band of frequencies, which was not searched"
        return (
            "the onset lies outside the tested band of frequencies: it is that of the model without terms that "
            "hold in the band only, its error the difference between the candidate models included"
        )
    error = "its error includes the difference between the candidate models"
    if onset is not None and abs(onset.whirl_frequency) <= fit.band and _is_far(fit, onset.speed):
        far = f"the onset lies {onset.speed / float(fit.speeds.max()):.1f} times above the highest tested speed"
        return f"{far}: {error if fit.settings.onsets else 'terms that grow with speed are hardly seen there'}"
    if onset is None or abs(onset.whirl_frequency) <= fit.band:
        return ""
    words = f"the whirl at onset ({abs(onset.whirl_frequency) * RPM_PER_RAD_S:.0f} cycles a minute) lies above the "
    alone = "refine (--refine) would show how much this depends on the model"
    extrapolated = "the model extrapolates" if why_not_refined(fit.model, fit.identifiability) else alone
    known = error if fit.settings.onsets else extrapolated
    return f"{words}tested frequencies ({fit.band * RPM_PER_RAD_S:.0f}): {known}"


def _growth_error(fit: FitResult, group: int) -> float:
    """Infinite where undetermined parameters, such as lam of tests at rest, move the least stable mode, or NaN."""
    theta, model = fit.thetas[group], fit.model
    if not model.speed_dependent:
        return math.nan

    def in_band(speed: float) -> ComplexArray:
        s = eigenvalues(model, theta, speed)
        return np.asarray(s[np.isfinite(s) & (np.abs(s) <= fit.stability_band) & (np.abs(s) > 0)])

    speed = min(float(np.abs(in_band(0.0)).max(initial=0.0)), HIGHEST_RATE)
    s = in_band(speed)
    if not s.size:
        return math.nan
    least = complex(s[np.argmax(s.real)])
    _, by_theta = eigenvalue_gradient(model, theta, speed, least)
    error = propagated(fit, group, abs(least), by_theta.real, "1/s").stderr
    return math.nan if math.isfinite(error) else math.inf
