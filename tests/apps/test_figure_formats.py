"""Figures of a folder of results, in the format that is asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from synthetic import TYPICAL, circular_test

import rotorfit as rf
from rotorfit.apps.cli.main import main


@pytest.mark.parametrize(("name", "begin"), [("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_figures_are_written_as_asked(name: str, begin: bytes, tmp_path: Path) -> None:
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
