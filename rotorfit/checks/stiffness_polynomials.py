"""Measured dynamic stiffness as polynomials in frequency, ``kappa = a + b w + c w^2``, by lines and by trial fits.

The inertia c is real and positive, by which it is seen how probes stand: :mod:`rotorfit.checks.probe_angles`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rotorfit.checks.orbits import ENOUGH, Receptances, squared_norm, surely_inverse
from rotorfit.estimators.minimisation.least_squares import Options, minimise
from rotorfit.models.array_types import ComplexArray, Float

MOST_LINES = 80
"""Frequencies that the search for turned probes looks at."""

_SHORT, _LONG = 30, 300  # evaluations of a trial fit: of one that looks for a turn, of one that may deny it

_BRIEFLY = Options(hessian="gauss-newton", max_iterations=_SHORT, tolerance=1e-3, acceptable=1e-2)
"""For a thousand readings a hundredth of the misfit is a third of a standard error, and a turn has to exceed six."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Lines:
    """Lines that the search for turned probes looks at."""

    u: Float  # frequencies over the highest, shape ``(L,)``
    H: ComplexArray  # responses to unit forces and their inverses, shape ``(..., L, n, n)``
    kappa: ComplexArray  # responses to unit forces and their inverses, shape ``(..., L, n, n)``


def some_lines(measured: Receptances | None) -> Lines | None:
    """Lines of the responses at one speed, every so many that some :data:`MOST_LINES` are left; None of too few."""
    if measured is None or measured.H.shape[-3] < ENOUGH:
        return None
    every = max(1, measured.H.shape[-3] // MOST_LINES)
    w = measured.frequency[measured.regular][::every]
    u = w / np.abs(measured.frequency).max()
    return Lines(u=u, H=measured.H[..., ::every, :, :], kappa=measured.kappa[..., ::every, :, :])


def inertia_turns(
    measured: Receptances | None, *, trial: bool = True
) -> Iterator[tuple[str, Float, Float, NDArray[np.bool_]]]:
    """Plane, turn of its probes and its error, degrees, and whether its damping is positive, shape ``(...)`` each, from
    ``kappa = a + b w + c w^2``.
    """
    lines = some_lines(measured)
    if measured is None or lines is None:
        return
    planes = measured.planes
    found = _polynomial(lines) if trial else _straight_lines(lines)
    if found is None:
        return
    terms, values, errors = found
    directions, uncertain = _sure(values, errors)
    for q, plane in enumerate(planes):
        inertia, damping = terms.index((q, q, 2)), terms.index((q, q, 1))
        if not values[..., inertia].any():
            continue
        turn, error = -directions[..., inertia], uncertain[..., inertia]
        for k in range(len(planes)):  # coupling is real as well, and better known, but may have either sign
            i = terms.index((k, q, 0))
            if k == q or not values[..., i].any():
                continue
            along, own = directions[..., i], uncertain[..., i]
            better = (own < error) & (error < 1)
            turn = np.where(better, along * np.sign((along / turn).real), turn)
            error = np.where(better, own, error)
        damped = (values[..., damping] / turn).imag > 0
        yield plane, np.degrees(np.angle(turn)), np.degrees(error), damped


def _sure(value: ComplexArray, error: Float) -> tuple[ComplexArray, Float]:
    """Direction of complex numbers, and their error over their size; of a zero nothing is known."""
    size = np.abs(value)
    known = size > 0
    over = 1 / np.where(known, size, 1.0)
    return np.where(known, value * over, 1.0), np.where(known, error * over, np.inf)


def _polynomial(lines: Lines) -> tuple[list[tuple[int, int, int]], ComplexArray, Float] | None:
    """Polynomials ``kappa(u)`` whose inverse is H: row, column and power of each term, its factor and that one's error.

    The diagonal is quadratic in u, the rest constant: a chain of lumped masses, dampers and springs, each complex.
    """
    terms, start, _ = _straight_lines(lines)
    trial = _Trial(lines, terms)
    try:
        solved = minimise(trial, start.view(float), options=_BRIEFLY)
    except np.linalg.LinAlgError:  # a singular matrix on the way: no verdict
        return None
    if not solved.success:
        return None
    values = solved.x[::2] + 1j * solved.x[1::2]
    variance = 2 * solved.cost / max(2 * lines.H.size - solved.x.size, 1)
    covariance = np.linalg.pinv(trial.gauss_newton(solved.x)[2]) * variance
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0).reshape(-1, 2).mean(axis=1))
    return terms, values, errors


