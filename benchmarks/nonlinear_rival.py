"""The rival of nonlinear_speed.py: an amplitude sweep of one mode with Muszynska's law, its residual written by hand.

The eccentricity of each reading is found by Newton's method over all readings at once, from the measured one on.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import lmfit  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

_STEPS = 12
_LARGEST = 1 - 1e-9


def response(p: Mapping[str, float], data: Mapping[str, Any]) -> NDArray[np.complex128]:
    """Amplitude of each reading, m, in the orbit nearest to the measured one.

    Args:
        p: all parameters of the rotor and the law.
        data: frequency ``w`` and force of each reading, ``speed``, ``clearance``, ``eps`` as measured.
    """
    w, u = data["w"], data["w"] - p["lam"] * data["speed"]
    own = p["K"] - p["M"] * w**2 + 1j * p["Ds"] * w
    eps = data["eps"]
    for _ in range(_STEPS):
        wide, narrow = 1 - eps**2, (1 - eps) ** p["b"]
        K, D = p["K0"] * wide ** -p["n_K"], p["D"] * wide ** -p["n_D"]
        u = w - p["lam"] * narrow * data["speed"]
        kappa = own + K + 1j * D * u - p["Mf"] * u**2
        du = p["lam"] * p["b"] * narrow / (1 - eps) * data["speed"]
        rise = 2 * eps / wide
        slope = K * p["n_K"] * rise + 1j * (D * p["n_D"] * rise * u + D * du) - 2 * p["Mf"] * u * du
        size = data["force"] / np.abs(kappa) / data["clearance"]
        step = (size - eps) / (1 + size * (slope / kappa).real)
        eps = np.clip(eps + step, 0.0, _LARGEST)
        if np.abs(step).max() < 1e-11:
            break
    return np.asarray(data["force"] / kappa)


def residual(parameters: lmfit.Parameters, data: Mapping[str, Any]) -> Float:
    """Whitened residuals, real and imaginary parts."""
    miss = (response(parameters.valuesdict() | data["known"], data) - data["measured"]) * data["weight"]
    return np.asarray(miss.view(float))


def fit(data: Mapping[str, Any], start: Mapping[str, float], **settings: float) -> lmfit.minimizer.MinimizerResult:
    """Levenberg-Marquardt from the start values; settings go to MINPACK."""
    parameters = lmfit.Parameters()
    for name, value in start.items():
        parameters.add(name, value=value)
    with np.errstate(all="ignore"):  # trial points may be absurd
        return lmfit.minimize(residual, parameters, args=(data,), nan_policy="propagate", **settings)
