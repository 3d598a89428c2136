"""Scatter of readings between mountings of a weight and between repeats of one mounting.

Readings taken one after the other agree far better than readings before and after the weight was taken off: the shaft's
bow, the seat of the weight, a probe's bracket have moved. What every reading of one mounting has in common is a random
effect; its variance is estimated by restricted maximum likelihood, which pays for the coefficients fitted beside it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import COLLINEAR, ComplexArray, Float, Index


@dataclass(frozen=True, kw_only=True, eq=False)
class MountingFit:
    """Coefficients of ``y_m = X_m beta + b_m + e_m`` over mountings m; variances are of real and of imaginary parts."""

    beta: ComplexArray  # coefficients, shape ``(p,)``
    weights: ComplexArray  # ``beta = weights @ y``, shape ``(p, M)``, zero where a mounting has no such reading
    residuals: ComplexArray  # shape ``(M,)``, zero where there is no reading
    projector: ComplexArray  # ``residuals = projector @ y``, shape ``(M, M)``
    mounting: float  # variance between mountings, NaN where there are no more mountings than coefficients
    repeat: float  # variance between repeats of one mounting, NaN where nothing was repeated
    mean: float  # typical variance of a mounting's mean reading, repeats included
    freedom: int  # complex degrees of freedom of ``mean``


def solve(reading: ComplexArray, count: Float, design: ComplexArray, repeat: float) -> MountingFit:
    """Coefficients and the variance between mountings, by restricted maximum likelihood."""
    there = np.flatnonzero(np.isfinite(reading))
    y, X, n = reading[there], design[there], count[there]
    freedom = there.size - X.shape[1]
    within = (0.0 if np.isnan(repeat) else repeat) / n
    if freedom:
        between = _restricted(y, X, within)
        variance = between + within
    else:  # as many coefficients as mountings: only repeats scatter
        between = float("nan")
        variance = within if within.any() else np.ones(there.size)
    weights = _weights(X, variance)
    projector = np.eye(there.size) - X @ weights
    whole = np.zeros((design.shape[1], reading.size), dtype=complex)
    whole[:, there] = weights
    left = np.zeros((reading.size, reading.size), dtype=complex)
    left[np.ix_(there, there)] = projector
    residuals = np.zeros(reading.size, dtype=complex)
    residuals[there] = projector @ y
    known = freedom > 0 or bool(within.any())
    return MountingFit(
        beta=weights @ y,
        weights=whole,
        residuals=residuals,
        projector=left,
        mounting=between,
        repeat=repeat,
        mean=float(variance.mean()) if known else float("nan"),
        freedom=freedom,
    )


def determines(design: ComplexArray) -> bool:
    """True if the columns of a design are independent."""
    if design.shape[0] < design.shape[1]:
        return False
    size = np.linalg.norm(design, axis=0)
    if not size.all():
        return False
    singular = np.linalg.svd(design / size, compute_uv=False)
    return bool(singular[-1] > COLLINEAR * singular[0])


def _weights(X: ComplexArray, variance: Float) -> ComplexArray:
    left = X.conj().T / variance
    return np.asarray(np.linalg.solve(left @ X, left))


def _restricted(y: ComplexArray, X: ComplexArray, within: Float) -> float:
    """Variance between mountings where the restricted likelihood of complex readings is largest."""
    freedom = y.size - X.shape[1]
    residuals = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
    scale = float(np.sum(np.abs(residuals) ** 2)) / (2 * freedom)
    if scale == 0:
        return 0.0

    def minus_twice(between: float) -> float:
        variance = between + within
        miss = y - X @ (_weights(X, variance) @ y)
        determinant = np.linalg.slogdet(X.conj().T / variance @ X)[1]
        return float(2 * np.log(variance).sum() + 2 * determinant + np.sum(np.abs(miss) ** 2 / variance))

    from scipy.optimize import minimize_scalar  # late: it loads much of SciPy

    decades = 12.0  # range searched about the mean square of the residuals: six digits of standard deviations
    found = minimize_scalar(
        lambda u: minus_twice(scale * 10**u), bounds=(-decades / 2, decades / 2), options={"xatol": 1e-6}
    )
    between = float(scale * 10 ** float(found.x))
    if within.all() and minus_twice(0.0) <= float(found.fun):
        return 0.0
    return between


def repeat_variance(readings: ComplexArray, mounting: Index) -> tuple[float, int]:
    """Variance of either part between repeats of one mounting, NaN without any, and its complex degrees of freedom."""
    count = np.bincount(mounting)
    mean = (np.bincount(mounting, readings.real) + 1j * np.bincount(mounting, readings.imag)) / np.maximum(count, 1)
    freedom = int(readings.size - np.count_nonzero(count))
    if not freedom:
        return float("nan"), 0
    return float(np.sum(np.abs(readings - mean[mounting]) ** 2)) / (2 * freedom), freedom


def scatter(cells: list[MountingFit]) -> ComplexArray:
    """Covariance of the mean readings of one mounting across kinds of reading (channels and speeds), shape ``(C, C)``.
    No structure is assumed: whatever a mounting does to several channels and speeds at once is in it. Its rank is that
    of the residuals, so that it serves for error bars but cannot weigh."""
    found = np.zeros((len(cells), len(cells)), dtype=complex)
    for i, one in enumerate(cells):
        for k, other in enumerate(cells):
            # E[r_i r_k^H] = P_i (cov) P_k^H: the trace counts what the coefficients have taken out of both
            share = float(np.vdot(other.projector, one.projector).real)
            if share > 0:
                found[i, k] = np.vdot(other.residuals, one.residuals) / (2 * share)
    values, vectors = np.linalg.eigh(found)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.conj().T)


def coefficient_covariance(cells: list[MountingFit], between: ComplexArray) -> ComplexArray:
    """Covariance of the coefficients of all cells by that of the mean readings of a mounting, shape ``(C p, C p)``."""
    weights = np.array([cell.weights for cell in cells])
    spread = np.einsum("cim,dkm->cidk", weights, weights.conj())
    size = weights.shape[0] * weights.shape[1]
    return np.asarray((spread * between[:, None, :, None]).reshape(size, size))
