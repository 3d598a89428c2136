"""The table of measured and fitted curves, and experiments as tables in notebooks."""

from __future__ import annotations

import numpy as np
import pytest
from law_data import CLEARANCE_UM, LIGHT, impulse, static

import rotorfit as rf
from rotorfit.apps.study_files.results import _curve_rows


def columns(fit: rf.FitResult) -> dict[str, np.ndarray]:
    head, *rows = _curve_rows(fit)
    return {str(name): np.array(column) for name, column in zip(head, zip(*rows, strict=True), strict=True)}


def test_curves_hold_readings_fit_band_and_residuals() -> None:
    fit = rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0}, causes=None)
    table = columns(fit)
    assert table["run"].size == sum(block.measured.size for block in fit.problem.blocks)
    for part in ("re", "im"):
        off = (table[f"fitted_{part}"] - table[f"measured_{part}"]) / table["sigma"]
        np.testing.assert_allclose(table[f"residual_{part}"], off, rtol=1e-9, atol=1e-9)
        assert np.mean(table[f"residual_{part}"] ** 2) == pytest.approx(fit.redchi, rel=0.3)
    k = int(np.flatnonzero((table["frequency_rad_s"] > 0) & np.char.endswith(table["response"], "/ journal"))[40])
    run = fit.experiments[0].select(fit.experiments[0].run == table["run"][k])
    prediction = fit.predict(
        float(table["frequency_rad_s"][k]),
        float(table["speed_rad_s"][k]),
        force_plane=str(run.force_plane[0]),
        mr=1.5e-4,
        plane="journal",
    )
    half = (table["fitted_high_re"] - table["fitted_low_re"])[k] / 2
    size = abs(complex(table["fitted_re"][k], table["fitted_im"][k]))
    assert size == pytest.approx(abs(prediction.response[0]), rel=1e-6)
    turned = np.hypot(half, (table["fitted_high_im"] - table["fitted_low_im"])[k] / 2)  # of a force at another angle
    whole = prediction.covariance[0] + prediction.systematic[0]
    assert turned == pytest.approx(1.96 * np.sqrt(np.trace(whole)), rel=0.03)


def test_other_kinds_of_tests_are_in_the_table_too() -> None:
    model = rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=CLEARANCE_UM)
    fit = rf.fit(model, [static(LIGHT), impulse(LIGHT)], known={"Ds": 8.0, "M": 1.2, "Mf": 0.4})
    table = columns(fit)
    assert np.isfinite(table["speed_rad_s"]).all()
    assert np.isfinite(table["fitted_re"]).all()


def test_experiments_and_recordings_are_tables_in_a_notebook() -> None:
    page = rf.datasets.rig_open()._repr_html_()
    assert page.count("<tr>") == 1 + 8
    assert "-4965.6" in page
    named = rf.datasets.two_disk().select(np.arange(2))
    assert "&lt;" not in named._repr_html_()
