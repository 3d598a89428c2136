"""pandas in and out, fits side by side, and where users of other packages find what they look for."""

from __future__ import annotations

import numpy as np
import pytest
from plain import plain_fit
from seal_campaigns import KNOWN, seal_campaign
from sentences import refuses

import rotorfit as rf
from rotorfit.identify.fitting.habits import ELSEWHERE


def test_a_table_in_memory_is_read_as_its_file_is(tmp_path) -> None:
    import pandas as pd

    file = pd.read_csv(rf.datasets.path("rig_open.csv"), comment="#")
    test, expected = rf.read(file), rf.datasets.rig_open()
    np.testing.assert_allclose(test.response, expected.response, rtol=1e-12)
    assert test.run.tolist() == expected.run.tolist()
    back = rf.read(rf.to_dataframe(expected))
    np.testing.assert_allclose(back.response, expected.response, rtol=1e-12)
    np.testing.assert_allclose(back.force, expected.force, rtol=1e-12)
    with refuses(ValueError):
        rf.read(file.drop(columns="amplitude_um"))


def test_a_fit_as_a_table(rig_fit: rf.FitResult) -> None:
    table = rig_fit.to_dataframe().set_index("parameter")
    p = rig_fit.params["lam"]
    assert table.loc["lam", "value"] == p.value
    assert (table.loc["lam", "low"], table.loc["lam", "high"]) == p.interval(0.95)
    assert not table.loc["K3", "vary"]


def test_fits_side_by_side(rig_fit: rf.FitResult) -> None:
    larger = plain_fit(rf.models.WhirlWhip(blocks=("coupling_mass",)), rig_fit.experiments, known={"K3": 6000.0})
    both = rf.compare([rig_fit, larger])
    assert f"{rig_fit.params['D']}".split(" N")[0] in str(both)  # with the systematic share, as where it stands alone
    assert next(iter(both.fits)) == "whirl-whip 2"  # of smaller AIC
    odds = both.weights["whirl-whip 1"] / both.weights["whirl-whip 2"]
    assert odds == pytest.approx(np.exp((larger.aic - rig_fit.aic) / 2))
    assert "m12" in str(both)
    assert both.to_dataframe().loc[0, "m12"] == larger.params["m12"].value
    assert len(both.plot().axes) >= len(both.parameters)
    other = rig_fit.experiments[0].select(np.arange(len(rig_fit.experiments[0]))[:-8])
    with refuses(ValueError):
        rf.compare([rig_fit, plain_fit(rf.models.WhirlWhip(), other, known={"K3": 6000.0})])
    with refuses(ValueError):
        rf.compare([])
    robust = plain_fit(rf.models.WhirlWhip(), rig_fit.experiments, known={"K3": 6000.0}, loss="soft_l1")
    with refuses(ValueError):
        rf.compare([rig_fit, robust])
    with refuses(TypeError):
        rf.compare(["fit.json"])
    assert list(rf.compare(rig_fit).fits) == ["whirl-whip"]


@pytest.mark.parametrize("name", ["best_values", "conf_int", "residual", "fit_report"])
def test_habits_are_answered_in_a_sentence(rig_fit: rf.FitResult, name: str) -> None:
    with refuses(AttributeError):
        getattr(rig_fit, name)


def test_what_the_sentences_name_is_there(rig_fit: rf.FitResult) -> None:
    import re

    for name, sentence in ELSEWHERE.items():
        assert not hasattr(type(rig_fit), name)
        for attribute in re.findall(r"fit\.(\w+)", sentence):
            assert hasattr(rig_fit, attribute), sentence
    with refuses(AttributeError):
        rig_fit.nonsense  # noqa: B018


def test_what_is_plural_is_a_table_too(rig_fit: rf.FitResult) -> None:
    drawn = rig_fit.sample(seed=1, walkers=32, ess=100)
    table = drawn.to_dataframe()
    assert table["lam"].to_numpy() == pytest.approx(drawn.parameter("lam").samples)
    runs = rf.campaign(rf.models.OneMode(), seal_campaign(3, lines=40)[0], known=KNOWN)
    rows = runs.to_dataframe()
    assert len(rows) == len(runs.runs)
    assert {"run", "D", "D_stderr", "redchi"} <= set(rows.columns)


def test_a_recording_says_what_it_is_on_a_line() -> None:
    record = rf.read_recording(rf.datasets.volts()[0])
    assert repr(record).count("\n") == 0
    assert record.name in repr(record)
    assert "disk_X" in repr(record)
