"""The pole nearest to a piece of frequency responses, so that bands narrower than the resonance are not needed.

Around a resonance every response is ``(smooth)/(w - p)`` with one pole p for all of them. From rough responses in a
window, ``w H = p H + q(w)`` with a quadratic q for each response is linear in p and q (Levy's linearisation), weighted
by ``1/(sigma |w - p|)`` with the p of the step before (Sanathanan and Koerner 1963). A pole that is a little off costs
little: a smooth function over ``w - p`` stands for the responses as well as a polynomial does, and better.
"""

from __future__ import annotations

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float

SMOOTH_DEGREE = 2
"""Degree of the polynomials that a response and a transient are in a band: its numerator, where it has a pole there."""


def nearest_pole(frequency: Float, response: ComplexArray, sigma: Float) -> complex:
    """Pole in the upper half-plane of w (a mode that decays), NaN where the responses show none."""
    middle = float(frequency.mean())
    half = float(np.ptp(frequency)) / 2
    x = (frequency - middle) / half
    powers = np.vander(x, SMOOTH_DEGREE + 1)
    pole = complex(np.inf)
    for _ in range(4):
        weight = 1 / (sigma * (1.0 if np.isinf(pole) else np.abs(x - pole)))
        q = np.linalg.qr(powers * weight[:, :, None])[0]
        # what is left of H and of x H beside the quadratics
        both = np.stack([response * weight, response * weight * x], axis=2)
        both -= q @ (q.swapaxes(1, 2) @ both)
        top, bottom = np.vdot(both[:, :, 0], both[:, :, 1]), np.vdot(both[:, :, 0], both[:, :, 0])
        if abs(bottom) < response.size:  # what is not smooth of the responses is their noise
            return complex(np.nan, np.nan)
        pole = complex(top / bottom)
    return middle + half * pole if pole.imag > 0 else complex(np.nan, np.nan)
