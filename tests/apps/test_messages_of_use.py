"""Sentences that say what to do next, where a reader would otherwise be led astray or left alone."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from law_data import ONE_MODE, sweep
from systematic_causes import CAUSES, measured, one_mode

import rotorfit as rf
from rotorfit.estimators.signals.spectral_lines import mains_hum
from rotorfit.identify.fitting.structure.refine import _warnings


def test_blows_at_equal_times_are_no_hum_and_hum_is() -> None:
    """Blows 2.000 s apart have lines at all multiples of 0.5 Hz, 50 and 60 Hz among them."""
    rate, rng = 2000.0, np.random.default_rng(1)
    t = np.arange(int(24 * rate)) / rate
    since = t % 2.0
    ringing = np.exp(-8 * since) * np.sin(2 * np.pi * 55.0 * since)
    noise = 1e-3 * rng.normal(size=t.size)
    assert mains_hum(ringing + noise, rate) == []
    found = mains_hum(0.05 * np.sin(2 * np.pi * 50.0 * t) + noise, rate)
    assert [round(frequency) for frequency, _ in found] == [50]


def test_orbits_too_small_for_a_law_are_an_error_of_the_data() -> None:
    test = sweep(ONE_MODE, levels=(0.002,), lines=30)
    model = rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=200.0)
    with pytest.raises(ValueError, match="small orbits tell no law from another"):
        rf.compare_laws(model, test, known={"K": ONE_MODE["K"], "Ds": ONE_MODE["Ds"]})


@pytest.mark.parametrize(("speeds", "said"), [((100.0,), True), ((100.0, 180.0), False)])
def test_one_speed_is_blamed_where_there_is_one(speeds: tuple[float, ...], said: bool) -> None:
    prior = SimpleNamespace(std=lambda: 1e-3)
    plain = SimpleNamespace(settings=SimpleNamespace(priors={}), noise=None)
    chosen = SimpleNamespace(settings=SimpleNamespace(priors={"g22": prior}), speeds=np.array(speeds), noise=None)
    (words,) = _warnings(plain, chosen)  # type: ignore[arg-type]
    assert ("as those at one speed" in words) == said
    assert ("tests at another speed would" in words) == said


def test_a_law_of_speed_is_fitted_without_a_remark_on_its_start() -> None:
    rng = np.random.default_rng(2)
    rig, test = CAUSES["in proportion to speed, lam +5 % a half threshold, four speeds"][1](one_mode(rng), rng)
    fit = rf.fit(rf.models.OneMode(**test.model), measured(rig, test, rng), known=rig.known)
    assert fit.success
    assert not [words for words in fit.warnings if "coefficient" in words]


def test_missing_columns_name_the_way_to_say_them(tmp_path) -> None:
    path = tmp_path / "short.csv"
    path.write_text("frequency_rpm,force_N,amplitude,phase_deg\n1000,5,10,20\n1100,5,11,21\n")
    with pytest.raises(ValueError, match=r"missing columns: .*--column NAME=THEIRS"):
        rf.read(path)
