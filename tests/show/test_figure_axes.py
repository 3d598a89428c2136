"""The paper's axes, units and places of figures; measured stiffness without a fit."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from drawn import conditions_of, heading_of, points_of, title_of
from matplotlib.collections import PathCollection
from matplotlib.legend import Legend
from matplotlib.text import Text
from plain import plain_fit
from sentences import refuses
from synthetic import TYPICAL, circular_test

import rotorfit as rf
from rotorfit.models import OneMode, TwoDisk
from rotorfit.show.plots.figure_table import figures_of, first_figures

SPEEDS = (100.0, 180.0)
W = np.concatenate([-np.linspace(20.0, 200.0, 30)[::-1], np.linspace(20.0, 200.0, 30)])
RPM = 30 / np.pi


@pytest.fixture(scope="module")
def rig() -> rf.PerturbationTest:
    model = OneMode()
    return circular_test(model, model.vector(TYPICAL["one-mode"]), speeds=SPEEDS, frequency=W, noise=0.001)


@pytest.fixture(scope="module")
def fit(rig: rf.PerturbationTest) -> rf.FitResult:
    return plain_fit(OneMode(), rig, known={"K": 8000.0, "Ds": 8.0})  # whose points are the readings as they are


def stiffness(w: float, speed: float) -> complex:
    """Eq. (10) to (13) written out."""
    p = TYPICAL["one-mode"]
    turn = w - p["lam"] * speed
    return p["K"] + p["K0"] - p["M"] * w**2 - p["Mf"] * turn**2 + 1j * (p["Ds"] * w + p["D"] * turn)


def test_responses_over_the_ratio_and_forward_over_reverse(fit: rf.FitResult) -> None:
    amplitude, _ = fit.plot.bode(against="ratio").axes
    points = points_of(amplitude)
    expected = [(w / speed, 1e6 / abs(stiffness(w, speed))) for speed in SPEEDS for w in W]
    for x, y in expected:
        assert np.abs(points[np.abs(points[:, 0] - x) < 1e-9, 1] / y - 1).min() < 0.02  # noise of 0.1 % of the peak
    mr = 2e-5
    amplitude, _ = fit.plot.bode(against="size", mr=mr, unit=("hz", "mil_pp")).axes
    assert amplitude.get_ylabel() == "amplitude, mil pp"
    drawn = [c for c in amplitude.collections if isinstance(c, PathCollection)]
    backward = [c for c in drawn if not c.get_facecolor().size]
    forward = [c for c in drawn if c not in backward]
    assert len(backward) == len(forward) == 2
    for some, sign in ((backward, -1), (forward, 1)):
        for points, speed in zip(some, SPEEDS, strict=True):
            x, y = np.asarray(points.get_offsets()).T
            w = sign * x * 2 * np.pi
            exact = [mr * v**2 / abs(stiffness(v, speed)) / 25.4e-6 * 2 for v in w.tolist()]
            np.testing.assert_allclose(y, exact, rtol=0.05)
    with refuses(ValueError):
        rf.fit(TwoDisk(), rf.datasets.two_disk()).plot.bode(against="ratio")
    with refuses(ValueError):
        fit.plot.bode(against="nonsense")
    with refuses(ValueError):
        fit.plot.bode(unit="furlong")


def test_direct_stiffness_against_the_square_is_straight() -> None:
    """The synchronous lines are named by what they are at zero (Fig. 36)."""
    fit = rf.fit(TwoDisk(), rf.datasets.two_disk(), causes=None)
    axes = np.array(fit.plot.dynamic_stiffness(against="square").axes).reshape(3, 2)
    boxes = [[t.get_text() for t in axis.texts] for axis in axes[:, 0]]
    for box, name in zip(boxes, ("K1 + K2", "K2 + K3", "−K2"), strict=True):
        assert any(f"at 0: {name} = " in text for text in box), box
    (line,) = [one for one in axes[0, 0].get_lines() if one.get_zorder() == 3]
    x, y = line.get_xydata().T
    slope, at_zero = np.polyfit(x, y, 1)
    assert np.abs(y - slope * x - at_zero).max() < 1e-6 * np.ptp(y)
    assert at_zero == pytest.approx((18900 + 63700) / 1e3, rel=1e-3)  # kN/m
    assert -slope == pytest.approx(0.73, rel=1e-3)  # kN/m over 1000 rad^2/s^2 is kg


def test_measured_stiffness_without_a_fit(rig: rf.PerturbationTest) -> None:
    direct, quadrature = rig.plot.dynamic_stiffness().axes
    for axis, part in ((direct, "real"), (quadrature, "imag")):
        for container, speed in zip(axis.containers, SPEEDS, strict=True):
            x, y = container.lines[0].get_xydata().T
            exact = np.array([getattr(stiffness(v / RPM, speed), part) for v in x]) / 1e3
            assert np.abs(y - exact).max() < 0.02 * np.abs(exact).max()
    one = rf.datasets.rig_open()
    journal = one.select(one.force_plane == "journal")
    assert len(journal.plot.dynamic_stiffness().axes) == 2  # force over response, where eq. (7) has no solution
    with refuses(ValueError):
        one.plot.dynamic_stiffness(["nowhere"])


def test_measured_responses_without_a_fit(rig: rf.PerturbationTest, fit: rf.FitResult) -> None:
    """In a fit's panels and with its points; the equation of motion says where these are."""
    amplitude, phase = rig.plot.bode(unit="hz").axes
    drawn = [c for c in amplitude.collections if isinstance(c, PathCollection)]
    for points, speed in zip(drawn, SPEEDS, strict=True):
        x, y = np.asarray(points.get_offsets()).T
        exact = [1e6 / abs(stiffness(w * 2 * np.pi, speed)) for w in x.tolist()]
        np.testing.assert_allclose(y, exact, rtol=0.05)
    for drawn, of_fit in zip((amplitude, phase), fit.plot.bode(unit="hz").axes, strict=True):
        np.testing.assert_allclose(points_of(drawn), points_of(of_fit), rtol=1e-9)
        assert drawn.get_ylabel() == of_fit.get_ylabel()
    for polar, of_fit in zip(rig.plot.polar().axes, fit.plot.polar().axes, strict=True):
        np.testing.assert_allclose(points_of(polar), points_of(of_fit), rtol=1e-9)
    assert heading_of(rig.plot()) == "Measured responses"


