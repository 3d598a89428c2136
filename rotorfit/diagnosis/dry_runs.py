"""Dry runs that are of another rig: a fluid adds mass to what moves, it takes none away."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rotorfit.data.findings import Finding
from rotorfit.estimators.blocks.nonlinear import responses_of
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.significance import SIGNIFICANT_ERRORS
from rotorfit.estimators.starting.stiffness_inversion import stiffness_matrices
from rotorfit.fitting.result import FitResult
from rotorfit.models.array_types import ComplexArray, Float

_LARGEST_LOSS = 0.1
"""Share of the dry rig's mass that a fluid's negative direct inertia may take at most."""


def other_rig(fit: FitResult) -> Iterator[Finding]:
    """The dry run of a fit, where more moves in it than in the test with fluid."""
    baseline = fit.settings.baseline
    for block in map(responses_of, fit.problem.blocks) if baseline is not None else ():
        if block is None or block.beside is None:
            continue
        source = (baseline.source if baseline is not None else "") or "given"
        dry, _ = _mass(np.abs(block.s), block.beside)
        added, error = _added(block)
        if added < -_LARGEST_LOSS * abs(dry) and added < -SIGNIFICANT_ERRORS * error:
            yield Finding(
                "error",
                "other-rig",
                f"In the dry run {source} {dry:.3g} kg move, in the test with fluid {dry + added:.3g} +- {error:.1g} "
                "kg: a fluid adds mass. Is the dry run of another rig, or of this one with other parts on its stator?",
                undo="the dry run of this rig",
            )


def _added(block: Responses) -> tuple[float, float]:
    """Mass that the test has beyond the dry run's, kg, and its standard error."""
    whole = stiffness_matrices(block)
    beside = 0.0 if block.beside is None else block.beside[whole.first_line]
    return _mass(np.abs(whole.frequency), np.asarray(whole.kappa - beside))


def _mass(w: Float, kappa: ComplexArray) -> tuple[float, float]:
    """Moving mass by ``Re kappa = K - w^2 M``, mean of the directions, and its standard error."""
    along = np.mean(np.diagonal(kappa, axis1=1, axis2=2).real, axis=1)
    design = np.column_stack([np.ones(w.size), -(w**2)])
    found, left, rank, _ = np.linalg.lstsq(design, along, rcond=None)
    if rank < design.shape[1] or w.size <= design.shape[1]:
        return 0.0, float("inf")
    spread = float(left[0]) / (w.size - design.shape[1])
    return float(found[1]), float(np.sqrt(spread * np.linalg.inv(design.T @ design)[1, 1]))
