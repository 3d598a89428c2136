"""Universal files as an analyser writes them: receptances of a rotor with one mode, one record a probe and force."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from synthetic import TYPICAL

Complex = NDArray[np.complexfloating[Any, Any]]

W = 2 * np.pi * np.linspace(1.0, 40.0, 14)
SPEED = 150.0
RPM = np.pi / 30
MODE = TYPICAL["one-mode"]


def real_receptance(w: NDArray[np.float64]) -> Complex:
    """Receptance of the one-mode rig in x and y, shape ``(N, 2, 2)``: the real form of eq. (13), inverted."""
    p = MODE
    turn = p["lam"] * SPEED
    kxy, cxy = p["D"] * turn, 2 * p["Mf"] * turn
    direct = p["K"] + p["K0"] - p["Mf"] * turn**2 + 1j * w * (p["D"] + p["Ds"]) - (p["M"] + p["Mf"]) * w**2
    cross = kxy + 1j * w * cxy
    return np.linalg.inv(np.moveaxis(np.array([[direct, cross], [-cross, direct]]), -1, 0))


def analyser(values: Complex, response: int, reference: int, **changes: Any) -> dict[str, Any]:
    """One FRF in the way of a two-channel analyser: receptance in m/N over Hz, speed on the z axis."""
    return {
        "type": 58, "func_type": 4, "id1": "journal run", "rsp_node": 7, "rsp_dir": response, "ref_node": 7,
        "ref_dir": reference, "x": W / (2 * np.pi), "data": values, "binary": 0,
        "abscissa_spec_data_type": 18, "ordinate_spec_data_type": 8, "orddenom_spec_data_type": 13,
        "z_axis_spec_data_type": 19, "z_axis_value": SPEED / RPM, "z_axis_axis_units_lab": "rpm",
        "ordinate_axis_units_lab": "m", "orddenom_axis_units_lab": "N",
    } | changes  # fmt: skip


def shaker_test(change: Callable[[dict[str, Any], int, int], dict[str, Any]] | None = None) -> list[dict[str, Any]]:
    h = real_receptance(W)
    records = [analyser(h[:, i - 1, j - 1], i, j) for j in (1, 2) for i in (1, 2)]
    return records if change is None else [change(r, r["rsp_dir"], r["ref_dir"]) for r in records]


def written(path: Path, records: list[dict[str, Any]]) -> Path:
    import pyuff

    path.unlink(missing_ok=True)
    pyuff.UFF(str(path)).write_sets(records, mode="add")
    return path
