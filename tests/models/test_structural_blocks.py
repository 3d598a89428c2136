"""Structural blocks against a finite-element shaft condensed exactly to its planes."""

from __future__ import annotations

import numpy as np
import pytest
from fe_rigs import DISK, JOURNAL, TYPICAL, Rig

from rotorfit.models import WhirlWhip

PLANES = [2 * DISK, 2 * JOURNAL]
SECOND = ("coupling_mass", "gyroscopic", "out_of_band", "gyroscopic_out_of_band", "gyroscopic_squared")
RIG = Rig(**TYPICAL)
REST = [k for k in range(len(RIG.K)) if k not in PLANES]


def condensed(w, speed):
    """Dynamic stiffness of the shaft at its planes, without fluid and dampers, shape ``(2, 2)``."""
    D = RIG.K - w**2 * RIG.M + w * speed * RIG.G
    across = D[np.ix_(PLANES, REST)]
    return D[np.ix_(PLANES, PLANES)] - across @ np.linalg.solve(D[np.ix_(REST, REST)], across.T)


def lumped(blocks):
    """The model and its parameters from the shaft's matrices: the expansion of what is condensed, term by term."""
    inside = RIG.K[np.ix_(REST, REST)]
    T = np.zeros((len(RIG.K), 2))
    T[PLANES] = np.eye(2)
    T[REST] = -np.linalg.solve(inside, RIG.K[np.ix_(REST, PLANES)])
    k, m, g = (T.T @ A @ T for A in (RIG.K, RIG.M, RIG.G))
    by_mass, by_gyro = (RIG.M @ T)[REST], (RIG.G @ T)[REST]  # R = w^2 by_mass - w Om by_gyro
    yielding, turned = np.linalg.solve(inside, by_mass), np.linalg.solve(inside, by_gyro)
    h = by_mass.T @ turned
    terms = {
        "g": g, "q": -by_mass.T @ yielding, "h": h + h.T, "e": by_gyro.T @ turned,
        "r": yielding.T @ RIG.M[np.ix_(REST, REST)] @ yielding,
    }  # fmt: skip
    model = WhirlWhip(blocks=blocks)
    values = dict.fromkeys(model.parameter_names, 0.0) | {
        "K1": k[0, 0] + k[0, 1], "K2": -k[0, 1], "K3": k[1, 1] + k[0, 1], "Md": m[0, 0], "Mb": m[1, 1],
        "m12": m[0, 1], "sigma": 1.0,
    }  # fmt: skip
    for symbol, matrix in terms.items():
        values |= {f"{symbol}{i + 1}{j + 1}": matrix[i, j] for i, j in ((0, 0), (0, 1), (1, 1))}
    return model, model.vector({name: values[name] for name in model.parameter_names})


def missed(blocks, w, speed):
    """Largest error of the model's dynamic stiffness."""
    model, theta = lumped(blocks)
    own = model.dynamic_stiffness(theta, np.array([w]), speed)[0]
    return np.abs(own - condensed(w, speed)).max()


@pytest.mark.parametrize(
    ("blocks", "speed", "order"),
    [
        (SECOND[:2], 1.5, 4),  # the square of R is missing: w^4, w^3 Om, w^2 Om^2
        (SECOND[:-1], 1.5, 4),  # one of the three will not do
        (SECOND, 1.5, 6),
        (("coupling_mass", "out_of_band"), 0.0, 6),
        (("coupling_mass", "out_of_band", "next_out_of_band"), 0.0, 8),
    ],
)
def test_blocks_are_the_expansion_of_a_condensed_shaft(blocks, speed, order):
    """Frequency and speed together: half of both leaves 2^-order of the error, to the next order's share of w^2."""
    w = 200.0  # a seventh of the lowest natural frequency with the planes held
    once, twice = missed(blocks, w, speed * w), missed(blocks, w / 2, speed * w / 2)
    assert np.log2(once / twice) == pytest.approx(order, abs=0.3)
