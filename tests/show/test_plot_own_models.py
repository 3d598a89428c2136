"""Figures and report of a nonlinear model that a user wrote: its own coefficients stand where a law would."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from own_nonlinear import Damper, LaggingSeal, ShortSeal, ThreeModes, damper_tests, seal_tests, three_tests
from sentences import refuses

import rotorfit as rf
from rotorfit.show.plots.eccentricity import plot_law, plot_nonlinear_stiffness

ROTORS = {"damper": (Damper, damper_tests), "three": (ThreeModes, three_tests)}


@cache
def fitted(name: str) -> rf.FitResult:
    model, tests = ROTORS[name]
    return rf.fit(model(), tests(), causes=None)


def test_the_film_is_drawn_over_its_eccentricity() -> None:
    figure = plot_law(fitted("damper"))
    damping, mass = figure.axes
    assert damping.get_ylabel().startswith("Cxx")
    assert mass.get_ylabel().startswith("Mxx")
    for axis, true in (
        (damping, lambda e: 1500 * (1 - e**2) ** -1.5),
        (mass, lambda e: 6 + 0.8 * e**2 * (1 - e**2) ** -1.5),
    ):
        eps, drawn = axis.lines[0].get_data()
        factor = 10.0 ** round(np.log10(drawn[0] / true(eps[0])))  # of the unit of the axis
        assert drawn == pytest.approx(factor * true(eps), rel=0.02)  # the fit's error


def test_what_changes_is_drawn_for_three_modes() -> None:
    figure = plot_law(fitted("three"))
    assert [axis.get_ylabel().partition(",")[0] for axis in figure.axes] == ["Kxx", "Kxy", "Cxx"]
    eps, cross = figure.axes[1].lines[0].get_data()
    true = 420 * (1 - eps**2) ** -1.6 * 0.46 * (1 - eps) ** 0.4 * 200.0  # D lam Om
    assert cross / cross[0] == pytest.approx(true / true[0], rel=0.01)


@pytest.mark.parametrize("name", ROTORS)
def test_report_and_nonlinear_stiffness(name: str, tmp_path: Path) -> None:
    plot_nonlinear_stiffness(fitted(name)).savefig(tmp_path / "figure.png", dpi=40)
    rf.write_report(fitted(name), tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert ROTORS[name][0].name in text
    assert "Fluid against eccentricity" in text


def test_a_model_that_does_not_change_says_so() -> None:
    with refuses(ValueError):
        plot_law(rf.fit(LaggingSeal(), seal_tests(), causes=None))


def test_static_loads_and_impulses_of_a_model_integrated_in_time(tmp_path: Path) -> None:
    true = {"m": 2.5, "s": 3e4, "c": 260.0, "r": 0.45, "e": 1.3, "f": 0.4}
    tests = [
        rf.simulate(ShortSeal(), true, "static-load", speed_rpm=[500.0, 1000.0], load=[2.0, 3.0, 4.0], noise=0.01),
        rf.simulate(
            ShortSeal(), true, "impulse", speed_rpm=[600.0, 1000.0], load=[0.5, 2.0], impulse=4e-3, noise=0.01
        ),
        rf.simulate(
            ShortSeal(), true, speed_rpm=1000.0, frequency_rpm=[-1500.0, -800.0, 700.0, 1200.0, 1900.0],
            force=[1.0, 2.5], noise=0.01,
        ),
    ]  # fmt: skip
    fit = rf.fit(ShortSeal(), tests, causes=None)
    for name, value in true.items():
        assert abs(fit.params[name].value - value) < 3.5 * fit.params[name].stderr, name
    for name in ("static_locus", "static_stiffness", "velocity_ratio"):
        figure = getattr(fit.plot, name)()
        figure.savefig(tmp_path / "figure.png", dpi=40)
    told = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "fitted eigenvalue" in told
    assert not any("lam" in text for text in told)  # the model has no such parameter
