"""Every model with every option: made again from its options, fitted, saved, read back, and used by each command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_words import toml_file
from hammer_tests import hammer_test
from sentences import refuses
from slow_cases import slow_but
from synthetic import circular_test

import rotorfit as rf
from rotorfit.apps.cli import main as cli
from rotorfit.apps.study_files.study import modal_options
from rotorfit.identify.fitting.fit_file import fit_from_json, fit_to_json
from rotorfit.models import BLOCKS, LAWS, MODELS, RotorModel
from rotorfit.models.parameters import Parameter

CLEARANCE_UM = 250.0


def variants(name: str) -> list[dict[str, Any]]:
    """Options that differ from the defaults, one or a few at a time."""
    model = MODELS[name]()
    options = model.options()
    found: list[dict[str, Any]] = [{}, {"planes": tuple(f"plane {i}" for i in range(len(model.planes)))}]
    if "blocks" in options:
        found += [{"blocks": (block,)} for block in BLOCKS] + [{"blocks": BLOCKS}]
    if "fluid" in options:
        found += [{"fluid": model.planes[-1]}, {"fluid": model.planes[0], "blocks": ("gyroscopic",)}]
    fluid = {"fluid": model.planes[-1]} if "fluid" in options else {}
    if "two_lam" in options:
        found.append({**fluid, "two_lam": True})
    if "law" in options:
        found += [{**fluid, "law": law(), "clearance_um": CLEARANCE_UM} for law in LAWS.values()]
    if "probes" in options:
        found.append({"probes": {"between": {model.planes[0]: 0.5}}})
    if name == "modal":
        names = ("a", "b", "c")
        found += [
            {"apart": True},
            {"gains": "plane"},
            {"planes": names, "force_planes": ("a",)},
            {"planes": names, "probe_planes": ("b",)},
            {"residuals": True},
            {"residuals": False, "planes": names, "force_planes": ("a", "c"), "modes": 2},
        ]
    for option, values in {
        "coupling_mass": (True,),
        "betas": (True,),
        "sigma": (True,),
        "modes": (2,),
        "torsion": ("stiffness", None),
        "runout": (True,),
    }.items():
        if option in options:
            found += [{option: value} for value in values]
    return found


CASES = [(name, options) for name in MODELS for options in variants(name)]


def test_the_cases_cover_every_option_of_every_model() -> None:
    """An option that is added has to be added here too."""
    for name, model in MODELS.items():
        tried = set().union(*map(set, variants(name)))
        clearance = {"clearance_um"} if "law" in model().options() else set()
        assert set(model().options()) - clearance == tried - clearance, name


@pytest.mark.parametrize(("name", "options"), CASES, ids=str)
def test_a_model_is_made_again_from_its_options(name: str, options: dict[str, Any]) -> None:
    model = MODELS[name]().variant(**options)
    again = model.variant()
    assert repr(again) == repr(model)
    assert again.parameter_names == model.parameter_names
    from rotorfit.identify.fitting.json_values import decode, encode

    back = decode(encode(model))
    assert repr(back.options()) == repr(model.options())
    assert back.parameter_names == model.parameter_names


def plausible(parameter: Parameter) -> float:
    """A value somewhere inside a parameter's limits."""
    if parameter.default is not None:
        return parameter.default
    cross = parameter.name[0] in "gqm" or parameter.name[1:3] in ("xy", "yx")
    value = parameter.scale * (0.1 if cross else 1.0)
    return float(np.clip(value, parameter.lower, parameter.upper))


SAVED = [(name, options) for name, options in CASES if "law" not in options]


@pytest.mark.parametrize(("name", "options"), slow_but(SAVED, *SAVED[::5]), ids=str)
def test_a_fit_is_saved_and_read_back(name: str, options: dict[str, Any]) -> None:
    model = MODELS[name]().variant(**options)
    values = {parameter.name: plausible(parameter) for parameter in model}
    w = np.linspace(20.0, 400.0, 30)
    test = circular_test(
        model, model.vector(values), speeds=(100.0,), frequency=np.r_[-w[::-1], w], noise=0.01, sigma_known=True
    )
    forced, probed = (getattr(model, name, model.planes) for name in ("force_planes", "probe_planes"))
    test = test.select(np.isin(test.plane, probed) & np.isin(test.force_plane, forced))
    varied = {q.name: values[q.name] for q in model if q.default is None}
    fit = rf.fit(model, test, start=varied, max_iterations=5)
    back = fit_from_json(fit_to_json(fit))
    assert back.summary() == fit.summary()
    assert repr(back.model.options()) == repr(fit.model.options())  # what the data chose, where they had a choice


