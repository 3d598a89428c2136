"""Hammer tests of a structure with eight accelerometers, written out as a sum of modes."""

from __future__ import annotations

import numpy as np

import rotorfit as rf

EIGHT = tuple(f"s{i}" for i in range(8))
MODES = {"wn": np.array([264.0, 597.0, 1005.0]), "zeta": np.array([0.02, 0.012, 0.02]), "M": np.array([3.0, 2.0, 1.5])}


def hammer_test(lines: int, coherence: float, seed: int) -> rf.PerturbationTest:
    """A simply supported shaft hit at the first of eight accelerometers' places: H1 of ten averages."""
    rng = np.random.default_rng(seed)
    w = np.linspace(60.0, 1250.0, lines)
    x = np.linspace(0.1, 0.9, 8)
    wn, zeta, M = (MODES[name][:, None] for name in ("wn", "zeta", "M"))
    shapes = np.sin(np.arange(1, 4)[:, None] * np.pi * x) / np.sin(np.arange(1, 4)[:, None] * np.pi * x[0])
    H = (shapes[:, :, None] / (M * (wn**2 - w**2 + 2j * zeta * wn * w))[:, None, :]).sum(axis=0)
    sigma = np.abs(H) * np.sqrt((1 - coherence) / (2 * coherence * 10))
    H = H + sigma * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    return rf.perturbation_test(
        run="hammer", speed=0.0, frequency=np.tile(w, 8), force_plane="s0", force=1.0, force_direction="x",
        direction="x", plane=np.repeat(EIGHT, lines), response=H.ravel(), sigma=sigma.ravel(),
    )  # fmt: skip
