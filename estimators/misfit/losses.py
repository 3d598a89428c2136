"""Losses: what a residual costs, squared or discounted where it cannot be noise."""

from __future__ import annotations

from typing import Literal

import numpy as np

from rotorfit.models.array_types import Float

Loss = Literal["linear", "soft_l1", "huber", "cauchy"]

LOSSES: tuple[Loss, ...] = ("linear", "soft_l1", "huber", "cauchy")
LOSS_SCALE = 2.0
"""Whitened residual modulus beyond which a robust loss discounts; the noise's own rms modulus is sqrt(2)."""


def robust_weights(loss: Loss, size2: Float) -> tuple[Float, Float]:
    """Cost ``rho`` (that of the fit is sum(rho)/2) of squared residual moduli, and ``d rho / d size2``."""
    if loss == "linear":
        return size2, np.ones_like(size2)
    c2 = LOSS_SCALE**2
    z = size2 / c2
    if loss == "soft_l1":
        root = np.sqrt(1 + z)
        return 2 * c2 * (root - 1), 1 / root
    if loss == "huber":
        root = np.sqrt(np.maximum(z, 1))
        return np.where(z <= 1, size2, c2 * (2 * root - 1)), 1 / root
    return c2 * np.log1p(z), 1 / (1 + z)