class _Trial:
    """Misfit of such polynomials, over the largest response; the vector holds real and imaginary parts in turn."""

    def __init__(self, lines: Lines, terms: Sequence[tuple[int, int, int]], *, upright: bool = False):
        """Take the data."""
        self.u, self.H, self.terms, self.scale = lines.u, lines.H, terms, np.abs(lines.H).max()
        real = [2 * i + 1 for i, (*_, power) in enumerate(terms) if power == 2] if upright else []
        self.free = np.delete(np.arange(2 * len(terms)), real)

    def response(self, x: Float) -> ComplexArray:
        """Responses at a vector."""
        parts = np.zeros(2 * len(self.terms))
        parts[self.free] = x
        kappa = np.zeros(self.H.shape, dtype=complex)
        for (q, k, power), value in zip(self.terms, parts[::2] + 1j * parts[1::2], strict=True):
            kappa[:, q, k] += value * self.u**power
        return np.asarray(np.linalg.inv(kappa))

    def residuals(self, x: Float) -> Float:
        """Real and imaginary parts in turn."""
        return np.asarray(((self.response(x) - self.H) / self.scale).ravel().view(float))

    def jacobian(self, x: Float) -> Float:
        """Their derivatives."""
        G = self.response(x)
        columns = []
        for q, k, power in self.terms:
            slope = -G[:, :, q, None] * G[:, None, k, :] * (self.u**power)[:, None, None] / self.scale
            columns += [slope.ravel().view(float), (1j * slope).ravel().view(float)]
        return np.stack(columns, axis=1)[:, self.free]

    def cost(self, x: Float) -> float:
        """Half the sum of squares."""
        return float(np.sum(self.residuals(x) ** 2)) / 2

    def gauss_newton(self, x: Float) -> tuple[float, Float, Float]:
        """Cost, gradient and Gauss-Newton matrix."""
        r, J = self.residuals(x), self.jacobian(x)
        return float(r @ r) / 2, J.T @ r, J.T @ J

    def hessian(self, x: Float) -> Float:
        """The Gauss-Newton matrix in its place."""
        return self.gauss_newton(x)[2]


def unexplained(lines: Lines, *, upright: bool) -> float:
    """Half the sum of squares that polynomials leave, with probes free to be turned or not."""
    from scipy.optimize import least_squares  # late: loading it takes longer than a fit

    terms, start, _ = _straight_lines(lines)
    trial = _Trial(lines, terms, upright=upright)
    try:
        solved = least_squares(
            trial.residuals,
            start.view(float)[trial.free],
            jac=trial.jacobian,
            x_scale="jac",
            ftol=1e-4,
            xtol=1e-4,
            max_nfev=_LONG if upright else _SHORT,
        )
    except (ValueError, np.linalg.LinAlgError):  # a singular matrix on the way: no verdict
        return float("nan")
    return float(solved.cost)


def _straight_lines(lines: Lines) -> tuple[list[tuple[int, int, int]], ComplexArray, Float]:
    """What :func:`_polynomial` answers by linear least squares on the inverse of each response matrix."""
    kappa, n = lines.kappa, lines.kappa.shape[-1]
    weight = 1 / squared_norm(kappa)  # d kappa = -kappa dH kappa
    entries = (kappa * weight[..., None, None]).reshape(*weight.shape, n * n)
    own = np.arange(n * n) % (n + 1) == 0
    parts = [_least_squares(weight[..., None] * lines.u[:, None] ** np.arange(3), entries[..., own])]
    terms = [(q, q, order) for q in range(n) for order in range(3)]
    if n > 1:
        parts.append(_least_squares(weight[..., None], entries[..., ~own]))
        terms += [(q, k, 0) for q in range(n) for k in range(n) if q != k]
    values, errors = (np.concatenate(found, axis=-1) for found in zip(*parts, strict=True))
    return terms, values, errors


def _least_squares(design: Float, readings: ComplexArray) -> tuple[ComplexArray, Float]:
    """Factors of ``k`` columns, and their errors, for each of some readings, the factors of one following one another.

    Returns:
        both, shape ``(..., m k)``.
    """
    across = np.swapaxes(design, -1, -2)
    normal = across @ design
    inverse = surely_inverse(normal)
    if inverse is None:
        inverse = np.linalg.pinv(normal)
    factors = inverse @ (across @ readings)
    miss = readings - design @ factors
    variance = (miss.real**2 + miss.imag**2).sum(axis=-2) / (2 * max(design.shape[-2] - design.shape[-1], 1))
    known = np.maximum(np.diagonal(inverse, axis1=-2, axis2=-1).real, 0.0)
    errors = np.sqrt(variance[..., :, None] * known[..., None, :])
    return np.swapaxes(factors, -1, -2).reshape(*errors.shape[:-2], -1), errors.reshape(*errors.shape[:-2], -1)
