"""Tables of journal coefficients."""

from __future__ import annotations

import numpy as np

from rotorfit.data.experiments import CoefficientTable
from rotorfit.estimators.blocks.coefficients import JournalCoefficients
from rotorfit.models import RotorModel
from rotorfit.models.array_types import Index
from rotorfit.observing.refusals import check_finite
from rotorfit.observing.row_labels import numbered_labels


def journal_coefficients(model: RotorModel, test: CoefficientTable, group: Index) -> JournalCoefficients:
    """Observations of a table, with the accuracy that it states."""
    values = np.stack([test.kxx, test.kxy, test.cxx, test.cxy, test.mxx], axis=1)
    check_finite(test, test.speed, test.eccentricity, *values.T)
    if np.isnan(test.sigma).any():
        raise ValueError(
            f"{test.source or 'table'}: the accuracy of the coefficients is not known; give a sigma_ratio column, for "
            f"instance 3e-7 for a table of six digits"
        )
    floor = 1e-9 * np.abs(values).max(axis=0)
    error = np.maximum(test.sigma[:, None] * np.abs(values), floor)
    mass = test.sigma * np.abs(test.mxx)
    spread = np.concatenate([error[:, 0:2], error[:, 2:4], np.column_stack([error[:, 4], np.maximum(mass, floor[4])])])
    parts = np.concatenate([values[:, 0:2], values[:, 2:4], np.column_stack([test.mxx, np.zeros(len(test))])])
    names = [f"{run} / {what}" for what in ("stiffness", "damping", "mass") for run in test.run.tolist()]
    label, labels = numbered_labels(names)
    measured = parts[:, 0] / spread[:, 0] + 1j * parts[:, 1] / spread[:, 1]
    return JournalCoefficients(
        model=model,
        speed=test.speed,
        eccentricity=test.eccentricity,
        group=group,
        spread=spread,
        measured=measured,
        label=label,
        labels=labels,
        run=np.tile(test.run, 3),
    )
