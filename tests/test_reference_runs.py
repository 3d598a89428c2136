"""A reference run and runs with a trial weight, as balancing records them, are start-ups that can be fitted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from synthetic import TYPICAL

import rotorfit as rf
from rotorfit.cli import main as cli


def test_a_start_up_without_weight_takes_the_residual_unbalance_out_of_those_with_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = rf.models.TwoDisk()
    speed = np.linspace(60.0, 420.0, 40)
    H = model.receptance(model.vector(TYPICAL["two-disk"]), speed, speed)
    residual = model.force_vector("outboard", speed, 8e-6 * speed**2 * np.exp(0.7j))
    rows: dict[str, list[np.ndarray]] = {}
    for run, plane, weight in (("ref", "inboard", 0.0), ("in", "inboard", 2e-5), ("out", "outboard", 2e-5)):
        force = weight * speed**2 + 0j
        motion = np.einsum("lij,lj->li", H, model.force_vector(plane, speed, force) + residual)
        for number, at in enumerate(model.planes):
            cells = {"run": run, "speed": speed, "frequency": speed, "force_plane": plane, "force": force, "plane": at}
            cells |= {"direction": "z", "response": motion[:, number], "sigma": 1e-8}
            for name, cell in cells.items():
                rows.setdefault(name, []).append(np.broadcast_to(np.asarray(cell), speed.shape))
    test = rf.perturbation_test(**{name: np.concatenate(parts) for name, parts in rows.items()}, source="trial")  # type: ignore[arg-type]
    rf.write(test, tmp_path / "trial.csv")
    assert cli.main(["fit", str(tmp_path / "trial.csv"), "--model", "two-disk", "--quiet"]) == 0
    assert capsys.readouterr().err == ""
    fit = rf.fit(model, rf.read(tmp_path / "trial.csv"))
    for name, parameter in fit.params.items():
        # the readings are exact but for the digits of the file: nothing of the residual unbalance is left in them
        assert parameter.value == pytest.approx(TYPICAL["two-disk"][name], rel=1e-4), name
