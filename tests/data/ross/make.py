"""Writes the files beside this one with whatever ROSS is installed: ``python tests/data/ross/make.py``.

A shaft of four elements on two springs with a disk; a fluid bearing at the last node, which the matrices leave out.
``answers-<version>.json`` holds ROSS's own responses and eigenvalues of the rotor with the bearing in.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import ross

HERE = Path(__file__).parent
FLUID = {"K0": 1.2e5, "D": 600.0, "lam": 0.46, "Mf": 0.4}
SPEEDS = (0.0, 100.0, 200.0, 300.0, 400.0, 500.0)
LINE = int(ross.__version__.split(".")[0])


def table(speeds: np.ndarray) -> dict[str, object]:
    """Eight coefficients of eq. (13) at speeds, and the mass, as the installed line takes them."""
    K0, D, lam, Mf = FLUID.values()
    return {
        "kxx": K0 - Mf * (lam * speeds) ** 2,
        "kxy": D * lam * speeds,
        "kyx": -D * lam * speeds,
        "cxx": [D] * len(speeds),
        "cxy": 2 * Mf * lam * speeds,
        "cyx": -2 * Mf * lam * speeds,
        "mxx": [Mf] * len(speeds),
        "speed" if LINE >= 3 else "frequency": speeds,
    }


def rotor(fluid: bool) -> ross.Rotor:
    """The rotor with or without its fluid bearing."""
    steel = ross.Material(name="steel", rho=7810, E=2.11e11, G_s=8.12e10)
    elements = [ross.ShaftElement(L=0.15, idl=0, odl=0.02, material=steel, tag=f"shaft {n}") for n in range(4)]
    disks = [ross.DiskElement(n=2, m=2.0, Id=3e-3, Ip=5e-3, tag="disk")]
    bearings = [
        ross.BearingElement(n=0, kxx=3e6, cxx=50.0, tag="left"),
        ross.BearingElement(n=4, kxx=2e5, cxx=0.0, tag="spring"),
    ]
    if fluid:
        bearings.append(ross.BearingElement(n=4, **table(np.array(SPEEDS)), tag="oil"))
    return ross.Rotor(elements, disks, bearings)


if __name__ == "__main__":
    alone, whole = rotor(fluid=False), rotor(fluid=True)
    alone.save_mat(HERE / f"shaft-{ross.__version__}.mat", speed=0.0)
    whole.save(HERE / f"rotor-{ross.__version__}.toml")
    at = [6 * node + axis for node in (2, 4) for axis in (0, 1)]
    responses, values = [], []
    for speed in (100.0, 400.0):
        for frequency in (60.0, 250.0, 700.0):
            H = whole.transfer_matrix(speed=speed, frequency=frequency)[np.ix_(at, at)]
            responses.append({"speed": speed, "frequency": frequency, "re": H.real.tolist(), "im": H.imag.tolist()})
        s = np.linalg.eigvals(whole.A(speed=speed, frequency=speed))
        values.append({"speed": speed, "re": s.real.tolist(), "im": s.imag.tolist()})
    answers = {"ross": ross.__version__, "fluid": FLUID, "responses": responses, "eigenvalues": values}
    (HERE / f"answers-{ross.__version__}.json").write_text(json.dumps(answers))
