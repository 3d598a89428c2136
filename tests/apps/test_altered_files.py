"""Damaged and altered files through commands that read them: the short form of ``benchmarks/mutated_commands.py``."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from mutated_commands import COMMANDS, FILES, altered, outcome_of
from mutated_files import FORMATS, RIG, mutated

import rotorfit as rf


@pytest.mark.parametrize("name", ["CSV", "JSON", "LabVIEW", "npz", "store", "study", "weights"])
def test_every_command_ends_in_a_sentence(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kind, form = FILES[name]
    monkeypatch.chdir(tmp_path)
    FORMATS["CSV"].write(tmp_path / "whole.csv")
    first, damaged = tmp_path / f"first{form.suffix}", tmp_path / f"damaged{form.suffix}"
    form.write(first)
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    study = 'files = ["whole.csv"]\nmodel = "whirl-whip"\nknown = {K3 = 6000.0}\n'
    (tmp_path / "study.toml").write_text(study, encoding="utf-8")
    words = [one for one in COMMANDS[kind] if "watch" not in one and "bootstrap" not in one][:6]
    rng = np.random.default_rng(4242)
    for number, word in enumerate(words):
        shutil.copyfile(first, damaged)
        if number % 2:
            damaged.write_bytes(mutated(damaged.read_bytes(), rng))
        else:
            altered(damaged, rng)
        ending, said = outcome_of(word.replace("{}", damaged.name))
        assert ending in ("did", "refused"), (word, said)


def test_a_shaft_of_numbers_that_no_shaft_has_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "shaft.npz", M=np.eye(8), K=1e160 * np.eye(8), nodes=np.arange(2.0))
    with pytest.raises(ValueError, match=r"^shaft\.npz: K has an entry of 1e\+160; numbers may be up to 1e\+30"):
        rf.models.KnownStructure.from_ross(tmp_path / "shaft.npz", planes={"journal": 1}, fluid="journal")