def test_responses_of_start_ups_and_tilts_are_drawn_without_a_fit() -> None:
    two = rf.datasets.two_disk()
    assert len(two.plot.bode().axes) == 8
    with refuses(ValueError):
        two.plot.bode(against="ratio")
    model = rf.models.Overhung()
    tilted = circular_test(model, model.vector(TYPICAL["overhung"]), speeds=(100.0,), frequency=W)
    titles = [title_of(axis) for axis in tilted.plot.bode().axes]
    assert titles[::2] == ["disk, force at disk", "tilt at disk, force at disk"]


def test_response_and_stiffness_of_several_conditions(fit: rf.FitResult) -> None:
    figure = fit.plot.drive_point()
    phase, amplitude, direct, quadrature = figure.axes
    assert [axis.get_ylabel() for axis in (direct, quadrature)] == ["direct, kN/m", "quadrature, kN/m"]
    assert amplitude.get_ylabel() == "amplitude, µm/N"
    assert phase.get_ylabel() == "angle, deg"
    assert conditions_of(figure)[:2] == ["954.9 rpm", "1719 rpm"]
    with refuses(ValueError):
        fit.plot.drive_point(plane="disk")


def test_size_title_and_limits_are_changed_on_what_a_plot_returns(fit: rf.FitResult, tmp_path: Path) -> None:
    figure = fit.plot.bode()
    figure.set_size_inches(5.0, 4.0)
    figure.suptitle("after the rebuild")
    figure.axes[0].set_xlim(-2000, 2000)
    figure.savefig(tmp_path / "bode.png", dpi=100)
    assert plt.imread(tmp_path / "bode.png").shape[:2] == (400, 500)
    assert figure.axes[0].get_xlim() == (-2000, 2000)
    assert [text.get_text() for text in figure.findobj(Text) if "rebuild" in text.get_text()] == ["after the rebuild"]


def test_a_figure_is_drawn_where_it_is_wanted(fit: rf.FitResult) -> None:
    figure, axes = plt.subplots(1, 2, layout="constrained")
    fit.plot.bode(ax=axes[0], unit="hz")
    assert len(figure.subfigs) == 1
    fit.plot.bode(ax=figure.add_subfigure(axes[1].get_subplotspec()))
    figure.draw_without_rendering()
    plt.close(figure)
    figure, axes = plt.subplots(2, 1)
    assert fit.plot.bode(ax=axes) is figure
    assert axes[0].get_lines()
    assert axes[-1].get_legend() is not None  # no room below in this layout
    with refuses(ValueError):
        fit.plot.bode(ax=plt.subplots(3)[1])
    plt.close("all")


