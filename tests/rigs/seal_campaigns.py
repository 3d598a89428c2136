"""What tests of campaigns share: a seal at many pressures, with inlets of two kinds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from synthetic import circular_test

import rotorfit as rf
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.models import OneMode

KNOWN = {"M": 1.2, "K": 8000.0, "Ds": 8.0}
FLUID = ("K0", "D", "lam", "Mf")


def truth_at(pressure, inlet):
    """The seal of the tests: stiffness and damping rise with pressure, an anti-swirl inlet lowers lam."""
    swirl = 0.45 if inlet == "radial" else 0.30 - 0.002 * pressure
    return KNOWN | {"K0": 2000.0 + 150.0 * pressure, "D": 300.0 + 4.0 * pressure, "lam": swirl, "Mf": 0.4}


def seal_campaign(runs, lines=100, noise=0.01, seed=0):
    """One table of runs at pressures of 3 to 80 psi, radial and anti-swirl inlets in turn, and the true values."""
    model, rng = OneMode(), np.random.default_rng(seed)
    half = np.linspace(2.0, 300.0, lines // 2)
    frequency = np.concatenate([-half[::-1], half])
    parts, truths = [], []
    for number in range(runs):
        pressure, inlet = float(rng.uniform(3, 80)), ("radial", "anti-swirl")[number % 2]
        truths.append(truth_at(pressure, inlet))
        test = circular_test(
            model, model.vector(truths[-1]), speeds=(100.0 + rng.normal(),), frequency=frequency, noise=noise,
            seed=1000 * seed + number, sigma_known=True,
        )  # fmt: skip
        count = len(test)
        attributes = {"pressure_psi": np.full(count, pressure), "inlet": np.full(count, inlet)}
        parts.append(replace(test, run=np.full(count, f"r{number:02d}"), attributes=attributes))
    return joined(parts), truths


def joined(parts):
    names = ("run", "speed", "frequency", "force_plane", "force", "plane", "direction", "response", "sigma")
    columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    attributes = {name: np.concatenate([part.attributes[name] for part in parts]) for name in parts[0].attributes}
    return PerturbationTest(**columns, attributes=attributes, source="seal.csv")


def same_fits(one, other):
    """Two campaigns agree to the last digit."""
    assert one.to_csv() == other.to_csv()
    assert [run.params for run in one.runs] == [run.params for run in other.runs]


def written_parts(folder: Path) -> list[Path]:
    """Three files of four runs each."""
    table, _ = seal_campaign(12, lines=40)
    files = [folder / name for name in ("a.nc", "b.csv", "c.nc")]
    for number, file in enumerate(files):
        own = table.runs[4 * number : 4 * number + 4]
        rf.write(table.select(np.isin(table.run, own)), file)
    return files