def chain_file(folder: Path) -> Path:
    model = rf.models.Chain(2)
    values = {"M1": 1.0, "M2": 1.0, "K1": 2e4, "K2": 3e4, "K3": 2e4, "Ds1": 30.0, "Ds2": 30.0}
    w = np.linspace(20.0, 400.0, 30)
    test = circular_test(
        model, model.vector(values), speeds=(100.0,), frequency=np.r_[-w[::-1], w], noise=0.01, sigma_known=True
    )
    rf.write(test, folder / "chain.csv")
    return folder / "chain.csv"


def test_a_chain_goes_through_every_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = chain_file(tmp_path)
    study = tmp_path / "study.toml"
    study.write_text('files = ["chain.csv"]\nmodel = "chain"\n', encoding="utf-8")
    true = {"M1": 1, "M2": 1, "K1": 2e4, "K2": 3e4, "K3": 2e4, "Ds1": 30, "Ds2": 30}
    test = {"speed_rpm": 1000, "frequency_rpm": {"from": 500, "to": 2000, "count": 4}, "force": 1}
    virtual = toml_file(tmp_path / "virtual.toml", model="chain", params=true, test=test)
    commands: dict[str, list[str | Path]] = {
        "fit": ["fit", data, "--model", "chain", "--refine", "--quiet"],
        "run": ["run", study, "--quiet"],
        "simulate": ["simulate", virtual, "--out", tmp_path / "s.csv"],
        "campaign": ["campaign", study, "--quiet"],
    }
    for name, words in commands.items():
        code = cli.main([str(word) for word in words])
        assert code == 0, (name, capsys.readouterr().err)


def test_a_chain_stands_in_a_fluid_where_the_command_line_says(tmp_path: Path) -> None:
    """Ds2 damps where the fluid does: the summary says that it is what D and lam wait for."""
    model = rf.models.Chain(2, fluid="mass-2")
    values = {"M1": 1.0, "M2": 0.5, "K1": 2e4, "K2": 3e4, "K3": 5e3, "Ds1": 30.0, "Ds2": 0.0}
    values |= {"K0": 1e4, "D": 400.0, "lam": 0.45, "Mf": 0.3}
    w = np.linspace(20.0, 400.0, 30)
    test = circular_test(
        model, model.vector(values), speeds=(90.0, 150.0), frequency=np.r_[-w[::-1], w], noise=0.003, sigma_known=True
    )
    rf.write(test, tmp_path / "chain.csv")
    words = ["fit", tmp_path / "chain.csv", "--model", "chain", "--fluid", "mass-2", "--known", "K3=5000", "--quiet"]
    for known, said in (((), True), (("--known", "Ds2=0"), False)):
        out = tmp_path / f"out{len(known)}"
        assert cli.main([*map(str, words), *known, "--no-figures", "--out", str(out)]) == 0
        told = " ".join((out / "summary.txt").read_text(encoding="utf-8").split())
        assert ("because Ds2 may be anything" in told) == said
        assert "lam fluid velocity ratio" in told


def test_a_law_without_a_fluid_is_still_refused() -> None:
    with refuses(ValueError):
        rf.models.Chain(2, law=rf.models.Muszynska(), clearance_um=200.0)


def test_a_chain_refines() -> None:
    model: RotorModel = rf.models.Chain(2)
    assert model.variant(blocks=("gyroscopic",)).options()["blocks"] == ("gyroscopic",)


def test_modes_are_normalised_at_the_drive_point() -> None:
    test = hammer_test(400, 0.95, seed=3)
    assert modal_options((), [test])["planes"][0] == "s0"  # though others move more
