"""What is logged under "rotorfit": what was read, where a fit started, what was chosen, what was left out."""

from __future__ import annotations

import logging

import pytest

import rotorfit as rf


def test_reading_and_fitting_are_logged_and_silent_by_default(
    caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    file = rf.datasets.path("rig_lumped.csv")
    with caplog.at_level(logging.INFO, logger="rotorfit"):
        rig = rf.read(file, where={"speed_rpm": "1000"}, skip=[1])
        fit = rf.fit(rf.models.WhirlWhip(), rig, known={"K3": 6000.0}, causes=None)
    assert {record.name.partition(".")[0] for record in caplog.records} == {"rotorfit"}
    whole = len(rf.read(file))
    assert f"{whole - len(rig)} of {whole} readings were not wanted" in caplog.text
    for words in (repr(rig), "starting from: closed form", repr(fit)):
        assert words in caplog.text
    caplog.clear()
    rf.read(file)
    assert not caplog.records
    assert capsys.readouterr() == ("", "")


def test_candidates_and_the_chosen_one_are_logged(caplog: pytest.LogCaptureFixture) -> None:
    rig = rf.datasets.rig_lumped()
    fit = rf.fit(rf.models.WhirlWhip(), rig, known={"K3": 6000.0}, causes=None)
    with caplog.at_level(logging.INFO, logger="rotorfit"):
        found = rf.refine(fit)
    assert str(found) in caplog.text
