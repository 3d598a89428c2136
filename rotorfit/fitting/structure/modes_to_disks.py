"""From two modes to the matrices of a two-disk rotor (eq. 23), errors carried along."""

from __future__ import annotations

import numpy as np

from rotorfit.fitting.quantities import Quantity
from rotorfit.fitting.result import FitResult
from rotorfit.fitting.structure.coefficients import central_differences
from rotorfit.models import Modal
from rotorfit.models.array_types import Float
from rotorfit.models.parameters import MATRIX_UNITS


def two_disk_from_modes(fit: FitResult) -> dict[str, Quantity]:
    """Masses, stiffnesses and dampings of a two-disk rotor (eq. 19) from its two modes.

    With the mode shapes as columns, ``phi = [[1, 1], [phi1, phi2]]``, and modal masses, stiffnesses and dampings on
    diagonals, ``M = phi^-T M_m phi^-1`` and so for K and D (eq. 23). Shapes are those of the participations of forces.
    Damping that couples the modes is left out, as in the paper; the standard errors of D do not count that.

    Args:
        fit: of a ``Modal`` of two modes whose two planes, both forced, are the disks.

    Returns:
        ``M1, M2, K1, K2, K3, D11, D12, D21, D22`` of :class:`rotorfit.models.TwoDisk`, the off-diagonal mass ``M12``,
        which lumped disks do not have, and standard errors by the delta method.

    Raises:
        ValueError: another model, or modes of one shape.

    Example:
        >>> modes = rf.models.Modal(("inboard", "outboard"), modes=2, gains="plane")
        >>> disks = rf.two_disk_from_modes(rf.fit(modes, rf.datasets.two_disk()))
        >>> f"{disks['M1'].value:.2f} {disks['M1'].unit}"
        '0.73 kg'
    """
    model = fit.model
    if not isinstance(model, Modal) or model.modes != 2 or len(model.planes) != 2 or model.apart:
        raise ValueError("eq. (23) needs a fit of Modal with two modes at two planes, x and y not apart")
    if len(model.force_planes) != 2:
        raise ValueError("eq. (23) needs a participation of both planes: force both")
    theta = fit.thetas[0]
    values = disk_values(model, theta)
    step = 1e-6 * np.maximum(np.abs(theta), 1e-3)
    slopes = central_differences(lambda theta: list(disk_values(model, theta).values()), theta, step)
    pairs = zip(values.items(), slopes, strict=True)
    return {name: fit.propagate(value, slope, MATRIX_UNITS[name[0]]) for (name, value), slope in pairs}


def disk_values(model: Modal, theta: Float) -> dict[str, float]:
    """Entries of the two-disk rotor's matrices from the parameters of two modes, shape ``(P,)``."""
    p = dict(zip(model.parameter_names, theta.tolist(), strict=True))
    second = model.planes[1]
    shapes = np.array([[1.0, 1.0], [p[f"phi1_{second}"], p[f"phi2_{second}"]]])
    if abs(np.linalg.det(shapes)) < 1e-9 * np.abs(shapes).max():
        raise ValueError("the two modes have one shape: no two disks vibrate so")
    back = np.linalg.inv(shapes)
    mass, wn, zeta = (np.array([p[f"{letter}{i}"] for i in (1, 2)]) for letter in ("M", "wn", "zeta"))
    M, K, D = (back.T @ np.diag(modal) @ back for modal in (mass, mass * wn**2, 2 * mass * zeta * wn))
    return {
        "M1": float(M[0, 0]), "M2": float(M[1, 1]), "M12": float(M[0, 1]),
        "K1": float(K[0, 0] + K[0, 1]), "K2": float(-K[0, 1]), "K3": float(K[1, 1] + K[0, 1]),
        "D11": float(D[0, 0]), "D12": float(-D[0, 1]), "D21": float(-D[1, 0]), "D22": float(D[1, 1]),
    }  # fmt: skip
