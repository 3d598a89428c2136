"""A floating stator with accelerometers: F - M a gives the seal whatever the rotor does, probes alone do not."""

from __future__ import annotations

import warnings
from pathlib import Path

import moving_rotor
import numpy as np
import pandas as pd
import pytest
from plain import plain_fit
from sentences import hear, refuses

import rotorfit as rf
from rotorfit.apps.cli.main import main

STATOR = {"housing": moving_rotor.STATOR}
MODEL = rf.models.Anisotropic(("stator",))


def read(frame: pd.DataFrame, stator: dict[str, float]) -> rf.PerturbationTest:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rf.DataWarning)  # that the rotor moves
        return rf.read(frame, stator=stator, kind=rf.PerturbationTest)


def _errors(fit: rf.FitResult) -> dict[str, float]:
    """Standard errors away from the truth, by coefficient."""
    found = {}
    for kind, letter in (("K", "K"), ("C", "D"), ("M", "M")):
        for (row, column), true in np.ndenumerate(moving_rotor.SEAL[kind]):
            q = fit.params[f"{letter}{'xy'[row]}{'xy'[column]}"]
            found[q.name] = abs(q.value - true) / q.stderr
    return found


def test_f_minus_m_a_gives_the_seal_of_a_rotor_that_moves() -> None:
    frames = moving_rotor.table(6000.0, wet=True, seed=1), moving_rotor.table(0.0, wet=False, seed=2)
    wet, dry = (read(frame, STATOR) for frame in frames)
    assert wet.planes == ("stator",)
    assert wet.attributes["stator_mass_kg"].tolist() == [moving_rotor.STATOR] * len(wet)
    errors = _errors(plain_fit(MODEL, wet, baseline=dry))
    # Rods of 0.16 MN/m are taken out by the relative motion: 2 % of a fortieth of the stiffness, or two errors.
    assert max(errors.values()) < 5
    (said,) = wet.findings
    hear(said.message)
    assert not dry.findings
    alone = [rf.read(frame, where={"plane": "stator"}) for frame in frames]
    misled = plain_fit(MODEL, alone[0], baseline=alone[1])
    assert misled.redchi > 10  # by which its errors are widened
    assert "if the rotor moves too, make forces F - M a by accelerometers" in " ".join(misled.summary().split())
    assert max(_errors(misled).values()) > 6


def test_forces_are_corrected_once() -> None:
    frame = moving_rotor.table(6000.0, wet=True, seed=1)
    once = read(frame, STATOR)
    again = rf.read(rf.to_dataframe(once), stator=STATOR)
    np.testing.assert_allclose(again.force, once.force)
    row = 3
    before = rf.read(frame, where={"plane": "housing"})
    w, z = before.frequency[row], before.response[row]
    own = {axis: force for _, force, axis in once.acting(row)}
    given = {axis: force for _, force, axis in before.acting(row)}
    assert own["x"] == pytest.approx(given["x"] + moving_rotor.STATOR * w**2 * z)
    assert once.force_sigma[row] == pytest.approx(np.hypot(0.05, moving_rotor.STATOR * 2e-3))


def test_what_is_refused() -> None:
    frame = moving_rotor.table(6000.0, wet=True, seed=1)
    lost = frame[(frame.plane != "housing") | (frame.frequency_hz != 50.0)]
    for test, stator in ((frame, {"casing": 14.0}), (frame, {"housing": -1.0}), (lost, STATOR)):
        with refuses(ValueError):
            read(test, stator)
    with refuses(ValueError):
        rf.read(rf.datasets.path("rig_open.csv"), stator={"disk": 1.0})


def test_the_command_line_takes_the_inertia_off_test_and_dry_run(tmp_path: Path, capsys) -> None:
    for name, rpm, wet in (("wet", 6000.0, True), ("dry", 0.0, False)):
        moving_rotor.table(rpm, wet=wet, seed=wet).to_csv(tmp_path / f"{name}.csv", index=False)
    words = ["fit", str(tmp_path / "wet.csv"), "--baseline", str(tmp_path / "dry.csv"), "--stator", "housing=14"]
    main([*words, "--model", "anisotropic", "--planes", "stator"])
    told = " ".join(capsys.readouterr().out.split())
    assert "[rotor-moves]" in told
    assert "The fit agrees with the noise" in told
