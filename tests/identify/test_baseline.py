"""Dry runs beside tests with fluid: coefficients of a seal on a floating stator, with the errors of both tests."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from plain import plain_fit
from seal_rig import FLUID, STATOR_MASS, floating_stator
from sentences import hear, refuses

import rotorfit as rf
from rotorfit.apps.cli import main as cli
from rotorfit.lab.data.experiments import PerturbationTest

MODEL = rf.models.Anisotropic(("stator",))
STIFFNESS_AND_DAMPING = [k + i + j for k in "KD" for i in "xy" for j in "xy"]
NO_MASS = {f"M{i}{j}": 0.0 for i in "xy" for j in "xy"}
NOISE: dict[str, Any] = {"force_noise": 0.6, "motion_noise": 0.15, "force_sigma": 0.6, "sigma_um": 0.15}
"""0.1 % of the force of 600 N, and 0.15 um."""
SPEEDS = (1500.0, 3000.0, 4500.0)
HZ = np.linspace(20.0, 200.0, 25)


def read(table: pd.DataFrame, name: str = "") -> PerturbationTest:
    test = rf.read(table)
    assert isinstance(test, PerturbationTest)
    return test


def pair(seed: int, dry_hz: int = 25, dry_speeds: tuple[float, ...] = (0.0,), **changes: Any) -> list[PerturbationTest]:
    options = {**NOISE, **changes}
    wet = floating_stator(speeds_rpm=SPEEDS, frequency_hz=HZ, seed=2 * seed, **options)
    grid = np.linspace(20.0, 200.0, dry_hz)
    dry = floating_stator(speeds_rpm=dry_speeds, frequency_hz=grid, fluid=None, seed=2 * seed + 1, **options)
    return [read(wet), read(dry)]


def coefficients(wet: PerturbationTest, dry: PerturbationTest) -> rf.FitResult:
    return plain_fit(MODEL, wet, baseline=dry, known=NO_MASS, per=dict.fromkeys(STIFFNESS_AND_DAMPING, "speed_rpm"))


def pulls(fit: rf.FitResult) -> list[float]:
    found = []
    for rpm in SPEEDS:
        for name in STIFFNESS_AND_DAMPING:
            p = fit.params[f"{name}[speed_rpm={rpm:g}]"]
            found.append((p.value - FLUID(rpm)[name]) / p.stderr)
    return found


@pytest.mark.parametrize("dry_hz", [25, 31])
def test_24_coefficients_lie_within_their_errors(dry_hz: int) -> None:
    """Rods, a pipe that resonates at 90 Hz, 3 % cross-talk; the dry run on the same lines, and on others.

    8 draws of 24 coefficients, of which those of different speeds go together by the dry run: as if some 70 were
    independent, their rms is 1 +- 3 / sqrt(140). The long form is benchmarks/floating_stator.py.
    """
    found = [pulls(coefficients(*pair(seed, dry_hz))) for seed in range(8)]
    assert np.abs(found[0]).max() < 4
    assert 0.75 < np.sqrt(np.mean(np.square(found))) < 1.25


def test_lines_a_little_beyond_the_dry_run_need_no_editing() -> None:
    """Ends of two sweeps over one band differ by a tenth of the distance of their lines at most."""
    ends = np.concatenate([[19.4], HZ[1:-1], [200.6]])
    wet = read(floating_stator(speeds_rpm=SPEEDS, frequency_hz=ends, seed=2, **NOISE))
    fit = coefficients(wet, pair(1)[1])
    assert len(fit.experiments[0]) == len(wet)
    assert np.abs(pulls(fit)).max() < 4


def test_left_out_the_noise_of_forces_and_dry_run_would_be_missed() -> None:
    """The same without the noise of the forces: the errors are too small, and redchi says so."""
    wet, dry = pair(1)
    bare = [rf.perturbation_test(**_columns(test)) for test in (wet, dry)]
    assert coefficients(*bare).redchi > 1.5 * coefficients(wet, dry).redchi


def _columns(test: PerturbationTest) -> dict[str, Any]:
    names = ("run", "speed", "frequency", "force_plane", "force", "plane", "direction", "response", "sigma")
    columns = {name: getattr(test, name) for name in (*names, "force_direction", "further_forces")}
    return {**columns, "source": "bare"}


def test_exact_data_give_exact_coefficients_with_dry_run_or_mass() -> None:
    wet, dry = pair(0, exact=True, force_sigma=1e-6, sigma_um=1e-6)
    fit = coefficients(wet, dry)
    for rpm in SPEEDS:
        for name in STIFFNESS_AND_DAMPING:
            assert fit.params[f"{name}[speed_rpm={rpm:g}]"].value == pytest.approx(FLUID(rpm)[name], rel=1e-7)


def test_a_stator_mass_stands_for_a_dry_run_of_a_free_stator(tmp_path: Path) -> None:
    """Nothing but mass beside the fluid: the mass joins the fluid's inertia, whatever else is fitted."""
    fluid = FLUID(3000.0) | {"Mxx": STATOR_MASS, "Myy": STATOR_MASS}
    table = floating_stator(speeds_rpm=[3000.0], fluid=lambda _: fluid, mass=0.0, **NOISE)
    fit = plain_fit(MODEL, read(table), stator_mass_kg=STATOR_MASS)
    for name, value in FLUID(3000.0).items():
        assert abs(fit.params[name].value - value) < 4 * fit.params[name].stderr, name
    again = plain_fit(MODEL, read(table), known={"Mxx": STATOR_MASS, "Myy": STATOR_MASS, "Mxy": 0, "Myx": 0})
    free = plain_fit(MODEL, read(table), stator_mass_kg=STATOR_MASS, known=NO_MASS)
    assert free.params["Kxx"].value == pytest.approx(again.params["Kxx"].value, rel=1e-7)
    fit.save(tmp_path / "fit.json")
    assert rf.load_fit(tmp_path / "fit.json").redchi == fit.redchi


