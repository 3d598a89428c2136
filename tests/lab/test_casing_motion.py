"""Dual probes: relative motion plus that of the casing is the rotor's, which has its mass; probes alone mislead."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from plain import plain_fit
from sentences import refuses

import rotorfit as rf
from rotorfit.apps.cli.main import main

RPM = np.pi / 30
ROTOR = {"M": 12.0, "K0": 9e5, "D": 700.0, "lam": 0.4}
CASING = {"journal": "housing"}
NOISE = 2e-8


def table(seed: int) -> pd.DataFrame:
    """A rotor in a film that stands on the ground, shaken from a casing of 60 kg on springs that the force pushes back.
    The probes stand on the casing, whose accelerometers read its motion."""
    rng, rows = np.random.default_rng(seed), []
    for rpm in (1500.0, 3000.0):
        for w in np.r_[-500:-20:20.0, 30:501:20.0]:
            rotor = 20.0 / (ROTOR["K0"] + 1j * ROTOR["D"] * (w - ROTOR["lam"] * rpm * RPM) - ROTOR["M"] * w**2)
            housing = -20.0 / (4e6 + 900j * w - 60.0 * w**2)
            for plane, z in (("journal", rotor - housing), ("housing", housing)):
                for axis, read in (
                    ("x", z if w > 0 else z.conjugate()),
                    ("y", -1j * z if w > 0 else 1j * z.conjugate()),
                ):
                    noisy = read + NOISE * (rng.normal() + 1j * rng.normal())
                    rows.append((f"{rpm:g}", rpm, w / RPM, "journal", 20.0, 0.0, plane, axis, noisy))
    run, speed, rate, at, force, lead, plane, axis, z = zip(*rows, strict=True)
    return pd.DataFrame(
        {
            "run": run, "speed_rpm": speed, "frequency_rpm": rate, "force_plane": at, "force_N": force,
            "force_phase_deg": lead, "plane": plane, "direction": axis, "amplitude_um": 1e6 * np.abs(z),
            "phase_deg": np.degrees(np.angle(z)), "sigma_um": 1e6 * NOISE,
        }
    )  # fmt: skip


def test_relative_motion_plus_that_of_the_casing_has_the_mass_of_the_rotor() -> None:
    frame, model, known = table(1), rf.models.OneMode(), {"K": 0.0, "Ds": 0.0, "Mf": 0.0}
    test = rf.read(frame, casing=CASING, kind=rf.PerturbationTest)
    assert test.planes == ("journal",)
    assert set(test.attributes["casing"].tolist()) == {"housing"}
    np.testing.assert_allclose(test.sigma, np.sqrt(2) * NOISE)
    fit = plain_fit(model, test, known=known)
    assert 0.8 < fit.redchi < 1.2
    for name, true in ROTOR.items():
        assert abs(fit.params[name].value - true) < 4 * fit.params[name].stderr, name
    misled = plain_fit(model, rf.read(frame, where={"plane": "journal"}), known=known)
    assert misled.redchi > 100
    again = rf.read(rf.to_dataframe(test), casing=CASING, kind=rf.PerturbationTest)
    np.testing.assert_allclose(again.response, test.response)


def test_the_command_line_says_it_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table(2).to_csv(tmp_path / "rig.csv", index=False)
    fixed = [word for name in ("K", "Ds", "Mf") for word in ("--known", f"{name}=0")]
    words = ["fit", str(tmp_path / "rig.csv"), "--model", "one-mode", *fixed, "--no-causes", "--json"]
    assert main([*words, "--casing", "journal=housing"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["parameters"]["M"]["value"] == pytest.approx(ROTOR["M"], rel=0.01)


def test_what_is_refused() -> None:
    frame = table(3)
    with refuses(ValueError):
        rf.read(frame, casing={"journal": "casing"})
    with refuses(ValueError):
        rf.read(frame, casing={"journal": "journal"})
    with refuses(ValueError):
        rf.read(frame.iloc[:-1], casing=CASING)
