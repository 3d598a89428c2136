"""One mode run through by a steady ramp of speed: the free vibration rings on and beats with the unbalance's.

With ``theta = alpha t^2 / 2`` and ``Omega = alpha t`` the unbalance's force is ``-U d^2 exp(j theta)/dt^2``. The
response to ``exp(j theta)`` is a convolution of exponentials with a chirp, a scaled complementary error function of
complex argument; what a quasi-steady fit takes for the resonance comes late, at too high a speed on the way up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float

_LEAST_RISE = 0.04  # rise on both sides of a minimum, as a fraction of the peak, that makes it one
_LARGEST_UNEVENNESS = 0.25  # relative deviation from even steps in (Omega - peak)^2 that still is a beat; chosen


@dataclass(frozen=True, kw_only=True)
class Ramp:
    """One mode under a ramp of speed."""

    rate: float  # change of the speed, rad/s^2
    rate_error: float  # its standard error, rad/s^2
    wn: float  # natural frequency, rad/s
    wn_error: float  # its standard error, rad/s
    steady_wn: float  # natural frequency that a quasi-steady fit up to the beating gives, rad/s
    beats_from: float  # speed from which the amplitude beats, rad/s


def ramp_response(speed: Float, wn: float, zeta: float, rate: float) -> ComplexArray:
    """Response of a mode to a unit unbalance per modal mass, relative to ``exp(j theta)``, shape of ``speed``."""
    from scipy.special import wofz  # takes long to import, and few tests are run-ups

    s = wn * (-zeta + np.array([1j, -1j]) * np.sqrt(1 - zeta**2))
    root = np.sqrt(-0.5j * rate)
    parts = [0.5 * np.sqrt(np.pi) / root * wofz(0.5j * (1j * speed - pole) / root) for pole in s]
    y = (parts[0] - parts[1]) / (s[0] - s[1])
    slope = (s[0] * parts[0] - s[1] * parts[1]) / (s[0] - s[1])
    return np.asarray(2 * zeta * wn * slope + wn**2 * y - 1.0)


def steady_response(speed: Float, wn: float, zeta: float) -> ComplexArray:
    """The same where the speed does not change: ``Omega^2/(wn^2 - Omega^2 + 2 j zeta wn Omega)``."""
    return np.asarray(speed**2 / (wn**2 - speed**2 + 2j * zeta * wn * speed))


def find_beat(speed: Float, response: ComplexArray) -> tuple[float, float, float] | None:
    """True if the amplitude beats beyond its peak as a ramp makes it. Minima of the beat follow each other at even
    steps of the square of the distance from the resonance, ``4 pi rate`` apart. Returns the speed of the peak, speed of
    the first minimum beyond it, and the ramp's rate, rad/s^2; None without a beat."""
    from scipy.signal import find_peaks  # loads much of SciPy, and few tests are run-ups

    size = np.abs(response)
    peak = int(np.argmax(size))
    least = peak + find_peaks(-size[peak:], prominence=_LEAST_RISE * float(size[peak]))[0]
    if least.size < 3:
        return None
    most_beats = 5  # minima looked at: later ones drown in noise
    least = least[:most_beats]
    square = (speed[least] - speed[peak]) ** 2
    steps = np.diff(square)
    typical = float(np.median(steps))
    if (steps <= 0).any() or np.abs(steps - typical).max() > 2 * _LARGEST_UNEVENNESS * typical:
        return None
    return float(speed[peak]), float(speed[least[0]]), typical / (4 * np.pi)


def fit_ramp(speed: Float, response: ComplexArray) -> Ramp | None:
    """Natural frequency from a run-up that rings on, the ramp fitted with it; None where nothing beats. Beside mode and
    ramp a constant vector is fitted: run-out, and other modes."""
    order = np.argsort(speed)
    w, y = speed[order], response[order] / np.abs(response).max()
    fewest = 20  # samples that the fit of seven numbers needs at least
    beat = find_beat(w, y) if w.size >= fewest else None
    if beat is None:
        return None
    peak, first, rate = beat
    near = w < 2 * first - peak + 0.5 * (first - peak)
    early = w < first
    steady = _solve(w[early], y[early], np.array([peak, 0.03]), steady_response)
    factor_range = 4.0  # ramps tried about that of the beat, each way, as a factor
    tries = [
        _solve(w[near], y[near], np.array([peak - 0.02 * k * peak, 0.02, rate * factor]), ramp_response)
        for k in (0, 1, 2)
        for factor in np.geomspace(1 / factor_range, factor_range, 3)
    ]
    best = min(tries, key=lambda found: found[2])
    values, errors, _ = best
    return Ramp(
        rate=float(values[2]),
        rate_error=float(errors[2]),
        wn=float(values[0]),
        wn_error=float(errors[0]),
        steady_wn=float(steady[0][0]),
        beats_from=first,
    )


def _solve(w: Float, y: ComplexArray, start: Float, shape: Callable[..., ComplexArray]) -> tuple[Float, Float, float]:
    """Nonlinear numbers with standard errors, and the squares that remain."""

    from scipy.optimize import least_squares  # takes long to import, and few tests are run-ups

    def miss(u: Float) -> Float:
        basis = np.column_stack([shape(w, *(u * start).tolist()), np.ones(w.size)])
        left = y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
        return np.asarray(left).view(float)

    low, high = np.full(start.size, 0.1), np.full(start.size, 10.0)
    low[0], high[0] = 0.8, 1.2
    found = least_squares(
        miss, np.ones(start.size), bounds=(low, high), x_scale=np.r_[0.01, np.full(start.size - 1, 0.3)]
    )
    left = float(np.sum(found.fun**2))
    freedom = max(2 * w.size - start.size - 4, 1)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * left / freedom
    return found.x * start, np.sqrt(np.diag(covariance)) * start, left
