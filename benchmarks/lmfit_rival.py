"""The rival: eq. (18) fitted by lmfit with a residual vectorised by hand. Run as a script, one fit in a fresh process.

python benchmarks/lmfit_rival.py DATA.npz
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import lmfit  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


def residual(parameters: lmfit.Parameters, data: Mapping[str, Any]) -> Float:
    """Whitened residuals, real and imaginary parts; rows of the responses are disk and journal, columns the forces."""
    p = parameters.valuesdict()
    w = data["w"]
    u = w - p["lam"] * data["speed"]
    disk = p["K1"] + p["K2"] - p["Md"] * w**2 + 1j * p["Ds"] * w
    journal = p["K0"] + data["K3"] + p["K2"] * p["sigma"] - p["Mb"] * w**2 - p["Mf"] * u**2 + 1j * p["D"] * u
    response = np.empty_like(data["measured"])
    response[0, 0] = journal
    response[0, 1] = p["K2"] * p["sigma"]
    response[1, 0] = p["K2"]
    response[1, 1] = disk
    response /= disk * journal - p["K2"] ** 2 * p["sigma"]
    response -= data["measured"]
    response *= data["weight"]
    return np.asarray(response.ravel().view(float))


def fit(data: Mapping[str, Any], start: Mapping[str, float], **settings: float) -> lmfit.minimizer.MinimizerResult:
    """Levenberg-Marquardt from the start values; settings go to MINPACK."""
    parameters = lmfit.Parameters()
    for name, value in start.items():
        parameters.add(name, value=value)
    return lmfit.minimize(residual, parameters, args=(data,), **settings)


if __name__ == "__main__":
    arrays = dict(np.load(sys.argv[1]))
    result = fit(arrays, dict(zip(arrays["names"].tolist(), arrays["start"].tolist(), strict=True)))
    print(*[parameter.value for parameter in result.params.values()])
