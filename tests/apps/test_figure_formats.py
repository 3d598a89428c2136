"""Figures of a folder of results, in the format that is asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from plain import plain_fit
from synthetic import TYPICAL, circular_test

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.base.units import Shown, shown_in


@pytest.mark.parametrize(("name", "begin"), [("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_figures_are_written_as_asked(
    name: str, begin: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, model, w = tmp_path / "rig.csv", rf.models.OneMode(), np.r_[-300:-5:40j, 5:300:40j]
    theta = model.vector(TYPICAL["one-mode"])
    rf.write(circular_test(model, theta, speeds=(100.0,), frequency=w, noise=0.01), file)
    words = ["fit", str(file), "--model", "one-mode", "--known", "K=8000", "--known", "Ds=8", "--quiet"]
    assert main([*words, "--out", str(tmp_path / "out"), "--figure-format", name]) == 0
    found = sorted(p.name for p in (tmp_path / "out").glob(f"*.{name}"))
    assert "bode." + name in found
    assert not list((tmp_path / "out").glob("*.png"))
    assert (tmp_path / "out" / f"bode.{name}").read_bytes().startswith(begin)
    assert "data:image/png" in (tmp_path / "out" / "report.html").read_text()
    with pytest.raises(SystemExit):
        main([*words, "--amplitude", "mil_p"])
    assert "unknown unit of amplitudes 'mil_p'. Allowed: m, " in capsys.readouterr().err


def test_units_of_figures_and_tables_are_those_asked_for() -> None:
    """Frequencies in Hz and amplitudes in mil pp, a factor of 30/pi and of 12.7e-6, within the block and no longer."""
    model, w = rf.models.OneMode(), np.r_[-300:-5:20j, 5:300:20j]
    theta = model.vector(TYPICAL["one-mode"])
    fit = plain_fit(model, circular_test(model, theta, speeds=(100.0,), frequency=w, noise=0.01), known={"K": 8000.0})
    usual = fit.plot.bode().axes[0].lines[0].get_xydata()
    with shown_in(Shown(rate="hz", length="mil_pp")):
        axis = fit.plot.bode().axes[0]
        text = fit.summary()
    np.testing.assert_allclose(axis.lines[0].get_xydata() * [60.0, 12.7], usual)
    assert "mil pp" in axis.get_ylabel()
    assert f"{-300 / (2 * np.pi):.5g} to {300 / (2 * np.pi):.5g} Hz" in text
    assert "frequency, Hz" in text
    assert "Hz" not in fit.summary()