def test_an_isotropic_model_and_one_axis_at_rest_take_a_dry_run_too() -> None:
    isotropic = {"Kxx": 2e6, "Kyy": 2e6, "Kxy": 8e5, "Kyx": -8e5, "Dxx": 4e3, "Dyy": 4e3, "Dxy": 0.0, "Dyx": 0.0}
    mass = {"Mxx": 0.0, "Myy": 0.0, "Mxy": 0.0, "Myx": 0.0}
    rods = {"Kxx": 3e5, "Kyy": 3e5, "Kxy": 0.0, "Kyx": 0.0, "Dxx": 90.0, "Dyy": 90.0, "Dxy": 0.0, "Dyx": 0.0}
    own = {"Mxx": 9.0, "Myy": 9.0, "Mxy": 0.0, "Myx": 0.0}
    both = {name: isotropic[name] + rods[name] for name in rods} | own
    wet = read(floating_stator(speeds_rpm=[3000.0], fluid=lambda _: both, mass=0.0, **NOISE))
    dry = read(floating_stator(speeds_rpm=[3000.0], fluid=lambda _: rods | own, mass=0.0, seed=1, **NOISE))
    model = rf.models.OneMode(planes=("stator",))
    fit = plain_fit(model, wet, baseline=dry, known={"K": 0.0, "Ds": 0.0, "Mf": 0.0, "M": 0.0})
    truth = {"K0": 2e6, "D": 4e3, "lam": 8e5 / (4e3 * 100 * np.pi)}
    for name, value in truth.items():
        assert abs(fit.params[name].value - value) < 4 * fit.params[name].stderr, name
    assert 0.7 < fit.redchi < 1.3
    still = {name: 0.0 if name in ("Kxy", "Kyx") else value for name, value in (both | mass | own).items()}
    tests = [
        read(floating_stator(speeds_rpm=[0.0], fluid=lambda _, c=c: c, mass=0.0, seed=seed, **NOISE))
        for seed, c in enumerate((still, rods | own))
    ]
    one = [test.select((test.direction == "x") & (test.force_direction == "x")) for test in tests]
    alone = plain_fit(model, one[0], baseline=one[1], known={"K": 0.0, "Ds": 0.0, "Mf": 0.0, "M": 0.0, "lam": 0.4})
    assert abs(alone.params["D"].value - 4e3) < 4 * alone.params["D"].stderr


