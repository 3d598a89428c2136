"""One table of settings: what the report writes the command line reads; studies and commands have the same names."""

from __future__ import annotations

from dataclasses import MISSING, fields
from inspect import signature

import pytest
from scipy import stats
from sentences import refuses

from rotorfit.apps.cli.arguments import fit_study
from rotorfit.apps.cli.main import build_parser
from rotorfit.apps.store.sources import settings_key
from rotorfit.apps.study_files import run
from rotorfit.apps.study_files.study import Study
from rotorfit.apps.study_files.study_file import study_of
from rotorfit.identify.fitting.fit import fit
from rotorfit.identify.fitting.settings import FitKeywords, FitOptions
from rotorfit.identify.options.table import FIT, LAW, MODEL, SEARCH, UNCERTAINTY, command_words

SETTINGS = {
    "structure": "shaft.mat",
    "planes": {"rotor": 7, "seal": "Bearing 1"},
    "fluid": ("seal",),
    "supports": ("left", "right"),
    "magnetic": ("amb",),
    "damping": ("rotor",),
    "dofs": ("x", "y"),
    "blocks": ("gyroscopic",),
    "two_lam": True,
    "orthotropic": ("seal",),
    "law": "muszynska",
    "clearance_um": 127.25,
    "laws": ("muszynska", "collapse"),
    "probes": {"quarter": {"disk": 0.6, "journal": -0.4}},
    "known": {"K3": 6000.0, "K1": (16000.0, 80.0), "sigma": None},
    "bounds": {"lam": (0.0, 0.6), "K0": (-float("inf"), 1e5)},
    "priors": {"Mf": stats.norm(0.4, 0.1)},
    "start": {"D": 400.0},
    "per": {"D": "oil_C"},
    "runout_um": 0.5,
    "modes": 2,
    "gains": "plane",
    "apart": True,
    "residuals": False,
    "loss": "huber",
    "phase_offsets": True,
    "method": "ipopt",
    "max_iterations": 1000,
    "operating": True,
    "undo": ("lag-as-lead", "probes-turned (journal by 45)"),
    "refine": True,
    "despite_errors": True,
    "baseline": "dry.csv",
    "stator_mass_kg": 12.5,
    "calibration": {"probe_gain": 0.01},
    "causes": {"damper[journal]": 2.0},
    "sample": True,
    "ess": 500.0,
    "max_steps": 300,
    "seed": 3,
    "profile": ("lam", "threshold_speed"),
    "bootstrap": 20,
}


def test_every_setting_of_a_study_is_in_the_table() -> None:
    """The files, the model and the folder are what they apply to."""
    assert {f.name for f in fields(Study)} - {"files", "model", "out"} == set(FIT)
    assert set(MODEL) | set(LAW) | set(SEARCH) | set(UNCERTAINTY) <= set(FIT)


def test_a_fit_takes_the_options_that_are_described_once() -> None:
    own = {f.name for f in fields(FitOptions)} | {"baseline", "calibration"}
    assert set(signature(fit).parameters) - {"model", "experiments"} == own
    assert set(FitKeywords.__annotations__) | {"known"} == own
    given = {f.name: f.default for f in fields(FitOptions) if f.default is not MISSING}
    assert given == {name: signature(fit).parameters[name].default for name in given}


def test_a_study_hands_every_setting_of_a_fit_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def instead(model: object, experiments: object, **settings: object) -> None:
        raise RuntimeError(settings)

    monkeypatch.setattr(run, "read_files", lambda *given: ((), ()))
    monkeypatch.setattr(run, "build_model", lambda *given: None)
    monkeypatch.setattr(run, "closed_form", lambda *given, **settings: None)
    monkeypatch.setattr(run, "fit", instead)
    with pytest.raises(RuntimeError) as handed:
        run.run_study(Study(files=(), model="one-mode"), lambda *given: None)
    assert set(handed.value.args[0]) == set(FIT) & set(signature(fit).parameters)


@pytest.mark.parametrize("option", FIT)
def test_what_is_written_as_words_is_read_as_the_same_setting(option: str) -> None:
    value = SETTINGS[option]
    words = command_words({option: value})
    assert words is not None
    study = fit_study(build_parser().parse_args(["fit", "rig.csv", "--model", "whirl-whip", *words]))
    found = getattr(study, option)
    if option == "priors":
        assert (found["Mf"].mean(), found["Mf"].std()) == pytest.approx((0.4, 0.1))
    else:
        assert found == value
    rest = {f.name: getattr(study, f.name) for f in fields(Study) if f.name not in (option, "files", "model")}
    assert rest == {name: getattr(Study(files=(), model=""), name) for name in rest}


def test_no_causes_at_all_is_a_word_and_a_line_of_toml() -> None:
    """None of an option is not the option left out."""
    assert command_words({"causes": None, "known": {}}) == ["--no-causes"]
    words = ["fit", "rig.csv", "--model", "whirl-whip"]
    assert fit_study(build_parser().parse_args([*words, "--no-causes"])).causes is None
    assert fit_study(build_parser().parse_args(words)).causes == {}
    with refuses(ValueError):
        fit_study(build_parser().parse_args([*words, "--no-causes", "--cause", "gain=0.01"]))
    toml = {"files": ["rig.csv"], "model": "whirl-whip"}
    assert study_of({**toml, "causes": False}).causes is None
    assert study_of({**toml, "causes": {"gain": 0.005}, "known": {"K3": [6000, 30]}}).sizes == {"K3": 30, "gain": 0.005}
    assert settings_key(study_of({**toml, "causes": False})) != settings_key(study_of(toml))


def test_a_setting_that_words_cannot_say_is_not_half_said() -> None:
    assert command_words({"known": {"K3": 6000.0}, "priors": {"Mf": stats.beta(2, 3)}}) is None
    assert command_words({"calibration": {"probe_gain": {"journal": 0.01}}}) is None
