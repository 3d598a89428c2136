"""Frequency of a perturbation without a mark, from the motion it causes: steady, so that one number says it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import BSpline

from rotorfit.estimators.signals.shaft_angle import SPLINE_DEGREE, SmoothAngle
from rotorfit.estimators.signals.spectral_lines import full_spectrum
from rotorfit.models.array_types import ComplexArray, Float

_LARGEST_PHASE_SCATTER = 0.35
"""Scatter of the phase about a straight line, rad, beyond which a frequency is not steady: 6 % of a vector is lost."""
_LINE_AMPLITUDE_OVER_MEDIAN = 8.0
"""Amplitude of the line over the median of the spectrum on its side."""


def steady_angle(z: ComplexArray, rate: float, direction: int, avoid: Sequence[float]) -> SmoothAngle:
    """Angle of a perturbation at a steady frequency; zero at time zero, since nothing says where its mark would be."""
    near = _outstanding_line(z, rate, direction, avoid)
    t = np.arange(z.size) / rate
    beyond, error = _rate_of_phase(z * np.exp(-2j * np.pi * near * t), t, near)
    speed = direction * (2 * np.pi * near + beyond)
    end = z.size / rate
    knots = np.concatenate([np.zeros(SPLINE_DEGREE + 1), np.full(SPLINE_DEGREE + 1, end)])
    coefficients = speed * np.linspace(0.0, end, SPLINE_DEGREE + 1)
    return SmoothAngle(
        spline=BSpline(knots, coefficients, SPLINE_DEGREE, extrapolate=True),
        begin=0.0,
        end=end,
        jitter=error / abs(speed),
        groups=np.array([[0.0, end], [error, error]]),
        shares=np.ones(2),
        share_t=np.array([0.0, end]),
        pattern=np.zeros(1),
        outlying=np.zeros(0),
        pulses=0,
    )


def _outstanding_line(z: ComplexArray, rate: float, direction: int, avoid: Sequence[float]) -> float:
    """Signed frequency of the spectrum's largest line on a side, Hz, other than those to avoid."""
    frequency, amplitude = full_spectrum(z, rate)
    step = rate / z.size
    mine = (direction * frequency > 3 * step) & (amplitude > 0)
    for line in avoid:
        mine &= np.abs(frequency - line) > 4 * step
    if not mine.any():
        raise ValueError("the recording is too short to tell the perturbation from the orders of the shaft")
    peak = int(np.argmax(np.where(mine, amplitude, 0.0)))
    if amplitude[peak] < _LINE_AMPLITUDE_OVER_MEDIAN * float(np.median(amplitude[mine])):
        raise ValueError(
            "no line stands out of the spectrum beside the orders of the shaft: is the perturbator running?"
        )
    return float(frequency[peak])


def _rate_of_phase(turned: ComplexArray, t: Float, near: float) -> tuple[float, float]:
    """Rate at which a slow vector turns, rad/s, and its standard error, by the phases of its means over blocks."""
    pieces = 24
    size = turned.size // pieces
    weight = np.hanning(size + 2)[1:-1]
    vectors = (turned[: size * pieces].reshape(pieces, size) * weight).sum(axis=1)
    middle = t[: size * pieces].reshape(pieces, size).mean(axis=1)
    phase = np.unwrap(np.angle(vectors))
    line, covariance = np.polyfit(middle, phase, 1, cov=True)
    scatter = float(np.std(phase - np.polyval(line, middle)))
    if scatter > _LARGEST_PHASE_SCATTER:
        raise ValueError(
            f"the line at {abs(near):.3f} Hz is not steady, its phase wanders by {scatter:.2f} rad; "
            "a swept perturbation needs a mark"
        )
    return float(line[0]), max(float(np.sqrt(covariance[1, 1])), 1e-12)
