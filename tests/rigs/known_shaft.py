"""The shaft of the bundled rig as matrices, as a drawing would give it."""

from __future__ import annotations

from beams import shaft

import rotorfit as rf
from rotorfit.models import KnownStructure

RIG = rf.datasets.truth("rig_open")
TRUTH = RIG["params"]
PLANES = {"disk": TRUTH["n_disk"], "journal": TRUTH["n_brg"]}
FITTED = {name: TRUTH[name] for name in ("Ds", "K0", "D", "lam", "Mf")}


def rig_matrices(young=2.11e11, support=True):
    """M, G, K of the rig's shaft with disk, journal, left bearing and the journal's spring, (z, r) a node."""
    K, M, G = shaft(TRUTH["L"], TRUTH["nel"], TRUTH["d"], young, 8.12e10 * young / 2.11e11, 7810.0)
    for plane, mass, Id, Ip in (("disk", TRUTH["m_disk"], 4e-4, 7.5e-4), ("journal", TRUTH["m_jrn"], 2e-5, 3e-5)):
        at = 2 * PLANES[plane]
        M[at, at] += mass
        M[at + 1, at + 1] += Id
        G[at + 1, at + 1] += Ip
    if support:
        K[0, 0] += 5e7
        K[2 * PLANES["journal"], 2 * PLANES["journal"]] += TRUTH["K3"]
    return M, G, K


def known_rig(**options):
    M, G, K = rig_matrices()
    return KnownStructure(M, None, G, K, planes=PLANES, fluid="journal", damping="disk", **options)
