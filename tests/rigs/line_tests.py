"""Spectral lines of a shaft that is not round, with white noise."""

from __future__ import annotations

import numpy as np

import rotorfit as rf
from rotorfit.models.shafts.combination_lines import line_order

SPEED = 120.0
W = -np.linspace(30.0, 310.0, 60)
FORCE = 3e-5 * W**2
ROUND = {"M": 1.0, "D": 14.0, "K": 4e4, "ec": 6e-5, "es": 2e-5, "Px": 1.0, "Py": -8.0}
VALUES = ROUND | rf.models.AnisotropicShaft.components(2000.0, 0.6)
TORSION = {"J": 2e-4, "nu_t": 340.0, "zeta_t": 0.01}
NOISE = {"z": 2e-7, "twist": 5e-7}


def line_test(model, values, kinds, rng, steady=(), sweep=W):
    """Lines of a model with white noise."""
    theta = model.vector(values)
    kinds = [(*kind, sweep, 3e-5 * sweep**2) for kind in kinds] + [
        ("z", name, np.zeros(1), np.zeros(1)) for name in steady
    ]
    columns = {name: [] for name in ("frequency", "force", "direction", "line", "response", "sigma")}
    for direction, line, w, force in kinds:
        clean = np.broadcast_to(model.lines(theta, direction, line_order(direction, line), w, SPEED, force), w.shape)
        sigma = NOISE[direction]
        noisy = clean + sigma * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
        for name, values_ in zip(
            columns, (w, force + 0j, [direction] * w.size, [line] * w.size, noisy, np.full(w.size, sigma)), strict=True
        ):
            columns[name].append(np.asarray(values_))
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    count = joined["sigma"].size
    return rf.LineTest(
        run=np.full(count, "sweep"), speed=np.full(count, SPEED), force_plane=np.full(count, "disk"),
        plane=np.full(count, "disk"), **joined,
    )  # fmt: skip


ALL = [("z", "w"), ("z", "2Om-w"), ("twist", "w-Om"), ("twist", "w-2Om")]
