"""Coefficients over mountings, in conditions and against frequency; intervals that hold the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from plain import plain_fit
from seal_rig import FLUID, floating_stator
from sentences import refuses

import rotorfit as rf
from rotorfit.identify.fitting.quantities import Quantity
from rotorfit.identify.fitting.structure.mountings import _over_mountings

MODEL = rf.models.Anisotropic(("stator",))
NAMES = [kind + row + column for kind in "KD" for row in "xy" for column in "xy"]
NO_MASS = {f"M{row}{column}": 0.0 for row in "xy" for column in "xy"}
NOISE = {"force_noise": 0.6, "motion_noise": 0.15, "force_sigma": 0.6, "sigma_um": 0.15}


def fitted(table: pd.DataFrame, per: str = "speed_rpm", **options: float) -> rf.FitResult:
    return plain_fit(
        MODEL, rf.read(table), stator_mass_kg=None, per=dict.fromkeys(NAMES, per), known=NO_MASS, **options
    )


def wet(seed: int, fluid=FLUID, **options) -> pd.DataFrame:
    return floating_stator(speeds_rpm=[1500.0, 3000.0], mass=0.0, seed=seed, fluid=fluid, **NOISE, **options)


@pytest.mark.parametrize(("between", "share"), [(0.0, 0.5), (1.0, 0.5), (3.0, 2.0)])
def test_intervals_hold_the_truth(between: float, share: float) -> None:
    """Four mountings, errors of the fits that differ, 600 draws: 95 % less four standard deviations of sampling, 3.6 %.

    With no scatter between mountings Student's t of m - 1 is wider than it need be.
    """
    rng, m, hit = np.random.default_rng(1), 4, []
    for _ in range(600):
        stderr = rng.uniform(1.0, 1.0 + share, m)
        y = 10.0 + between * rng.standard_normal(m) + stderr * rng.standard_normal(m)
        rows = [{"Kxx": Quantity(value, error, "N/m")} for value, error in zip(y, stderr, strict=True)]
        found = _over_mountings("Kxx", "", rows)  # type: ignore[arg-type]
        (low, high), (least, most) = found.mean.interval(), found.scatter_interval
        reach, coming = found.next_mounting(), 10 + between * rng.standard_normal()
        hit.append([low < 10 < high, least <= between <= most, reach[0] < coming < reach[1]])
    assert (np.mean(hit, axis=0) > 0.95 - 0.036).all(), np.mean(hit, axis=0)


def test_mountings_of_a_seal() -> None:
    """Four mountings whose stiffness differs by 3 %: the scatter is found, and is far above the errors of the fits."""
    rng = np.random.default_rng(5)
    off = 1 + 0.03 * rng.standard_normal(4)
    fits = []
    for number, factor in enumerate(off):
        fits.append(fitted(wet(number, lambda rpm, f=factor: {k: f * v for k, v in FLUID(rpm).items()})))
    found = rf.mountings(fits)
    kxx = found["3000 rpm"]["Kxx"]
    truth = FLUID(3000.0)["Kxx"]
    assert kxx.scatter == pytest.approx(np.std(off, ddof=1) * truth, rel=0.02)
    assert kxx.mean.value == pytest.approx(np.mean(off) * truth, rel=1e-3)
    assert "Kyx" in str(found)
    assert len(found.to_dataframe()) == 16
    with refuses(ValueError):
        rf.mountings(fits[:1])
    other = fitted(floating_stator(speeds_rpm=[1500.0], mass=0.0, **NOISE))
    with refuses(ValueError):
        rf.mountings([fits[0], other])


def test_conditions_and_frequencies(tmp_path: Path) -> None:
    """Two pressures by a column of their own; K(w) and C(w) scatter about the truth as their errors say."""
    tables = []
    for bar in (2.0, 5.0):
        table = wet(int(bar), lambda rpm, p=bar: {k: v * (1 + 0.1 * p) for k, v in FLUID(rpm).items()})
        table["run"] += f" {bar:g}"
        table["state"] = [f"{bar:g} bar {rpm:g} rpm" for rpm in table["speed_rpm"]]
        tables.append(table)
    fit = fitted(pd.concat(tables), "state")
    rows = fit.coefficient_table().rows
    assert len(rows) == 4
    for row, (bar, rpm) in zip(rows, [(2, 1500), (2, 3000), (5, 1500), (5, 3000)], strict=True):
        assert row.condition.startswith(f"state={bar} bar {rpm} rpm")
        truth = FLUID(rpm)["Kxy"] * (1 + 0.1 * bar)
        assert abs(row["Kxy"].value - truth) < 4 * row["Kxy"].stderr
    table = fit.frequency_coefficients()
    misses = []
    for row, (bar, rpm) in zip(table.rows, [(2, 1500), (2, 3000), (5, 1500), (5, 3000)], strict=True):
        values = list(FLUID(rpm).values())
        K, C = ((1 + 0.1 * bar) * np.array(values[i : i + 4])[:, None] for i in (0, 4))
        misses += [(row.stiffness - K) / row.stiffness_stderr, (row.damping - C) / row.damping_stderr]
    assert 0.85 < np.sqrt(np.mean(np.square(misses))) < 1.1
    table.to_csv(tmp_path / "frequency.csv")
    assert {"condition", "frequency_hz", "Kxy", "fitted_Cyy_stderr"} <= set(pd.read_csv(tmp_path / "frequency.csv"))
    fit.plot.frequency_coefficients()


def test_frequencies_of_a_rotor_are_refused() -> None:
    fit = plain_fit(rf.models.WhirlWhip(), rf.read(rf.datasets.path("rig_open.csv")), known={"K3": 6000.0})
    with refuses(ValueError):
        fit.frequency_coefficients()
