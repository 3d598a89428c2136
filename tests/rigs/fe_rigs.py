"""Disk/journal rigs as finite-element shafts in a fluid bearing: other rotors than any model of rotorfit has in it."""

from __future__ import annotations

import numpy as np
from beams import shaft
from plain import plain_fit
from scipy.optimize import brentq

import rotorfit as rf
from rotorfit.models import WhirlWhip

RPM = np.pi / 30
STEEL = {"E": 2.11e11, "G": 8.12e10, "rho": 7810.0}
TYPICAL = {
    "diameter": 0.010, "K0": 1e4, "D": 450.0, "lam": 0.475, "Mf": 0.35, "m_disk": 0.8, "Ds": 3.0, "noise": 0.01,
}  # fmt: skip
ELEMENTS, DISK, JOURNAL, K3 = 14, 7, 14, 6000.0


class Rig:
    """Shaft of 0.56 m: rigid bearing at one end, disk at a node, journal with fluid and spring K3 at the other."""

    def __init__(self, diameter, K0, D, lam, Mf, m_disk, Ds, noise, disk=DISK):
        self.fluid, self.noise = (K0, D, lam, Mf), noise
        self.K, self.M, self.G = shaft(0.56, ELEMENTS, diameter, **STEEL)
        self.C = np.zeros_like(self.K)
        i, b = self.disk, self.journal = 2 * disk, 2 * JOURNAL
        self.K[0, 0] += 5e7
        self.K[b, b] += K3
        self.C[i, i] += Ds
        for node, mass, transverse, polar in ((i, m_disk, 4e-4, 7.5e-4), (b, 0.25, 2e-5, 3e-5)):
            self.M[node, node] += mass
            self.M[node + 1, node + 1] += transverse
            self.G[node + 1, node + 1] += polar

    def coefficients(self, speed):
        K0, D, lam, Mf = self.fluid
        b, whirl = 2 * JOURNAL, lam * speed
        K, C, M = self.K.astype(complex), self.C - 1j * speed * self.G, self.M.copy()
        K[b, b] += K0 - 1j * D * whirl - Mf * whirl**2
        C[b, b] += D - 2j * Mf * whirl
        M[b, b] += Mf
        return K, C, M

    def growth(self, speed):
        K, C, M = self.coefficients(speed)
        top = np.hstack([np.zeros_like(K), np.eye(len(K))])
        A = np.vstack([top, np.hstack([-np.linalg.solve(M, K), -np.linalg.solve(M, C)])])
        return np.linalg.eigvals(A).real.max()

    def threshold(self):
        """Threshold speed, rad/s."""
        speeds = np.linspace(20, 1200, 80)
        first = next(k for k, speed in enumerate(speeds) if self.growth(speed) > 0)
        return brentq(self.growth, speeds[first - 1], speeds[first], xtol=1e-8)

    def campaign(self, speeds, seed, lines=126, top=520.0):
        """Forward and backward sweeps of an unbalance force at disk and journal, x and y probes at both."""
        rng = np.random.default_rng(seed)
        magnitude = np.linspace(6.0, top, lines)
        nodes = {"disk": self.disk, "journal": self.journal}
        rows = []
        for force_plane, driven in nodes.items():
            for speed in speeds:
                K, C, M = self.coefficients(speed)
                for sense in (1, -1):
                    w = sense * magnitude
                    force = 1.5e-4 * w**2
                    kappa = K + 1j * w[:, None, None] * C - (w**2)[:, None, None] * M
                    column = np.linalg.solve(kappa, np.eye(len(K), dtype=complex)[None, :, driven, None])[:, :, 0]
                    for plane, node in nodes.items():
                        z = column[:, node] * force
                        x = z if sense > 0 else z.conj()
                        spread = self.noise * np.sqrt(np.mean(np.abs(z) ** 2)) / np.sqrt(2)
                        for direction, value in (("x", x), ("y", -1j * sense * x)):
                            error = spread * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
                            run = f"{force_plane} {speed * 30 / np.pi:.0f} {sense:+d}"
                            rows.append((run, speed, w, force_plane, force, plane, direction, value + error))
        names = ("run", "speed", "frequency", "force_plane", "force", "plane", "direction", "response")
        columns = {
            name: np.concatenate([np.broadcast_to(np.asarray(row[k]), row[2].shape) for row in rows])
            for k, name in enumerate(names)
        }
        return rf.perturbation_test(**columns, source="finite-element rig")


def random_rig(rng):
    """A rig of the family with two tested speeds, both below its threshold: parameters, rig, speeds, threshold."""
    while True:
        p = {
            "diameter": 0.010 * rng.uniform(0.9, 1.3), "K0": 1e4 * rng.uniform(0.3, 2.0),
            "D": 450.0 * rng.uniform(0.5, 2.0), "lam": rng.uniform(0.38, 0.49), "Mf": 0.35 * rng.uniform(0.5, 1.5),
            "m_disk": 0.8 * rng.uniform(0.7, 1.4), "Ds": 3.0 * rng.uniform(0.5, 2.0), "noise":
            float(rng.choice([0.005, 0.01, 0.02])),
        }  # fmt: skip
        rig = Rig(**p)
        speeds = RPM * np.sort(rng.choice([600, 900, 1200, 1500, 1800, 2200], 2, replace=False))
        if rig.growth(speeds[-1]) < 0:
            return p, rig, speeds, rig.threshold()


QUANTITIES = ("D", "lam", "Mf", "threshold")


def pulls_of(p, rig, speeds, threshold, seed):
    """Errors over their standard errors after refinement, and redchi before and after."""
    plain = plain_fit(WhirlWhip(), rig.campaign(speeds, seed), known={"K3": K3})
    best = rf.refine(plain).best
    onset = best.threshold_speed()
    pulls = [(best.params[n].value - p[n]) / best.params[n].stderr for n in ("D", "lam", "Mf")]
    return [*pulls, (onset.value - threshold) / onset.stderr], plain.redchi, best.redchi
