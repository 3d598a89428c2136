"""Supports that differ in x and y, by what pairs of probes show against the direction of the force.

Stiffness ``dK conj(z)`` couples w and -w. What appears against the force is of first order in dK and shows its size;
what it takes from the motion with the force is of second order and moves an isotropic fit.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.linear_force import directional
from rotorfit.estimators.blocks.nonlinear import responses_of
from rotorfit.estimators.inference.score_tests import is_linear
from rotorfit.estimators.inference.smooth_causes import Cause, Kind, Part, cause_change
from rotorfit.observing.circular import Places

if TYPE_CHECKING:
    from rotorfit.fitting.result import FitResult

_NEAR_PEAK = math.sqrt(0.5)
"""Motion over the largest from which a reading counts as at the peak: half the power."""


def uneven_supports(fit: FitResult) -> list[Cause]:
    """Supports by what pairs of probes show, those of the plane that shows most; none without pairs."""
    if fit.model.frame != "z" or any(c.axis != "z" for c in fit.model.coordinates):
        return []
    largest, found = 0.0, []
    for test, block in zip(fit.experiments, fit.problem.blocks, strict=True):
        base = responses_of(block)
        if base is None or not isinstance(test, PerturbationTest) or not is_linear(block) or test.linear.any():
            continue
        places = Places.of(fit.model, test)
        if places.coordinate.size != base.measured.size:
            continue  # readings that the model leaves out
        wrong = directional(test.response, places.rows, places.backward)[1]
        for at in np.unique(base.coordinate[np.isfinite(wrong)]).tolist():
            size = np.where(np.isfinite(wrong) & (base.coordinate == at), np.abs(base.measured), 0.0)
            peak = size > _NEAR_PEAK * size.max()
            against = float(np.sum(np.abs(wrong[peak]) ** 2 - 2 * base.sigma[peak] ** 2))  # less that of the noise
            share = against / float(np.sum(size[peak] ** 2))
            if share > largest:
                part = Part(kind=Kind.SUPPORT, at=at, plane=fit.model.coordinates[at].plane)
                unit = cause_change(block, fit.thetas, Cause(parts=(part,)))
                square = against / float(np.sum(np.abs(unit[peak]) ** 2))
                largest, found = share, [Cause(parts=(replace(part, kind=Kind.PAIR),), sizes=(square,))]
    return found
