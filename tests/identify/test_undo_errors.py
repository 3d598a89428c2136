"""Errors of the data undone by the names of their findings: the same numbers as from data without the error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from clean_rigs import clean_test
from plain import plain_fit
from sentences import refuses
from slips import in_decibels, thinned

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


def in_run(test: rf.PerturbationTest, changed: rf.PerturbationTest) -> rf.PerturbationTest:
    """One run of eight with the error alone."""
    bad = test.run == test.runs[2]
    columns = ("frequency", "force", "response", "direction")
    return replace(test, **{name: np.where(bad, getattr(changed, name), getattr(test, name)) for name in columns})


OF_ONE_RUN = {
    "exchanged": (lambda test: replace(test, direction=np.where(test.direction == "x", "y", "x")), "both"),
    "inverted": (lambda test: replace(test, response=np.where(test.direction == "y", -1, 1) * test.response), "both"),
    "exchanged at one plane": (
        lambda test: replace(
            test, direction=np.where(test.plane == "disk", np.where(test.direction == "x", "y", "x"), test.direction)
        ),
        "disk",
    ),
    "whirl": (lambda test: replace(test, frequency=-test.frequency), "both"),
}


@pytest.mark.parametrize("slip", list(OF_ONE_RUN))
def test_probes_of_one_run_are_put_right(slip: str) -> None:
    rig = thinned(rf.datasets.rig_open(), 4)
    wrong = in_run(rig, OF_ONE_RUN[slip][0](rig))
    fit = plain_fit(rf.models.WhirlWhip(), wrong, known=KNOWN)
    named = [found for found in fit.findings if found.correction]
    assert all(f'--undo "{found.correction}"' in found.words for found in named)
    assert rig.runs[2] in str(named[0].correction)
    (mended,) = undone([wrong], [str(named[0].correction)])
    again = plain_fit(rf.models.WhirlWhip(), mended, known=KNOWN)
    assert again.redchi == pytest.approx(plain_fit(rf.models.WhirlWhip(), rig, known=KNOWN).redchi, rel=1e-6)


def along_x(test: rf.PerturbationTest) -> rf.PerturbationTest:
    return test.select(test.direction == "x")


def with_zeros(test: rf.PerturbationTest) -> rf.PerturbationTest:
    response = test.response.copy()
    response[[100, 101, 300]] = 0.0
    return replace(test, response=response)


SHOWN_BY_DATA: dict[str, tuple[Any, Any]] = {
    "conjugated": (
        lambda test: replace(along_x(test).with_forces(np.conj), response=along_x(test).response.conj()),
        along_x,
    ),
    "half-turn": (lambda test: replace(along_x(test), force=-along_x(test).force), along_x),
    "sigma": (
        lambda test: replace(test, sigma=np.where(test.speed == 0, 1e-7, -1.0)),
        lambda test: replace(test, sigma=np.full(len(test), np.nan)),
    ),
    "zero": (with_zeros, lambda test: test.select(np.isin(np.arange(len(test)), [100, 101, 300], invert=True))),
    "not-finite": (
        lambda test: replace(test, response=np.where(np.arange(len(test)) == 5, np.nan, test.response)),
        lambda test: test.select(np.arange(len(test)) != 5),
    ),
}


@pytest.mark.parametrize("name", list(SHOWN_BY_DATA))
def test_what_data_show_themselves_is_undone_by_its_name(name: str) -> None:
    rig = rf.datasets.rig_open()
    slip, right = (part(rig) for part in SHOWN_BY_DATA[name])
    (found,) = [one for one in rf.check(slip) if one.severity == "error"]
    assert found.correction == name
    (mended,) = undone([slip], [name])
    assert isinstance(mended, rf.PerturbationTest)
    for column in ("frequency", "force", "response", "sigma", "direction"):
        np.testing.assert_array_equal(getattr(mended, column), getattr(right, column))


def test_the_sense_of_rotation_is_turned_round() -> None:
    """The rotor seen from its other end: what turned from x to y turns from y to x, and so do both kinds of forces."""
    test = clean_test("one-mode", 3)
    seen = replace(
        test, frequency=-test.frequency, response=np.where(test.direction == "y", -test.response, test.response)
    )
    (found,) = [one for one in rf.check(seen) if one.severity == "error"]
    (mended,) = undone([seen], [str(found.correction)])
    assert isinstance(mended, rf.PerturbationTest)
    np.testing.assert_array_equal(mended.frequency, test.frequency)
    np.testing.assert_array_equal(mended.response, test.response)
    assert [one for one in rf.check(mended) if one.severity == "error"] == []


def test_levels_are_undone_by_what_0_db_is(table: pd.DataFrame) -> None:
    right = rf.read(table)
    (mended,) = undone([in_decibels(right, 1e-6)], ["levels-in-decibels (um: 0.01)"])
    np.testing.assert_allclose(mended.response, right.response, rtol=1e-9)
    with refuses(ValueError):
        undone([right], ["levels-in-decibels (ell: 1)"])
