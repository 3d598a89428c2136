"""Errors of the data undone by the names of their findings: the same numbers as from data without the error."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from plain import plain_fit
from sentences import refuses

import rotorfit as rf
from rotorfit.identify.diagnosis.data_errors import undone


def exchanged_planes(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(plane=table["plane"].map({"disk": "journal", "journal": "disk"}))


def inverted_probe(table: pd.DataFrame) -> pd.DataFrame:
    half_turn = 180.0 * ((table["plane"] == "journal") & (table["direction"] == "y"))
    return table.assign(phase_deg=table["phase_deg"] + half_turn)


def lag_as_lead(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(phase_deg=-table["phase_deg"], force_phase_deg=-table["force_phase_deg"])


def constant_forces(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(force_N=2.0)


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return pd.read_csv(rf.datasets.path("rig_lumped.csv"), comment="#")


KNOWN = {"K3": 6000.0}


@pytest.mark.parametrize("slip", [exchanged_planes, inverted_probe, lag_as_lead])
def test_what_a_finding_names_is_undone(
    table: pd.DataFrame,
    slip: Callable[[pd.DataFrame], pd.DataFrame],
    tmp_path: Path,
    run: Callable[..., tuple[int, str, str]],
) -> None:
    file = tmp_path / "slip.csv"
    slip(table).to_csv(file, index=False)
    with pytest.warns(rf.DataWarning):
        test = rf.read(file)
    fit = plain_fit(rf.models.WhirlWhip(), test, known=KNOWN)
    (name,) = [found.correction for found in fit.findings if found.correction]
    right = rf.read(table)
    (mended,) = undone([test], [name])
    assert isinstance(mended, rf.PerturbationTest)
    assert isinstance(right, rf.PerturbationTest)
    np.testing.assert_allclose(mended.response, right.response, rtol=1e-12)
    np.testing.assert_array_equal(mended.plane, right.plane)
    code, out, err = run("fit", file, "--model", "whirl-whip", "--known", "K3=6000", "--undo", name)
    assert (code, err) == (0, "")
    assert "redchi 1.0" in out


def test_an_error_that_leaves_the_scale_open_is_not_undone(table: pd.DataFrame) -> None:
    """Forces of an unbalance given as constant: how large the unbalance is they do not say."""
    fit = plain_fit(rf.models.WhirlWhip(), rf.read(constant_forces(table)), known=KNOWN)
    found = [(one.code, one.correction) for one in fit.findings if one.severity == "error"]
    assert found == [("unbalance-as-constant", None)]
    with refuses(ValueError):
        undone(fit.experiments, ["unbalance-as-constant"])
