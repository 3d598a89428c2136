"""Finite-element shafts for tests: Timoshenko beams in complex coordinates (z, dz/ds), from the textbook theory.

An isotropic shaft needs one complex pair of coordinates a node, z = x + j y and its slope; the real stiffness and mass
matrices of plane bending apply to them, and the gyroscopic matrix enters the dynamic stiffness as ``+ w Om G``.
"""

from __future__ import annotations

import numpy as np


def beam_element(length, diameter, E, G, rho):
    """Stiffness, mass and gyroscopic matrices (4 x 4) of a solid round Timoshenko element."""
    area, inertia = np.pi * diameter**2 / 4, np.pi * diameter**4 / 64
    nu = E / (2 * G) - 1
    kappa = 6 * (1 + nu) / (7 + 6 * nu)  # Cowper, solid circle
    phi = 12 * E * inertia / (kappa * G * area * length**2)
    L = length
    K = E * inertia / ((1 + phi) * L**3) * np.array([
        [12, 6 * L, -12, 6 * L],
        [6 * L, (4 + phi) * L**2, -6 * L, (2 - phi) * L**2],
        [-12, -6 * L, 12, -6 * L],
        [6 * L, (2 - phi) * L**2, -6 * L, (4 + phi) * L**2],
    ])  # fmt: skip
    a, b = 312 + 588 * phi + 280 * phi**2, (44 + 77 * phi + 35 * phi**2) * L
    c, d = 108 + 252 * phi + 140 * phi**2, -(26 + 63 * phi + 35 * phi**2) * L
    e, f = (8 + 14 * phi + 7 * phi**2) * L**2, -(6 + 14 * phi + 7 * phi**2) * L**2
    translation = rho * area * L / (840 * (1 + phi) ** 2) * np.array([
        [a, b, c, d], [b, e, -d, f], [c, -d, a, -b], [d, f, -b, e],
    ])  # fmt: skip
    p, q = 36.0, (3 - 15 * phi) * L
    r, s = (4 + 5 * phi + 10 * phi**2) * L**2, (-1 - 5 * phi + 5 * phi**2) * L**2
    rotation = rho * inertia / (30 * L * (1 + phi) ** 2) * np.array([
        [p, q, -p, q], [q, r, -q, s], [-p, -q, p, -q], [q, s, -q, r],
    ])  # fmt: skip
    # Polar inertia of a round section is twice the transverse one.
    return K, translation + rotation, 2 * rotation


def shaft(length, elements, diameter, E, G, rho):
    """Free shaft: K, M, G of size 2 (elements + 1)."""
    size = 2 * (elements + 1)
    K, M, gyro = (np.zeros((size, size)) for _ in range(3))
    parts = beam_element(length / elements, diameter, E, G, rho)
    for n in range(elements):
        here = slice(2 * n, 2 * n + 4)
        for whole, part in zip((K, M, gyro), parts, strict=True):
            whole[here, here] += part
    return K, M, gyro


def solid_disk(outer, width, bore, rho):
    """Mass, transverse and polar moment of inertia of a disk."""
    mass = rho * np.pi / 4 * (outer**2 - bore**2) * width
    polar = mass / 8 * (outer**2 + bore**2)
    return mass, polar / 2 + mass * width**2 / 12, polar


def frequencies(K, M, G, speed):
    """Undamped whirl frequencies of ``K + w Om G - w^2 M``, signed, ascending in size."""
    n = len(K)
    # s = j w: M s^2 - j Om G s + K
    top = np.linalg.solve(M, np.hstack([-K, 1j * speed * G]))
    A = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), top])
    w = np.linalg.eigvals(A).imag
    return w[np.argsort(np.abs(w))]