def test_circles_of_the_stability_figure_are_the_modes_at_tested_speeds() -> None:
    fit = rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0})
    frequency = fit.plot.stability().axes[0]
    at = np.concatenate([line.get_xydata() for line in frequency.get_lines() if line.get_marker() == "o"])
    assert set(np.round(at[:, 0])) == {1000.0, 2000.0}
    for speed in (1000.0, 2000.0):
        shown = sorted(at[at[:, 0].round() == speed, 1])
        modes = sorted(q.value * RPM for q, *_ in fit.natural_frequencies(speed / RPM))
        np.testing.assert_allclose(shown, modes, rtol=1e-5, atol=1e-3)


def test_figures_of_results_take_axes_and_units_too(fit: rf.FitResult) -> None:
    """Predictions, judgements, plans, comparisons, profiles, campaigns, trends: each in a place given, in hertz."""
    model, rig = fit.model, fit.experiments
    where = {"force_plane": "journal", "plane": "journal"}
    prediction = fit.predict([100.0, 200.0], 100.0, **where)
    levels = {f"2026-01-{day:02d}": 1e6 + 1e4 * (day % 3) for day in range(1, 9)}
    dated = [rf.DatedValues(date=d, values={"K": (K, 1e4)}, units={"K": "N/m"}) for d, K in levels.items()]
    drawn = {
        "prediction": prediction.plot,
        "judgement": fit.stability_report(max_speed_rpm=1500).plot,
        "plan": rf.plan(model, fit, rig[0], noise_um=0.2, quantity="lam").plot,
        "comparison": rf.compare([fit]).plot,
        "profile": fit.profile("threshold_speed", points=3).plot,
        "coefficients": fit.plot.coefficients,
        "trend": rf.trend(dated, orders=99).plot,
    }
    for name, draw in drawn.items():
        figure, axes = plt.subplots(1, 2, layout="constrained")
        draw(ax=axes[0], unit=("hz", "mil_pp"))
        labels = [axis.get_xlabel() + axis.get_ylabel() for axis in figure.findobj(plt.Axes)]
        assert any(labels), name
        if name in ("prediction", "judgement", "plan", "profile", "coefficients"):
            assert any("Hz" in label for label in labels), (name, labels)
            assert not any("rpm" in label for label in labels), (name, labels)
        if name == "judgement":
            (legend,) = figure.findobj(Legend)
            words = [text.get_text() for text in legend.get_texts()]
            assert any(word.startswith("forward mode, ") and word.endswith(" Hz at 25 Hz") for word in words)
        plt.close(figure)
    first, second = plt.subplots(2)[1]
    assert prediction.plot(ax=[first, second], unit=("hz", "mil_pp")) is first.figure
    assert first.get_ylabel() == "amplitude, mil pp"
    line = first.get_lines()[-1]
    np.testing.assert_allclose(line.get_xdata(), [100 / (2 * np.pi), 200 / (2 * np.pi)])
    np.testing.assert_allclose(line.get_ydata(), 2 * np.abs(prediction.response) / 25.4e-6, rtol=1e-9)
    plt.close("all")


def test_no_empty_figure_is_drawn() -> None:
    """A probe at one plane alone, a force at the other alone: no drive point, nothing to invert."""
    model = TwoDisk()
    test = circular_test(model, model.vector(TYPICAL["two-disk"]), speeds=SPEEDS, frequency=W, noise=0.001)
    seen = test.select((test.plane == model.planes[1]) & (test.force_plane == model.planes[0]))
    fit = plain_fit(model, seen, known={name: TYPICAL["two-disk"][name] for name in ("M1", "M2", "K1")})
    assert [figure.name for figure in figures_of(fit)] == ["bode", "polar", "residuals"]
    for good in (True, False):
        assert [name for name, _ in first_figures(fit, good=good)] == ["largest_response", "misfit"]
    (axis,) = fit.plot.largest_response().axes
    for line in axis.get_lines():
        x, y = line.get_xydata()[np.isfinite(line.get_xdata())].T
        expected = 1e6 * np.abs(model.receptance(fit.theta(), x / RPM, 0.0)[:, 1, 0])
        np.testing.assert_allclose(y, expected, rtol=1e-6)
    with refuses(ValueError):
        fit.plot.dynamic_stiffness()
