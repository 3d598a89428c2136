"""Figures of a machine in operation: spectra at signed frequencies with the fit, coherence, the report's section."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drawn import conditions_of, faults_of, points_of
from plain import plain_fit
from sentences import refuses
from synthetic import TYPICAL, circular_test
from turbulence import ONE_MODE, recorded

import rotorfit as rf
from rotorfit.identify.fitting.headline import modes_at, named_modes
from rotorfit.show.plots.figure_table import first_figures

MODEL = rf.models.OneMode()
KNOWN = {"M": 1.0, "K": 7000.0, "Ds": 5.0}


@pytest.fixture(scope="module")
def test() -> rf.OperatingTest:
    """One speed, an order left out."""
    whole = recorded(MODEL, ONE_MODE, np.array([200.0]), minutes=3, seed=1, width=0.5)
    return whole.select(np.abs(whole.frequency - 200.0) > 5.0)


def test_spectra_stand_at_signed_frequencies_about_those_of_the_fit(test: rf.OperatingTest, tmp_path: Path) -> None:
    fit = plain_fit(MODEL, test, known=KNOWN)
    figure = fit.plot.spectra(unit=("hz", "um"))
    (axis,) = figure.axes
    drawn = points_of(axis)
    forward = (test.sense == "forward") & (test.other_sense == "forward")
    right = drawn[drawn[:, 0] > 0]
    assert right[:, 0] == pytest.approx(np.sort(test.frequency[forward]) / (2 * np.pi))
    assert right[:, 1] == pytest.approx(1e6 * np.sqrt(test.power[forward].real))
    assert {"1×"} < {text.get_text() for text in axis.texts}
    assert sum(text.get_text().startswith("δ 0.") for text in axis.texts) == 1  # backward whirl has no peak
    lines = np.concatenate([line.get_xydata() for line in axis.lines])
    assert len(axis.lines) == 4  # no fit is drawn across zero or what was left out
    near = lines[np.abs(lines[:, 0] - 14.0) < 0.3, 1] / np.interp(14.0, right[:, 0], right[:, 1])
    assert near == pytest.approx(1, abs=0.3)  # a point of a dozen lines
    for drawn_figure in (figure, fit.plot(), fit.plot.spectrum(), test.plot(), test.plot.coherence()):
        assert faults_of(drawn_figure) == []
    page = rf.write_report(fit, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Operating vibration" in page
    assert "Spectrum of the operating vibration" in page


def test_a_model_of_one_speed_keeps_backward_modes_and_shows_its_residuals(test: rf.OperatingTest) -> None:
    """What no speed changes is told forward from backward by the data of its speed; residuals are those of noise."""
    fit = plain_fit(rf.models.FreePolynomial(("journal",)), test)
    names = [f"mode {name}" for name, _, _ in named_modes(modes_at(fit, float(test.speed[0])), sensed=True)]
    told = {text.get_text().split()[0] for text in fit.plot.stability().axes[0].texts}
    assert {name.removeprefix("mode ") for name in names} <= told
    assert {"1F", "1B"} <= told
    assert [name for name, _ in first_figures(fit, good=True)] == ["spectrum", "spectrum_misfit"]
    assert first_figures(plain_fit(MODEL, test, known=KNOWN), good=False)[1][0] == "spectrum_misfit"
    figure = fit.plot.spectrum_misfit()
    assert faults_of(figure) == []
    off = np.concatenate([line.get_ydata() for line in figure.axes[0].lines if len(line.get_xdata()) > 2])
    assert np.std(off) == pytest.approx(1, abs=4 / np.sqrt(2 * off.size))


def test_several_speeds_are_told_apart() -> None:
    test = recorded(MODEL, ONE_MODE, np.array([120.0, 200.0]), minutes=2, seed=2, width=0.5)
    figure = test.plot.spectra(unit="rad_s")
    assert conditions_of(figure) == ["120 rad/s", "200 rad/s"]
    assert faults_of(figure) == []


def test_coherence_is_one_over_the_degrees_of_freedom_by_chance(test: rf.OperatingTest) -> None:
    (axis,) = test.plot.coherence().axes
    shared = np.concatenate([line.get_ydata() for line in axis.lines if len(line.get_xdata()) > 2])
    assert shared.mean() == pytest.approx(1, abs=4 / np.sqrt(20 * shared.size))


def test_other_fits_have_no_spectra() -> None:
    frequency = np.linspace(20.0, 200.0, 20)
    forced = circular_test(MODEL, MODEL.vector(TYPICAL["one-mode"]), speeds=(100.0,), frequency=frequency)
    with refuses(ValueError):
        plain_fit(MODEL, forced, known={"K": TYPICAL["one-mode"]["K"]}).plot.spectra()
