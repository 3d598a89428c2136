"""Every kind of recorded test from the command line, from a virtual rig to volts and back to the rig by a fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from command_words import toml_file
from plain import plain_fit
from sentences import hear, refuses
from synthetic import TYPICAL, circular_test, covering_frequencies, overhung_without_slopes

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.lab.simulation.recordings import RECORDED

VALUES = {"M": 1.2, "K": 8000.0, "Ds": 8.0, "K0": 3000.0, "D": 60.0, "lam": 0.45, "Mf": 0.2}
"""One mode: a fit of any kind of test takes no time."""
OPTIONS: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "perturbation": ({"duration": 6, "sweep_rpm": [60, 3000]}, ()),
    "dwell": ({"duration": 2, "frequency_rpm": [300, 600, 800, 950, 1300, 1800]}, ()),
    "measured-force": ({"duration": 6, "sweep_rpm": [120, 3000]}, ()),
    "impulse": ({"speed_rpm": [900, 1300]}, ("M", "K", "Ds", "Mf")),
    "hammer": ({}, ("M", "K", "Mf")),
    "release": ({"load": 3, "speed_rpm": [900, 1300]}, ("M", "K", "Ds", "Mf")),
    "static-load": ({"load": [2, 4], "duration": 2}, ("M", "K", "Ds", "Mf", "D")),
}
"""Options, and what has to be known beside K for a fit of the recordings alone."""


def virtual(folder: Path, test: dict[str, Any], **more: Any) -> str:
    """File of a test of the rig."""
    return str(toml_file(folder / "virtual.toml", model="one-mode", params=VALUES, test=test, **more))


def test_no_kind_is_left_out() -> None:
    """Start-ups and balance runs of a two-disk rotor are in the tests of runs without a weight, operation in those of
    turbulence."""
    assert set(OPTIONS) | {"synchronous", "balance", "operating"} == set(RECORDED)


@pytest.mark.usefixtures("sketched")
@pytest.mark.parametrize("kind", OPTIONS)
def test_from_the_virtual_rig_to_volts_and_back(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own, known = OPTIONS[kind]
    test = {"kind": kind, "speed_rpm": 1100, "sampling_hz": 2048, **own}
    assert main(["simulate", virtual(tmp_path, test, seed=3), "--recordings", str(tmp_path / "raw")]) == 0
    files = [str(path) for path in sorted((tmp_path / "raw").glob("*.h5"))]
    said = ["--setup", str(tmp_path / "raw" / "rig.toml")]
    taken = [word for name in (known or ("K", "Mf")) for word in ("--known", f"{name}={VALUES[name]}")]
    out = tmp_path / "out"
    assert (
        main(["fit", *files, *said, "--model", "one-mode", *taken, "--out", str(out), "--quiet", "--no-figures"]) == 0
    )
    assert all("random starts" in line for line in capsys.readouterr().err.splitlines())  # blows have no closed form
    fit = rf.load_fit(out / "fit.json")
    assert fit.redchi < 3.0  # blows leave 13 degrees of freedom: once in a thousand above 2.7
    for name in fit.var_names:
        assert abs(fit.params[name].value - VALUES[name]) < 4.5 * fit.params[name].stderr, name


@pytest.mark.parametrize(
    ("test", "said"),
    [
        ({"kind": "dwell"}, "needs frequency_rpm"),
        ({"kind": "static-load"}, "needs load"),
        ({"kind": "release", "load": [1, 2]}, "test.load must be a number, got [1, 2]"),
        ({"kind": "synchronous", "speed_rpm": [300]}, "test.speed_rpm must be two numbers"),
        ({"kind": "hammer", "unbalance": 1e-5}, "unknown key of [test] of kind hammer 'unbalance'"),
        ({"kind": "impulses"}, "kind of recorded test"),
    ],
)
def test_keys_that_do_not_go_together_are_refused(
    test: dict[str, Any], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", virtual(tmp_path, test), "--recordings", str(tmp_path / "raw")]) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.rglob("*.h5"))


def test_recordings_in_operation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    test, out = {"kind": "operating", "speed_rpm": [900, 1200], "duration": 1}, str(tmp_path / "raw")
    assert main(["simulate", virtual(tmp_path, test), "--recordings", out]) == 2
    hear(capsys.readouterr().err)
    assert main(["simulate", virtual(tmp_path, test, turbulence=0.02), "--recordings", out]) == 0
    assert {file.name for file in (tmp_path / "raw").glob("*.h5")} == {"operating-900.h5", "operating-1200.h5"}


def test_a_start_up_through_the_onset_of_instability_is_refused(tmp_path: Path) -> None:
    model = rf.models.OneMode()
    values = {"M": 1.2, "K": 8e3, "Ds": 8.0, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}
    with refuses(ValueError):
        rf.simulate_recordings(model, values, tmp_path, "synchronous", speed_rpm=(250.0, 9000.0))


def test_the_coupling_of_an_overhung_rotor_is_open_without_its_tilts() -> None:
    """Lateral readings give the same fit with either sign of it."""
    model, test = rf.models.Overhung(), overhung_without_slopes(TYPICAL["overhung"], seed=1)
    one = plain_fit(model, test)
    other = plain_fit(
        model, test, start={name: p.value * (-1 if name == "k12" else 1) for name, p in one.params.items()}
    )
    assert other.params["k12"].value == pytest.approx(-one.params["k12"].value, rel=1e-4)
    assert other.redchi == pytest.approx(one.redchi, rel=1e-9)
    assert "k12" in one.identifiability.unresolved  # of which no sign is told either
    theta = model.vector(TYPICAL["overhung"])
    whole = circular_test(model, theta, speeds=(0.0, 150.0), frequency=covering_frequencies(model, theta, (150.0,), 20))
    tilts = plain_fit(model, whole)
    assert tilts.params["k12"].value == pytest.approx(TYPICAL["overhung"]["k12"], rel=0.01)
    assert tilts.params["k12"].determined
    assert not tilts.other_solutions
