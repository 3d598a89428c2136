"""Free vibration: eigenvalues of impulse tests."""

from __future__ import annotations

import numpy as np

from rotorfit.data.experiments import ImpulseTest
from rotorfit.estimators.blocks.small_motion import FreeVibrations
from rotorfit.models import RotorModel
from rotorfit.models.array_types import Index
from rotorfit.observing.refusals import check_clearance, check_finite
from rotorfit.observing.row_labels import numbered_labels, same_rows, spread_of_repeats


def free_vibrations(model: RotorModel, test: ImpulseTest, group: Index) -> FreeVibrations:
    """Observations of an impulse test, with their noise."""
    check_finite(test, test.frequency, test.damping_ratio)
    eps = test.eccentricity.copy()
    if model.clearance is not None:
        eps = np.where(np.isnan(eps), np.abs(test.position) / model.clearance, eps)
    elif not model.eccentricity_dependent:
        eps[np.isnan(eps)] = 0.0
    if np.isnan(eps).any():
        row = int(np.flatnonzero(np.isnan(eps))[0]) + 1
        raise ValueError(
            f"{test.source or 'impulse test'}: row {row} tells neither eccentricity nor position of the journal; use 0 "
            f"for a centred one"
        )
    check_clearance(eps, model, "static positions")
    label, labels = numbered_labels([f"{run} / eigenvalue" for run in test.run.tolist()])
    s = test.eigenvalue
    sigma = test.sigma.copy()
    if np.isnan(sigma).any():
        spread = spread_of_repeats(s, same_rows(test.speed, np.round(eps, 9)))
        if spread is None:
            raise ValueError(
                f"{test.source or 'impulse test'}: the noise of frequency and damping is not known; give a sigma_rpm "
                f"column, or repeat impulses at the same speed and eccentricity"
            )
        sigma[np.isnan(sigma)] = spread
    return FreeVibrations(
        model=model,
        speed=test.speed,
        eccentricity=eps,
        reading_group=group,
        measured=s,
        sigma=sigma,
        label=label,
        labels=labels,
        run=test.run,
    )
