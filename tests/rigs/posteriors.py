"""What tests of posteriors share: a rotor of one mode, an orbit that is imposed, a short run of the sampler."""

from __future__ import annotations

import numpy as np
from synthetic import TYPICAL, circular_test, covering_frequencies

from rotorfit.lab.kinds.displacement_test import DisplacementTest
from rotorfit.models import OneMode

TRUTH = TYPICAL["one-mode"]
KNOWN = {name: TRUTH[name] for name in ("K", "Ds")}
SIGNIFICANT = 1e-4
"""p value below which a comparison of draws with an exact distribution fails; seeds are fixed."""


def one_mode_test(noise=0.02, lines=40, seed=0, speeds=(100.0, 180.0), **options):
    model = OneMode()
    theta = model.vector(TRUTH)
    frequency = covering_frequencies(model, theta, speeds, lines)
    return circular_test(model, theta, speeds=speeds, frequency=frequency, noise=noise, seed=seed, **options)


def quick(fit, **options):
    """A posterior of fewer effective samples than users get."""
    return fit.sample(**{"seed": 1, "walkers": 32, "ess": 1000, **options})


def imposed_orbit(lines=6, noise=0.02):
    """Force under an imposed orbit: linear in K0, D, Mf, M once lam is known. Its design matrix, and the test."""
    w = np.linspace(20.0, 250.0, lines)
    speed, orbit, lam = 120.0, 20e-6, TRUTH["lam"]
    slip = w - lam * speed
    design = orbit * np.column_stack([-(w**2), np.ones(lines), 1j * slip, -(slip**2)])  # by M, K0, D, Mf
    exact = design @ [TRUTH[name] for name in ("M", "K0", "D", "Mf")] + orbit * (TRUTH["K"] + 1j * w * TRUTH["Ds"])
    sigma = noise * float(np.sqrt(np.mean(np.abs(exact) ** 2)))
    rng = np.random.default_rng(4)
    force = exact + sigma * (rng.normal(size=lines) + 1j * rng.normal(size=lines))
    test = DisplacementTest(
        run=np.full(lines, "sweep"), speed=np.full(lines, speed), frequency=w, plane=np.full(lines, "journal"),
        displacement=np.full(lines, orbit + 0j), force_x=force, force_y=-1j * force,
        sigma=np.full(lines, sigma * np.sqrt(2)),  # of each probe; x and y together leave sigma
    )  # fmt: skip
    return design, test


def whitened_design(fit, design):
    """Real design matrix over the noise that the fit works with, columns in the order of the fit."""
    (block,) = fit.problem.blocks
    columns = [("M", "K0", "D", "Mf").index(name) for name in fit.var_names]
    rows = (design / block.sigma[:, None])[:, columns]
    return np.concatenate([rows.real, rows.imag])
