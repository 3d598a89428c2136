"""Stiffness and damping of a fluid frequency by frequency from a fit: readings inverted, the rig taken out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rotorfit.estimators.blocks.nonlinear import responses_of
from rotorfit.estimators.inference.covariance import standard_error
from rotorfit.estimators.starting.stiffness_inversion import stiffness_matrices
from rotorfit.fitting.structure.coefficients import coefficient_rows, of_a_rig
from rotorfit.fitting.structure.frequency_rows import FrequencyCoefficients, FrequencyRows

if TYPE_CHECKING:
    from rotorfit.fitting.result import FitResult


def frequency_coefficients_of(fit: FitResult, speeds: Sequence[float] | None) -> FrequencyRows:
    """See :meth:`FitResult.frequency_coefficients`."""
    if not of_a_rig(fit) or fit.model.frame == "z" or len(fit.model.coordinates) != 2:
        raise ValueError(
            "stiffness and damping against frequency are those of a seal or bearing alone, forced and read along x and "
            f"y: fit Anisotropic of one plane, with the rig taken out (baseline, stator_mass_kg); not "
            f"{fit.model.name}"
        )
    found = []
    for at in coefficient_rows(fit, speeds, None).rows:
        for block in map(responses_of, fit.problem.blocks):
            if block is None:
                continue
            whole = stiffness_matrices(block)
            mine = (np.abs(whole.speed - at.speed) <= 1e-3 * max(at.speed, 1.0)) & (
                block.group[whole.first_line] == at.group
            )
            w = whole.frequency[mine]
            if not w.size:
                continue
            beside = 0.0 if block.beside is None else block.beside[whole.first_line[mine]]
            kappa = (whole.kappa[mine] - beside).reshape(-1, 4).T
            sigma = whole.sigma[mine].reshape(-1, 4).T
            slopes = np.zeros((4, w.size, 12))
            for entry in range(4):
                slopes[entry, :, entry] = 1.0
                slopes[entry, :, 8 + entry] = -(w**2)
            found.append(
                FrequencyCoefficients(
                    condition=at.condition,
                    frequency=w,
                    stiffness=kappa.real,
                    damping=kappa.imag / w,
                    stiffness_stderr=sigma,
                    damping_stderr=sigma / w,
                    fitted_stiffness=slopes @ at.values,
                    fitted_stiffness_stderr=standard_error(slopes, at.covariance),
                    fitted_damping=np.repeat(at.values[4:8, None], w.size, axis=1),
                    fitted_damping_stderr=np.repeat(np.sqrt(np.diag(at.covariance)[4:8])[:, None], w.size, axis=1),
                )
            )
    if not found:
        raise ValueError(
            "no line was forced and read along both axes, or forward and backward, so that its stiffness cannot be "
            "measured by itself; force both ways at the same frequencies and speeds"
        )
    return FrequencyRows(tuple(found))


def measured_by_frequency(fit: FitResult) -> bool:
    """True if some line was forced and read along both axes, so that it has a stiffness of its own."""
    blocks = [block for block in map(responses_of, fit.problem.blocks) if block is not None]
    return any(stiffness_matrices(block).frequency.size for block in blocks)
