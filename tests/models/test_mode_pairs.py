"""Left and right modes: their sum is the inverse of the dynamic stiffness, and they are biorthogonal."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import TYPICAL

from rotorfit.models import Anisotropic, Chain, KnownStructure, Overhung, RotorModel, WhirlWhip, mode_pairs

SHAFT = 1e5 * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])


def rotors() -> list[tuple[RotorModel, dict[str, float]]]:
    fluid = {"K0": 1e4, "D": 400.0, "lam": 0.47, "Mf": 0.3}
    chain = {"M1": 1.5, "M2": 2.0, "M3": 0.8, "K1": 3e4, "K2": 4e4, "K3": 2.5e4, "K4": 1e4} | {
        f"Ds{i}": 10.0 for i in (1, 2, 3)
    }
    known = KnownStructure(
        np.diag([1.0, 2.0, 3.0]), None, None, SHAFT, planes={"disk": 1, "seal": 2}, fluid="seal", dofs=("z",)
    )
    cross = dict.fromkeys(Anisotropic().parameter_names, 0.0) | {
        "Kxx": 9e5, "Kxy": 8e4, "Kyx": -2e4, "Kyy": 7e5, "Dxx": 400.0, "Dyy": 300.0, "Mxx": 12.0, "Myy": 11.0,
    }  # fmt: skip
    return [
        (Chain(3, fluid="mass-3"), chain | fluid),
        (known, fluid),
        (WhirlWhip(), TYPICAL["whirl-whip"]),
        (Overhung(), TYPICAL["overhung"]),
        (Anisotropic(), cross),
    ]


@pytest.mark.parametrize(("model", "values"), rotors(), ids=lambda given: getattr(given, "name", ""))
def test_their_sum_is_the_receptance(model: RotorModel, values: dict[str, float]) -> None:
    theta, speed, w = model.vector(values), 150.0, np.array([-90.0, 40.0, 210.0])
    rate = w if model.frame == "z" else np.abs(w)
    pairs = mode_pairs(model, theta, speed)
    total = np.einsum("mi,mj,wm->wij", pairs.right, pairs.left, 1 / (1j * rate[:, None] - pairs.s))
    exact = model.receptance(theta, w, speed)
    # eigenvalues are right to round-off of the largest, which grows by the spread of a rotor's frequencies
    np.testing.assert_allclose(total, exact, rtol=1e-6, atol=1e-8 * np.abs(exact).max())


def test_modes_of_different_eigenvalues_are_biorthogonal() -> None:
    model, values = rotors()[0]
    theta = model.vector(values)
    pairs, C = mode_pairs(model, theta, 150.0), model.coefficients(theta, 150.0)
    powers = pairs.s[:, None] ** np.arange(3)
    kappa = np.einsum("mk,kij->mij", powers, C)
    for i in range(pairs.s.size):
        for j in range(pairs.s.size):
            product = pairs.left[i] @ (kappa[i] - kappa[j]) @ pairs.right[j]
            size = np.abs(pairs.left[i]) @ np.abs(kappa[j]) @ np.abs(pairs.right[j])
            assert abs(product) < 1e-9 * size + 1e-12


def test_they_differ_by_modal_correction_factors_and_by_cross_coupling() -> None:
    """A fluid leaves matrices in x + jy symmetric; row and column of the coupling in eq. (18) differ by sigma."""
    for model, values in rotors()[:2]:
        pairs = mode_pairs(model, model.vector(values), 150.0)
        left, right = (m / m[:, :1] for m in (pairs.left, pairs.right))
        np.testing.assert_allclose(left, right, rtol=1e-6, atol=1e-9)
    model, values = rotors()[2]
    pairs = mode_pairs(model, model.vector(values), 150.0)
    left, right = (m[:, 1] / m[:, 0] for m in (pairs.left, pairs.right))
    np.testing.assert_allclose(left, values["sigma"] * right, rtol=1e-6)
