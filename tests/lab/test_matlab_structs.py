"""MAT files as people save them: structs, struct arrays, cell arrays of structs, and the names of the tidy CSV."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat
from sentences import refuses

import rotorfit as rf
from rotorfit.lab.data.experiments import PerturbationTest

W = np.linspace(300.0, 900.0, 7)


def run(number: int) -> dict[str, Any]:
    """One probe of one run in the names of the tidy CSV; single values stand for all rows."""
    return {
        "run": f"run {number // 2}", "speed_rpm": 1000.0, "frequency_rpm": W, "force_plane": "journal",
        "force_N": 2.0, "force_phase_deg": 30.0, "plane": "journal", "direction": "xy"[number % 2],
        "amplitude_um": W / 100 + number, "phase_deg": -10.0 * np.arange(7), "oil_C": 40.0 + number,
    }  # fmt: skip


def csv_of(runs: list[dict[str, Any]], path: Path) -> PerturbationTest:
    lines = [",".join(runs[0])]
    for one in runs:
        for row in range(W.size):
            cells = [str(v[row]) if isinstance(v, np.ndarray) else str(v) for v in one.values()]
            lines.append(",".join(cells))
    path.write_text("\n".join(lines), encoding="utf-8")
    test = rf.read(path)
    assert isinstance(test, PerturbationTest)
    return test


def cell(items: list[Any]) -> np.ndarray:
    array = np.empty((1, len(items)), dtype=object)
    array[0, :] = items
    return array


def struct_array(items: list[dict[str, Any]]) -> np.ndarray:
    array = np.empty((1, len(items)), dtype=[(name, object) for name in items[0]])
    for k, item in enumerate(items):
        array[0, k] = tuple(item.values())
    return array


RUNS = [run(k) for k in range(4)]


@pytest.mark.parametrize(
    ("runs", "content"),
    [
        (RUNS[:1], {"test": RUNS[0]}),
        (RUNS, {"runs": cell(RUNS)}),
        (RUNS, {"runs": struct_array(RUNS)}),
        (RUNS[:1], RUNS[0]),
    ],
    ids=["struct", "cell array of structs", "struct array", "variables"],
)
def test_every_layout_is_the_test_of_the_csv(
    tmp_path: Path, runs: list[dict[str, Any]], content: dict[str, Any]
) -> None:
    savemat(tmp_path / "t.mat", content)
    test = rf.read(tmp_path / "t.mat")
    told = csv_of(runs, tmp_path / "t.csv")
    assert isinstance(test, PerturbationTest)
    for name in test._columns():
        mine, theirs = getattr(test, name), getattr(told, name)
        if mine.dtype.kind in "UO":
            assert mine.tolist() == theirs.tolist(), name
        else:
            np.testing.assert_allclose(mine, theirs, rtol=1e-14, err_msg=name)
    np.testing.assert_array_equal(test.attributes["oil_C"], told.attributes["oil_C"])


def test_a_struct_in_the_names_of_our_own_files(tmp_path: Path) -> None:
    test = rf.datasets.rig_open()
    rows = test.select(np.arange(20))
    names = ("run", "force_plane", "plane", "direction")
    fields = {n: cell(getattr(rows, n).tolist()) for n in names}
    fields |= {n: getattr(rows, n) for n in ("speed", "frequency", "force", "response", "sigma")}
    savemat(tmp_path / "t.mat", {"rig": fields})
    back = rf.read(tmp_path / "t.mat")
    assert isinstance(back, PerturbationTest)
    np.testing.assert_array_equal(back.response, rows.response)
    assert back.plane.tolist() == rows.plane.tolist()


@pytest.mark.parametrize(
    "content",
    [
        {"a": RUNS[0], "b": RUNS[1]},
        {"a": cell([RUNS[0], {"x": 1.0}])},
        {"a": RUNS[0] | {"plane": {"deep": 1.0}}},
        {"a": RUNS[0] | {"phase_deg": np.arange(3.0)}},
        {"a": RUNS[0] | {"response": 1j * W}},
        {"a": {k: v for k, v in RUNS[0].items() if k != "amplitude_um"}},
        {"a": cell([])},
    ],
)
def test_what_makes_no_test_ends_in_a_sentence(tmp_path: Path, content: dict[str, Any]) -> None:
    savemat(tmp_path / "t.mat", content)
    with refuses(ValueError) as caught:
        rf.read(tmp_path / "t.mat")
    assert "\n" not in str(caught.value)
