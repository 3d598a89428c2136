"""Ratios of polynomials through complex curves, by linear steps (Sanathanan and Koerner 1963)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import ComplexArray, Float


def best_ratio(
    response: ComplexArray,
    sigma: Float,
    powers: Float | ComplexArray,
    numerators: Float | ComplexArray,
    *,
    real: bool = False,
) -> tuple[ComplexArray, ComplexArray, float]:
    """Denominator, numerators and half the sum of squares that they leave, of the best of several passes."""
    target: ComplexArray = response / sigma
    free = powers.shape[1] - 1
    found: list[tuple[ComplexArray, ComplexArray, float]] = []
    weight = 1 / sigma
    for _ in range(12):
        columns = np.hstack([response[:, None] * powers[:, :free], -numerators, *([-1j * numerators] * real)])
        known = np.asarray(-response * powers[:, free] * weight)
        lower = least_squares(columns * weight[:, None], known, real=real)[:free]
        denominator = np.append(lower, 1.0)
        over = powers @ denominator
        basis = np.asarray(numerators / (over * sigma)[:, None])
        numerator = least_squares(basis, target)
        miss = basis @ numerator - target
        found.append((denominator, numerator, 0.5 * float(np.vdot(miss, miss).real)))
        weight = 1 / (sigma * np.abs(over))
    return min(found, key=lambda ratio: ratio[2])


def least_squares(columns: NDArray[Any], target: NDArray[Any], *, real: bool = False) -> NDArray[Any]:
    """Unknowns ``(p,)`` of linear equations ``(R, p)``, columns brought to one length; ``real`` ones of complex
    equations."""
    if real:
        columns, target = np.concatenate([columns.real, columns.imag]), np.concatenate([target.real, target.imag])
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > 0, size, 1.0)
    return np.asarray(np.linalg.lstsq(columns / size, target, rcond=None)[0] / size)


@dataclass(frozen=True, eq=False, kw_only=True)
class Ratio:
    """A ratio of two polynomials."""

    denominator: ComplexArray  # coefficients of Chebyshev's polynomials of x over ``top``
    numerator: ComplexArray  # coefficients of Chebyshev's polynomials of x over ``top``
    top: float  # largest size of x

    def __call__(self, x: Float) -> ComplexArray:
        """Values at x."""
        over, under = (np.polynomial.chebyshev.chebval(x / self.top, c) for c in (self.numerator, self.denominator))
        return np.asarray(over / under)


def ratio_through(x: Float, y: ComplexArray) -> Ratio | None:
    """The ratio with as many modes as y needs (Schwarz's criterion), none where one is too many already. The
    denominator is a real polynomial of jx, as that of a rotor is: poles at -x, where nothing was read, are the mirror
    images of those at x."""
    top = float(np.abs(x).max())
    step = float(np.median(np.diff(np.sort(x)))) / top
    sigma, best, least = np.ones(x.size), None, np.inf
    most_modes = 4  # most modes that a curve is given
    readings_an_unknown = 2  # readings an unknown that a curve needs
    # half width of a resonance, in steps between readings, below which it is one of the noise
    narrowest_resonance = 0.25
    for poles in range(2, 2 * most_modes + 1, 2):
        unknowns = poles + 2 * (poles + 1)
        if 2 * x.size < readings_an_unknown * unknowns:
            break
        powers = np.asarray(np.polynomial.chebyshev.chebvander(x / top, poles), dtype=float)
        turn = 1j ** np.arange(poles + 1)  # makes real polynomials of jx of those of x
        lower, numerator, cost = best_ratio(y, sigma, powers * turn, powers, real=True)
        denominator = np.asarray(lower * turn)
        roots = np.polynomial.chebyshev.chebroots(denominator)
        inside = (roots.real > x.min() / top) & (roots.real < x.max() / top)
        score = 2 * x.size * np.log(2 * cost) + unknowns * np.log(2 * x.size) if cost > 0 else -np.inf
        if score < least and not (np.abs(roots.imag[inside]) < narrowest_resonance * step).any():
            best, least = Ratio(denominator=denominator, numerator=numerator, top=top), score
    return best
