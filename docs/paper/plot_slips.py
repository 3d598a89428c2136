"""
Two slips of the paper: eqs (3) and (9)
=======================================

Eq. (3) writes the vertical motion as a sine. Therefore its amplitude vector is *not* the phasor of the vertical
probe, but j times it. Eq. (9), as printed, gives two of the coupling blocks the wrong sign. A rotor with known
matrices shows both.
"""

import matplotlib.pyplot as plt
import numpy as np

rng = np.random.default_rng(1)
n, w = 2, 40.0  # planes; rad/s
K, D, M = (scale * rng.normal(size=(2 * n, 2 * n)) + 3 * scale * np.eye(2 * n) for scale in (1e4, 50.0, 1.0))
stiffness = K + 1j * w * D - w**2 * M  # of phasors X and Y: signals are Re(phasor exp(jwt))

# %%
# Eq. (3)
# -------
#
# A forward circular force F at one plane is ``Fx = F cos(wt)``, ``Fy = F sin(wt)``, with the phasors F and -jF. The
# probes give X and Y. With ``y = A2 sin(wt + a2)``, which is ``Re(-j A2 exp(j(wt + a2)))``, the paper's vector is ``A2
# = j Y``.


def probes(plane, backward):
    """Phasors of the probes under unit force, x then y."""
    force = np.zeros(2 * n, dtype=complex)
    force[plane], force[n + plane] = 1.0, (1j if backward else -1j)
    return np.linalg.solve(stiffness, force)


runs = [[probes(plane, backward) for plane in range(n)] for backward in (False, True)]
A1 = [np.array([run[:n] for run in sweep]).T for sweep in runs]  # horizontal, forward and backward
A2 = [1j * np.array([run[n:] for run in sweep]).T for sweep in runs]  # vertical: j Y
F = np.eye(n)
lhs = np.block([[A1[0], A1[1]], [A2[0], A2[1]]])
rhs = np.block([[F, F], [F, -F]])
kappa = rhs @ np.linalg.inv(lhs)  # eq. (7)
expected = np.block(
    [[stiffness[:n, :n], -1j * stiffness[:n, n:]], [1j * stiffness[n:, :n], stiffness[n:, n:]]]
)  # eq. (4)
wrong = rhs @ np.linalg.inv(np.block([[A1[0], A1[1]], [A2[0] / 1j, A2[1] / 1j]]))
print(f"eq. (7) with A2 = jY: error {abs(kappa - expected).max() / abs(expected).max():.1e}")
print(f"eq. (7) with A2 = Y:  error {abs(wrong - expected).max() / abs(expected).max():.1e}")

# %%
# Eq. (9)
# -------
#
# The paper prints ``w D[3-q, q] = Re B`` and ``K[3-q, q] - w² M[3-q, q] = Im B`` with ``B = [(-1)^q F2 - H1] H2``. The
# figure compares the four blocks as printed with those that have the signs ``(-1)^q`` and ``(-1)^(q+1)``, which eq.
# (7) requires.

A = {1: A1, 2: A2}
found = {}
blocks = {1: slice(0, n), 2: slice(n, 2 * n)}
for q in (1, 2):
    other = A[3 - q]
    H1 = F @ np.linalg.inv(other[0]) @ other[1]
    H2 = np.linalg.inv(A[q][1] - A[q][0] @ np.linalg.inv(other[0]) @ other[1])
    B = ((-1) ** q * F - H1) @ H2
    dampers = w * D[blocks[3 - q], blocks[q]]
    springs = (K - w**2 * M)[blocks[3 - q], blocks[q]]
    for name, printed, mended, true in (
        (f"D{3 - q}{q}", B.real, (-1) ** q * B.real, dampers),
        (f"K{3 - q}{q}", B.imag, (-1) ** (q + 1) * B.imag, springs),
    ):
        errors = [abs(value - true).max() / abs(true).max() for value in (printed, mended)]
        found[name] = errors
        print(f"{name}: error as printed {errors[0]:.1e}, mended {errors[1]:.1e}")

figure, axis = plt.subplots(figsize=(6, 3), layout="constrained")
for offset, label in enumerate(("as printed", "with the signs of eq. (7)")):
    values = [errors[offset] for errors in found.values()]
    axis.bar(np.arange(len(found)) + 0.4 * offset - 0.2, values, 0.36, label=label)
axis.set(
    xticks=range(len(found)), xticklabels=found, yscale="log", ylabel="relative error", title="eq. (9), block by block"
)
axis.legend()

# %%
# What to look at: round-off errors stand beside errors of two, which are wrong signs. As printed, D21 and K12 have the
# wrong sign. The direct solution of eq. (5), ``kappa A = [[F1, F2], [F1, -F2]]``, needs no such signs;
# :func:`rotorfit.dynamic_stiffness` uses it.
