"""Files that version 0.1.0 wrote are read: the same numbers, whatever room a class lives in today.

The files of ``data/saved-0.1.0`` were written by that version, before the front was divided into rooms
(``found_noise.json`` before ``fitting`` was), and are never written again; ``expected.json`` holds what it said of
them.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from plain import plain_fit
from sentences import warns

import rotorfit as rf
from rotorfit.identify.fitting.noise.record import NoiseVerdict

SAVED = Path(__file__).parents[1] / "data" / "saved-0.1.0"
EXPECTED = json.loads((SAVED / "expected.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", ["one_mode", "law", "whirl_whip", "sampled", "found_noise"])
def test_a_fit_of_version_0_1_0_is_read(name: str) -> None:
    fit = rf.load_fit(SAVED / f"{name}.json")
    expected = EXPECTED[name]
    assert {p.name: p.value for p in fit.params.values()} == expected["values"]
    np.testing.assert_equal({p.name: p.stderr for p in fit.params.values()}, expected["stderr"])
    assert fit.redchi == expected["redchi"]
    assert fit.start == "not recorded"
    again = plain_fit(fit.model, list(fit.experiments), known=fit.settings.known) if name == "sampled" else None
    if again is not None:  # its settings still mean the same
        np.testing.assert_allclose(again.x, fit.x, rtol=1e-6)


def test_found_noise_of_version_0_1_0_is_read() -> None:
    fit = rf.load_fit(SAVED / "found_noise.json")
    assert fit.settings.noise is not None
    (effect,) = fit.settings.noise.effects
    assert effect.kind == "run_force"
    assert effect.sd == EXPECTED["found_noise"]["sd"]
    assert fit.noise is not None
    assert fit.noise.verdict is NoiseVerdict.AS_FOUND
    assert fit.noise.between == (("run_force", effect.sd),)
    assert fit.noise.notable[0] in fit.noise.sentences
    with warns(DeprecationWarning):
        assert fit.noise.perhaps == ()
    with warns(DeprecationWarning):
        assert fit.noise.levels == ()


def test_a_posterior_of_version_0_1_0_is_read() -> None:
    posterior = rf.load_posterior(SAVED / "posterior.nc", rf.load_fit(SAVED / "sampled.json"))
    assert list(posterior.names) == EXPECTED["posterior"]["names"]
    means = [posterior.chain[:, :, i].mean() for i in range(len(posterior.names))]
    np.testing.assert_allclose(means, EXPECTED["posterior"]["mean"], rtol=1e-12)


def test_a_study_of_version_0_1_0_is_read() -> None:
    """Every key that the version had, in one file."""
    from rotorfit.apps.study_files.study_file import read_study

    study = read_study(SAVED / "study.toml")
    assert study.phase_offsets is True
    assert dict(study.per) == {"D": "speed_rpm"}
    assert dict(study.files[1].options)["probe_angles"] == {"journal": (45.0, 135.0)}
    assert study.out == SAVED / "results"


def test_names_of_version_0_1_0_are_read_and_warn(tmp_path: Path) -> None:
    """A file with names of fields that have changed since, and the attributes of these names."""
    content = json.loads((SAVED / "one_mode.json").read_text(encoding="utf-8"))
    content["settings"]["fields"]["levels"] = {"mapping": [["journal x", 2.0]]}
    content["doubt"] = {"array": "float64", "shape": [1, 1], "data": [0.5]}
    (tmp_path / "fit.json").write_text(json.dumps(content), encoding="utf-8")
    fit = rf.load_fit(tmp_path / "fit.json")
    with warns(DeprecationWarning):
        assert fit.doubt is fit.model_uncertainty
    with warns(DeprecationWarning):
        assert fit.settings.levels == {"journal x": 2.0}