def test_what_is_no_dry_run_of_this_rig_is_named() -> None:
    wet, dry = pair(0)
    fast = read(floating_stator(speeds_rpm=[1500.0, 3100.0], frequency_hz=HZ, fluid=None, **NOISE))
    short = dry.select(dry.frequency < 700)
    one_axis = dry.select(dry.force_direction == "x")
    elsewhere = read(floating_stator(speeds_rpm=[0.0], frequency_hz=HZ, fluid=None, **NOISE).assign(plane="rotor"))
    for other, message in (
        (fast, r"made at 1500, 3100 rpm, .* has 3000 rpm"),
        (short, r"goes from 20 to 110 Hz, .* has 117\.5 Hz: a baseline is not extrapolated"),
        (one_axis, "along x and along y at the same frequencies"),
        (elsewhere, "reads rotor, .* reads stator"),
        (wet, "given as its own dry run"),
    ):
        with pytest.raises(ValueError, match=message):
            coefficients(wet, other)
    heavy = read(floating_stator(speeds_rpm=[0.0], frequency_hz=HZ, fluid=None, mass=25.0, seed=3, **NOISE))
    light = read(floating_stator(speeds_rpm=[0.0], frequency_hz=HZ, fluid=None, mass=7.0, seed=3, **NOISE))
    errors = [[f.code for f in coefficients(wet, own).findings if f.severity == "error"] for own in (heavy, light, dry)]
    assert errors == [["other-rig"], ["missing-mass"], []]
    pounds = plain_fit(MODEL, wet, stator_mass_kg=31.0, known=NO_MASS)
    hear(pounds.findings[0].message)
    main = dataclasses.replace(wet, further_forces=np.array([], dtype=object))
    assert "give what both load cells say (force_x_N, force_y_N)" in " ".join(coefficients(main, dry).warnings)
    with refuses(ValueError):
        plain_fit(MODEL, wet, baseline=dry, stator_mass_kg=3.0)
    with refuses(ValueError):
        plain_fit(MODEL, wet, stator_mass_kg=-3.0)
    with refuses(TypeError):
        plain_fit(MODEL, wet, baseline="dry.csv")  # type: ignore[arg-type]


def test_the_command_line_and_a_study_take_a_dry_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, fluid, seed in (("wet.csv", FLUID, 0), ("dry.csv", None, 1)):
        speeds = SPEEDS[:1] if fluid else (0.0,)
        floating_stator(speeds_rpm=speeds, frequency_hz=HZ, fluid=fluid, seed=seed, **NOISE).to_csv(name, index=False)
    words = ["--model", "anisotropic", "--planes", "stator", "--known", "Mxx=0,Mxy=0,Myx=0,Myy=0"]
    assert cli.main(["fit", "wet.csv", "--baseline", "dry.csv", *words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["parameters"]["Kxy"]["value"] == pytest.approx(FLUID(1500.0)["Kxy"], rel=0.01)
    Path("study.toml").write_text(
        'files = ["wet.csv"]\nbaseline = "dry.csv"\nmodel = "anisotropic"\nplanes = ["stator"]\n'
        "known = {Mxx = 0.0, Mxy = 0.0, Myx = 0.0, Myy = 0.0}\n".replace("\\\n", "\n"),
        encoding="utf-8",
    )
    assert cli.main(["run", "study.toml", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["parameters"]["Kxy"] == found["parameters"]["Kxy"]
    assert cli.main(["fit", "wet.csv", "--baseline", "wet.csv", *words]) != 0
    hear(capsys.readouterr().err)
    assert cli.main(["fit", "wet.csv", "--baseline", "none.csv", *words]) != 0
    hear(capsys.readouterr().err)


def test_the_closed_form_is_of_the_fluid_alone_too() -> None:
    wet, dry = pair(0)
    per = dict.fromkeys(STIFFNESS_AND_DAMPING, "speed_rpm")
    closed = rf.closed_form(MODEL, wet, baseline=dry, known=NO_MASS, per=per)
    fit = coefficients(wet, dry)
    for name, p in fit.params.items():
        assert abs(closed.params[name].value - p.value) < 4 * p.stderr + 1e-9, name
    assert any("is taken out" in finding.message for finding in fit.findings)


def test_a_gain_of_probes_that_read_the_dry_run_too_scales_all_coefficients() -> None:
    """They read kappa_dry / g and (kappa_dry + kappa) / g: nothing of g is told, and less noise of the dry run by a
    greater one is no reason for it."""
    gain = 1.04
    wet, dry = (
        rf.read(
            floating_stator(
                speeds_rpm=[rpm],
                fluid=fluid,
                force_noise=0.3,
                motion_noise=0.1,
                force_sigma=0.3,
                sigma_um=0.1,
                seed=seed,
            ).assign(amplitude_um=lambda table: table["amplitude_um"] * gain)
        )
        for rpm, fluid, seed in ((3000.0, FLUID, 3), (0.0, None, 4))
    )
    fit = rf.fit(MODEL, wet, baseline=dry)
    (row,) = [row for row in fit.causes.rows if row.name == "gain"]
    assert row.determined == pytest.approx(0.0, abs=1e-6)
    assert row.size < gain - 1
    truth = FLUID(3000.0)
    large = [name for name, value in truth.items() if abs(value) > 1e3]
    assert max(abs(gain * fit.params[name].value / truth[name] - 1) for name in large) < 0.01
    off = [(fit.params[name].value - value) / fit.params[name].stderr for name, value in truth.items()]
    assert np.abs(off).max() < 3
