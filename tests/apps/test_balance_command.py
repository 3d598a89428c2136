"""Weights by the command line: tables, refusals, and errors of the readings that stand before the weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rotorfit as rf
from rotorfit.apps.cli import main as cli

AWKWARD = {
    "run mistyped": (["--reference", "trial2"], "did you mean 'trial 2'?"),
    "plane mistyped": (["--planes", "aft,fwb"], "unknown plane of a trial weight 'fwb', did you mean 'fwd'?"),
    "negative limit": (["--max-g-mm", "-3"], "--max-g-mm -3: a weight is above zero"),
    "limit of no plane": (["--max-g-mm", "mid=3"], "unknown plane 'mid'"),
    "two holes": (["--holes", "2"], "holes at aft: three or more are needed"),
    "start-ups": (None, "has runs over many speeds"),
    "no reference": (["--exclude", "run=reference"], "the weights do not determine an influence"),
}


@pytest.mark.parametrize(("words", "sentence"), AWKWARD.values(), ids=list(AWKWARD))
def test_awkward_questions_are_one_sentence(
    words: list[str] | None, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    name = "field_balance.csv" if words is not None else "two_disk.csv"
    assert cli.main(["balance", str(rf.datasets.path(name)), *(words or [])]) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert said.count("\n") == 1


def test_the_command_writes_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["balance", str(rf.datasets.path("field_balance.csv")), "--reference", "reference", "--json"]
    assert cli.main([*words, "--constant", "sigma_mil_pp=0.02", "--holes", "12", "--out", str(tmp_path / "out")]) == 0
    assert '"mr_g_mm": 15.3' in capsys.readouterr().out
    assert {"readings.csv", "summary.txt", "weights.csv"} <= {path.name for path in (tmp_path / "out").iterdir()}
    table = (tmp_path / "out" / "weights.csv").read_text()
    assert table.startswith("plane,mr_g_mm,mr_low_g_mm")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "is expected to become" in page
    for row in table.splitlines()[1:]:  # the page says what the table has
        plane, amount, low, high = row.split(",")[:4]
        assert f"{plane.capitalize()}, amount" in page
        assert 0.1 < float(high) - float(amount) < 1  # so that two decimals are the digits of the error
        assert f"<b>{float(amount):.2f}</b>" in page
        assert f"95 %: {float(low):.2f} to {float(high):.2f}" in page


def test_given_weights_are_put_in_and_what_remains_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["balance", str(rf.datasets.path("field_balance.csv")), "--constant", "sigma_mil_pp=0.02"]
    out = tmp_path / "out"
    given = ["--weights", "aft=10@40,aft=5@100,fwd=3@270"]
    assert cli.main([*words, *given, "--out", str(out)]) == 0
    table = capsys.readouterr().out
    total = 10 * np.exp(1j * np.radians(40)) + 5 * np.exp(1j * np.radians(100))
    assert f"{abs(total):.4g}" in table
    assert (out / "vibration.png").stat().st_size > 10_000
    assert cli.main([*words, "--weights", "aft=10"]) == 2
    assert "PLANE=G_MM@DEG" in capsys.readouterr().err


def test_an_error_of_the_readings_stands_before_the_weights(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Lag under the header of lead turns every weight the wrong way."""
    text = rf.datasets.path("field_balance.csv").read_text()
    (tmp_path / "lead.csv").write_text(text.replace("_mil_pp,phase_lag_deg", "_mil_pp,phase_deg"))
    assert cli.main(["balance", str(tmp_path / "lead.csv")]) == 1
    said = capsys.readouterr()
    assert said.out.startswith("ERROR in the data: The rotor answers mostly against the direction of the force")
    assert "phase lag read as lead" in said.err
