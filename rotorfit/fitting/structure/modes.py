"""Damped natural frequencies and damping ratios of a fitted rotor, with their errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.fitting.quantities import Quantity
from rotorfit.models import eigenvalues
from rotorfit.models.motion.stability import eigenvalue_gradient, is_image
from rotorfit.models.shafts.angular_rates import angular_rate

if TYPE_CHECKING:
    from rotorfit.fitting.result import FitResult


def natural_frequencies(fit: FitResult, speed: float, at: Mapping[str, Any] | None) -> list[tuple[Quantity, Quantity]]:
    """Damped natural frequency (rad/s, signed) and damping ratio of each mode; see the result's method."""
    speed = angular_rate(speed)
    theta, model = fit.theta(at), fit.model
    modes = []
    back = 1j * speed if model.turns else 0.0  # from turning coordinates
    for found in eigenvalues(model, theta, speed).tolist():
        if not np.isfinite(found) or abs(found) > fit.stability_band or is_image(model, theta, speed, found):
            continue
        _, by_theta = eigenvalue_gradient(model, theta, speed, found)
        s = found + back
        size = abs(s)
        # zeta = -Re s / |s|
        slope = -by_theta.real / size + s.real * (s.real * by_theta.real + s.imag * by_theta.imag) / size**3
        frequency = fit.propagate(s.imag, by_theta.imag, "rad/s", at)
        modes.append((frequency, fit.propagate(-s.real / size, slope, "1", at)))
    return modes
