"""A known shaft in two supports, orthotropic or magnetic, and a seal: readings from full matrices of x and y."""

from __future__ import annotations

from functools import cache

import numpy as np
from beams import shaft

import rotorfit as rf

ELEMENTS, SEAL, SHAKER = 14, 7, 5
SUPPORTS = {
    "left": (1, {"kx": 8e5, "ky": 5e5, "cx": 120.0, "cy": 180.0}),
    "right": (13, {"kx": 6e5, "ky": 9e5, "cx": 200.0, "cy": 150.0}),
}
MAGNETIC = {
    "left": {"Km": -3e5, "Kp": 1.1e6, "Kd": 600.0, "tau": 1.2e-4},
    "right": {"Km": -2e5, "Kp": 9e5, "Kd": 500.0, "tau": 0.9e-4},
}
FLUID = {"K0": 2e5, "D": 800.0, "lam": 0.45, "Mf": 0.5}
PLANES = {"left": 1, "a3": 3, "a5": 5, "a6": 6, "seal": 7, "a9": 9, "a11": 11, "right": 13}


@cache
def matrices():
    """M, G, K of the free shaft with two disks, (z, dz/ds) a node."""
    K, M, G = shaft(0.56, ELEMENTS, 0.02, 2.11e11, 8.12e10, 7810.0)
    for node, mass, transverse, polar in ((5, 2.0, 3e-3, 5e-3), (9, 1.2, 2e-3, 3.5e-3)):
        M[2 * node, 2 * node] += mass
        M[2 * node + 1, 2 * node + 1] += transverse
        G[2 * node + 1, 2 * node + 1] += polar
    return M, G, K


def held(name, w, magnetic):
    """Dynamic stiffness of a support in x and in y."""
    if magnetic:
        Km, Kp, Kd, tau = MAGNETIC[name].values()
        return [Km + (Kp + 1j * w * Kd) * np.exp(-1j * w * tau)] * 2
    s = SUPPORTS[name][1]
    return s["kx"] + 1j * w * s["cx"], s["ky"] + 1j * w * s["cy"]


def dynamic_stiffness(w, Om, magnetic=False):
    """That of all coordinates, x first, then y."""
    M, G, K = matrices()
    size = len(M)
    kappa = np.block([[K - w * w * M + 0j, 1j * w * Om * G], [-1j * w * Om * G, K - w * w * M + 0j]])
    for name, (node, _) in SUPPORTS.items():
        for at, stiffness in zip((2 * node, size + 2 * node), held(name, w, magnetic), strict=True):
            kappa[at, at] += stiffness
    K0, D, lam, Mf = FLUID.values()
    direct = K0 - Mf * (lam * Om) ** 2 + 1j * w * D - w * w * Mf
    cross = D * lam * Om + 2j * w * Mf * lam * Om
    x, y = 2 * SEAL, size + 2 * SEAL
    kappa[x, x] += direct
    kappa[y, y] += direct
    kappa[x, y] += cross
    kappa[y, x] -= cross
    return kappa


def motion(w, Om, force, magnetic=False):
    """Motion of all nodes, x and y, under a force (Fx, Fy) exp(jwt) at the shaker."""
    kappa = dynamic_stiffness(w, Om, magnetic)
    size = len(kappa) // 2
    F = np.zeros(2 * size, dtype=complex)
    F[2 * SHAKER], F[size + 2 * SHAKER] = force
    q = np.linalg.solve(kappa, F)
    return q[:size:2], q[size::2]


def noisy(rng, values, share):
    """Values with noise of so much of their rms, and its standard deviation of real and imaginary part."""
    sigma = share * np.sqrt(np.mean(np.abs(values) ** 2)) / np.sqrt(2)
    return values + sigma * (rng.normal(size=values.shape) + 1j * rng.normal(size=values.shape)), sigma


def at_rest(rng, lines=150, share=0.02, magnetic=False):
    """Eight accelerometers along x, a shaker along x, the shaft at rest."""
    w = np.linspace(60.0, 2200.0, lines)
    X = np.array([motion(a, 0.0, (1.0, 0.0), magnetic)[0] for a in w])
    rows = []
    for plane, node in PLANES.items():
        a, sigma = noisy(rng, -(w**2) * X[:, node], share)
        rows.append({"plane": plane, "response": -a / w**2, "sigma": sigma / w**2, "frequency": w})
    return rf.perturbation_test(
        **_columns(rows), run="rest", speed=0.0, force_plane="a5", force=1.0, force_direction="x", direction="x"
    )


def rotating(rng, lines=80, share=0.02, magnetic=False):
    """Probes in x and y at supports and seal, a perturbator forward and backward at two speeds."""
    w = np.linspace(60.0, 1500.0, lines)
    rows = []
    for Om in (150.0, 300.0):
        for sense in (1, -1):
            moved = np.array([motion(a, Om, (10.0, -10j * sense), magnetic) for a in w])
            for plane in ("left", "seal", "right"):
                for axis, direction in enumerate("xy"):
                    z, sigma = noisy(rng, moved[:, axis, PLANES[plane]], share)
                    row = {"plane": plane, "direction": direction, "response": z, "sigma": sigma}
                    rows.append({**row, "frequency": sense * w, "speed": Om, "run": f"{Om:g} {sense}"})
    return rf.perturbation_test(**_columns(rows), force_plane="a5", force=10.0)


def _columns(rows):
    size = rows[0]["frequency"].size
    return {name: np.concatenate([np.broadcast_to(row[name], size) for row in rows]) for name in rows[0]}


def model(magnetic=False):
    """What is fitted: the seal and both supports, each with a stiffness and a damping along x and y, or magnetic."""
    M, G, K = matrices()
    if magnetic:
        return rf.models.KnownStructure(M, None, G, K, planes=PLANES, fluid="seal", magnetic=tuple(SUPPORTS))
    known = rf.models.KnownStructure(M, None, G, K, planes=PLANES, fluid="seal", supports=tuple(SUPPORTS))
    return rf.models.Orthotropic(known, at=tuple(SUPPORTS))


def magnets():
    """True values of the magnetic bearings by parameter."""
    return {f"{kind}_{name}": value for name, own in MAGNETIC.items() for kind, value in own.items()}


def along_axes(fit):
    """Stiffness and damping of both supports along x and y, as derived quantities with what they should be."""
    found = {}
    for number, (name, (_, truth)) in enumerate(SUPPORTS.items(), start=1):
        for mean, half, letter in (("Ks", "dKs", "k"), ("Ds", "dDs", "c")):
            for sign, axis in ((1, "x"), (-1, "y")):

                def quantity(p, mean=f"{mean}_{name}", half=f"{half}_{number}", sign=sign):
                    return getattr(p, mean) + sign * getattr(p, half) / 2

                found[f"{letter}{axis} {name}"] = fit.derive(quantity), truth[f"{letter}{axis}"]
    return found
