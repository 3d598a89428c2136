"""Figures of nonlinear fluids: what is drawn is what was measured and what the law says, with the right bands."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn import conditions_of, faults_of, heading_of
from law_data import static, sweep
from matplotlib.collections import PathCollection
from matplotlib.colors import to_hex
from nonlinear_rigs import CLEARANCE_UM, ONE_MODE, POWER, WHIRL_WHIP, rig
from plain import plain_fit
from sentences import refuses
from slow_cases import slow_but

import rotorfit as rf
from rotorfit.models import Muszynska, OneMode
from rotorfit.models.coefficient_tables import law_curves
from rotorfit.models.motion.off_centre import off_centre_eigenvalues
from rotorfit.show.plots.eccentricity import plot_law, plot_nonlinear_stiffness
from rotorfit.show.plots.figure_table import first_figures
from rotorfit.show.plots.journal import drive_stiffness, half_width
from rotorfit.show.plots.static_and_impulse import plot_static_locus, plot_static_stiffness, plot_velocity_ratio

RPM = np.pi / 30
NONLINEAR = (plot_law, plot_nonlinear_stiffness, plot_static_locus, plot_static_stiffness, plot_velocity_ratio)
FREQUENCY_RPM = np.concatenate([-np.linspace(400, 2000, 5), np.linspace(400, 2000, 6)])


@cache
def fitted(planes: int) -> rf.FitResult:
    """Amplitude sweeps, static loads and impulses in one fit."""
    if planes == 1:
        model: Any = rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=CLEARANCE_UM)
        values, known = ONE_MODE | POWER | {"D": 150.0}, ("Ds",)
    else:
        model = rf.models.WhirlWhip(law=rf.models.Muszynska(), clearance_um=CLEARANCE_UM)
        values, known = WHIRL_WHIP | POWER | {"D": 300.0}, ("sigma", "K3")
    options: dict[str, Any] = {"tolerance": 1e-4, "noise": 0.02}
    sweep = rf.simulate(
        model, values, speed_rpm=1000.0, frequency_rpm=FREQUENCY_RPM, force=[1.0, 3.0], planes="journal", **options
    )
    static = rf.simulate(model, values, "static-load", speed_rpm=[500.0, 1000.0], load=[1.0, 3.0, 6.0], **options)
    blows = rf.simulate(
        model, values, "impulse", speed_rpm=[600.0, 1000.0], load=[0.5, 3.0], impulse=4e-4, tolerance=1e-5, noise=0.01
    )
    return plain_fit(
        model, [sweep, static, blows], known={name: values[name] for name in known}, start=values_of(values)
    )


def values_of(values: dict[str, float]) -> dict[str, float]:
    return {name: value for name, value in values.items() if name not in ("Ds", "sigma", "K3")}


@pytest.mark.parametrize("planes", slow_but([1, 2], 2))
@pytest.mark.parametrize("plot", NONLINEAR)
def test_every_figure_of_one_and_two_planes(plot: Any, planes: int, tmp_path: Path) -> None:
    figure = plot(fitted(planes))
    figure.savefig(tmp_path / "figure.png", dpi=40)
    assert (tmp_path / "figure.png").stat().st_size > 2000
    assert any("eccentricity" in axis.get_xlabel() or "clearance" in axis.get_xlabel() for axis in figure.axes)


@pytest.mark.parametrize("plot", ["bode", "polar", "residuals", "dynamic_stiffness", "stability"])
def test_the_figures_of_linear_fits_draw_nonlinear_ones_too(plot: str, tmp_path: Path) -> None:
    getattr(fitted(1).plot, plot)().savefig(tmp_path / "figure.png", dpi=40)


def test_the_first_screen_of_a_law_shows_it_over_its_value_in_the_centre() -> None:
    """Against Muszynska's formulas; and its texts can be read."""
    fit = fitted(1)
    assert [name for name, _ in first_figures(fit, good=True)] == ["relative_law", "damping"]
    figure = fit.plot.relative_law()
    p = {name: parameter.value for name, parameter in fit.params.items()}
    (axis,) = figure.axes
    eps, stiffness = axis.lines[0].get_data()  # solid, then dotted beyond the data, one after the other
    _, damping = axis.lines[2].get_data()
    _, ratio = axis.lines[4].get_data()
    np.testing.assert_allclose(stiffness, (1 - eps**2) ** -p["n_K"])
    np.testing.assert_allclose(damping, (1 - eps**2) ** -p["n_D"])
    np.testing.assert_allclose(ratio, (1 - eps) ** p["b"])
    assert faults_of(figure) == []


def test_points_are_data_minus_the_linear_model_and_lines_the_law() -> None:
    fit = fitted(1)
    figure = plot_nonlinear_stiffness(fit)
    test = fit.experiments[0]
    assert isinstance(test, rf.PerturbationTest)
    chosen = (test.direction == "x") & (np.abs(test.force) == 3.0)
    w, x = test.frequency[chosen], test.response[chosen]
    y = test.response[(test.direction == "y") & (np.abs(test.force) == 3.0)]
    amplitude = np.where(w > 0, (x + 1j * y) / 2, (x - 1j * y).conj() / 2)
    linear = fit.model.dynamic_stiffness(fit.theta(), w, 1000 * RPM)[:, 0, 0]
    change = 3.0 / amplitude - linear
    order = np.argsort(w)
    for axis, part in zip(figure.axes[::2], (change.real, change.imag), strict=True):
        drawn_x, drawn_y = axis.containers[1].lines[0].get_data()  # the second, larger level
        np.testing.assert_allclose(drawn_x, w[order] / RPM)
        np.testing.assert_allclose(drawn_y, part[order] * 1e-3, rtol=1e-9, atol=1e-9)
        assert "kN/m" in axis.get_ylabel()
    # the same against eccentricity
    drawn_x, _ = figure.axes[1].containers[1].lines[0].get_data()
    np.testing.assert_allclose(drawn_x, np.abs(amplitude[order]) / (CLEARANCE_UM * 1e-6))
    # the line passes through the noisy points: misfits of some standard errors, not of the effect
    line = [entry for entry in figure.axes[0].lines if len(entry.get_xdata()) == 6][-1]
    drawn = line.get_ydata()
    sigma = test.sigma[chosen][order][-6:] / np.sqrt(2) * 3.0 / np.abs(amplitude[order][-6:]) ** 2 * 1e-3
    assert (np.abs(drawn - change.real[order][-6:] * 1e-3) < 5 * sigma).all()


def test_static_stiffness_is_load_over_displacement() -> None:
    fit = fitted(1)
    figure = plot_static_stiffness(fit)
    test = fit.experiments[1]
    assert isinstance(test, rf.StaticTest)
    chosen = np.isclose(test.speed, 500 * RPM)
    ratio = test.load[chosen] / test.displacement[chosen]
    across, along = (axis.containers[0].lines[0].get_data() for axis in figure.axes)
    np.testing.assert_allclose(across[1], -ratio.imag / test.speed[chosen])
    np.testing.assert_allclose(along[1], ratio.real * 1e-3)
    p = {name: q.value for name, q in fit.params.items()}
    for axis, expected in (
        (figure.axes[0], lambda e: p["D"] * (1 - e**2) ** -p["n_D"] * p["lam"] * (1 - e) ** p["b"]),
        (
            figure.axes[1],
            lambda e: (
                1e-3
                * (
                    p["K"]
                    + p["K0"] * (1 - e**2) ** -p["n_K"]
                    - p["Mf"] * (p["lam"] * (1 - e) ** p["b"] * 500 * RPM) ** 2
                )
            ),
        ),
    ):
        line = next(entry for entry in axis.lines if len(entry.get_xdata()) > 100)
        np.testing.assert_allclose(line.get_ydata(), expected(line.get_xdata()), rtol=1e-9)


def test_the_locus_turns_the_load_down_and_the_fit_follows_the_points() -> None:
    fit = fitted(2)
    axis = plot_static_locus(fit).axes[0]
    test = fit.experiments[1]
    assert isinstance(test, rf.StaticTest)
    chosen = np.isclose(test.speed, 500 * RPM) & (test.plane == "journal")
    z = test.displacement[chosen] / (CLEARANCE_UM * 1e-6)  # loads point down already
    x, y = axis.containers[0].lines[0].get_data()
    np.testing.assert_allclose(x + 1j * np.asarray(y), z, atol=1e-9)
    curve = next(line for line in axis.lines if len(line.get_xdata()) > 100)
    locus = curve.get_xdata() + 1j * curve.get_ydata()
    sigma = test.sigma[chosen] / (CLEARANCE_UM * 1e-6)
    for point, error in zip(z, sigma, strict=True):
        assert np.abs(locus - point).min() < 5 * error + np.abs(np.diff(locus)).max()


def test_velocity_ratios_are_eigenvalues_over_speed() -> None:
    fit = fitted(1)
    axis = plot_velocity_ratio(fit).axes[0]
    line = next(entry for entry in axis.lines if len(entry.get_xdata()) > 100)
    eps, ratio = line.get_xdata(), line.get_ydata()
    for k in (0, 60, 119):
        s = off_centre_eigenvalues(fit.model, fit.theta(), 600 * RPM, float(eps[k]))
        assert np.abs(s.imag - ratio[k] * 600 * RPM).min() < 1e-9 * np.abs(s).max()
    measured = axis.containers[0].lines[0].get_data()[1]
    assert np.abs(np.subtract.outer(measured, ratio)).min(axis=1).max() < 0.1


def test_bands_are_those_of_parameters_drawn_from_their_covariance() -> None:
    fit = fitted(1)
    eps = np.array([0.0, 0.3, 0.6])
    rng = np.random.default_rng(0)
    names = list(fit.var_names)
    theta = np.tile(fit.theta(), (400, 1))
    places = [fit.model.parameter_names.index(name) for name in names]
    theta[:, places] = rng.multivariate_normal(fit.x, 1e-4 * fit.covar, size=400)  # small: the delta method is linear
    for number, curve in enumerate(law_curves(fit.model, fit.theta(), eps)):
        band = half_width(fit, 0, curve.slope, np.zeros((eps.size, len(fit.causes))))
        drawn = np.array([law_curves(fit.model, vector, eps)[number].value for vector in theta])
        scatter = 1.96 * drawn.std(axis=0) * 100
        # standard deviation of 400 draws: 3.5 %; four of these
        np.testing.assert_allclose(band, scatter, rtol=0.15)


@pytest.mark.parametrize("name", ["muszynska", "even", "spline", "two planes", "two ratios"])
def test_derivatives_of_curves_are_exact(name: str) -> None:
    model, theta = rig(name)
    eps = np.array([0.0, 0.3, 0.7])
    curves, (stiffness, slope) = law_curves(model, theta, eps), drive_stiffness(model, theta, 70j, 100.0, eps)
    assert [curve.name for curve in curves][:2] == ["K0", "D"]
    for place, parameter in enumerate(model.parameters):
        size = max(abs(theta[place]), 1e-3 * parameter.scale)
        change = np.zeros_like(theta)
        change[place] = 1e-5 * size
        ends = [law_curves(model, theta + sign * change, eps) for sign in (1, -1)]
        for number, curve in enumerate(curves):
            numeric = (ends[0][number].value - ends[1][number].value) / 2e-5
            # truncation 1e-10, round-off 1e-16 / 1e-5, of the curve's size
            np.testing.assert_allclose(curve.slope[:, place] * size, numeric, atol=1e-8 * np.abs(curve.value).max())
        ahead, behind = (drive_stiffness(model, theta + sign * change, 70j, 100.0, eps)[0] for sign in (1, -1))
        np.testing.assert_allclose(slope[:, place] * size, (ahead - behind) / 2e-5, atol=1e-7 * np.abs(stiffness).max())


def test_data_next_to_the_wall_fill_their_axes() -> None:
    """Loads that press the journal to 0.95 of the clearance, where K0 and D grow without bound a little further on."""
    model = rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=CLEARANCE_UM)
    values = ONE_MODE | POWER | {"D": 150.0}
    options: dict[str, Any] = {"tolerance": 1e-4, "noise": 0.002}
    static = rf.simulate(
        model, values, "static-load", speed_rpm=[500.0, 1000.0], load=[1.0, 3.0, 6.0, 20.0, 60.0, 150.0], **options
    )
    sweep = rf.simulate(model, values, speed_rpm=1000.0, frequency_rpm=FREQUENCY_RPM[::2], force=[2.0], **options)
    fit = rf.fit(model, [sweep, static], known={"Ds": values["Ds"]}, start=values_of(values))
    largest = max(float(block.eccentricity.max()) for block in fit.problem.blocks)
    assert largest > 0.94
    for plot in (plot_law, plot_static_stiffness):
        figure = plot(fit)
        figure.canvas.draw()
        for axis in figure.axes:
            assert largest < axis.get_xlim()[1] < 1.01
            height = [line.get_path().transformed(axis.transData).vertices[:, 1] for line in solid(axis, largest)]
            assert np.ptp(np.concatenate(height)) > 0.5 * axis.bbox.height


def solid(axis: Any, largest: float) -> list[Any]:
    """Curves over the eccentricities of the data, and their points."""
    rows = [line for line in axis.lines if line.get_linestyle() == "-" or line.get_marker() == "o"]
    return [line for line in rows if np.max(line.get_xdata()) <= 1.01 * largest]


def test_a_first_look_is_the_first_figure_of_the_report() -> None:
    """Of sweeps the dynamic stiffness, of static loads the law that they show, of neither the eigenvalues."""
    full = fitted(1)
    known = {name: full.params[name].value for name in ("Ds", "K", "M", "Mf")}
    static = rf.fit(full.model, full.experiments[1], known=known, start={"D": 150.0})
    linear = rf.models.OneMode()
    blows = rf.simulate(linear, ONE_MODE, "impulse", speed_rpm=[600.0, 1000.0], load=0.5, impulse=4e-4, noise=0.01)
    free = rf.fit(linear, blows, known={name: ONE_MODE[name] for name in ("M", "K", "Ds", "Mf")})
    titles = [heading_of(fit.plot()).partition(": ")[2] for fit in (full, static, free)]
    assert [title.partition(",")[0] for title in titles] == [
        "dynamic stiffness", "fluid against eccentricity", "stability over speed"
    ]  # fmt: skip


def test_figures_without_their_data_say_what_is_missing() -> None:
    full = fitted(1)
    known = {name: full.params[name].value for name in ("Ds", "K", "M", "Mf")}
    static = rf.fit(full.model, full.experiments[1], known=known, start={"D": 150.0})
    with refuses(ValueError):
        plot_nonlinear_stiffness(static)
    with refuses(ValueError):
        plot_velocity_ratio(static)
    sweep = rf.fit(full.model, full.experiments[0], known={"Ds": ONE_MODE["Ds"]})
    for plot in (plot_static_locus, plot_static_stiffness):
        with refuses(ValueError):
            plot(sweep)
    linear = rf.fit(rf.models.OneMode(), full.experiments[0], known={"Ds": ONE_MODE["Ds"], "K": ONE_MODE["K"]})
    for plot in NONLINEAR:
        with refuses(ValueError):
            plot(linear)


def test_each_force_level_has_a_curve_and_a_colour_that_meet_its_points() -> None:
    """One line through two levels misses both: with this law 1 and 3 N differ by a third of the stiffness."""
    fit = fitted(1)
    for kind, places in (("dynamic_stiffness", (0, 1)), ("bode", (0,))):
        figure = getattr(fit.plot, kind)()
        named = conditions_of(figure) if kind == "bode" else [text.get_text() for text in figure.axes[0].texts]
        assert {"1000 rpm, 1 N", "1000 rpm, 3 N"} <= set(named)
        for place in places:
            lines = [entry for entry in figure.axes[place].lines if entry.get_linestyle() == "-"]
            assert len({entry.get_color() for entry in lines}) == 2
            sizes = [len(entry.get_xdata()) for entry in lines]  # a gap between both sides where they are one line
            assert sizes.count(5) + sizes.count(6) + 2 * sizes.count(5 + 1 + 6) == 4  # levels, each side
    figure = fit.plot.dynamic_stiffness()
    axis = figure.axes[0]
    span = np.ptp(axis.get_ylim())
    for entry in [entry for entry in axis.lines if len(entry.get_xdata()) in (5, 6) and entry.get_linestyle() == "-"]:
        own = [c for c in axis.collections if isinstance(c, PathCollection)]
        same = [c for c in own if to_hex(c.get_facecolor()[0]) == to_hex(entry.get_color())]
        near = [np.asarray(c.get_offsets()).T for c in same if set(entry.get_xdata()) <= set(c.get_offsets()[:, 0])]
        assert near
        measured = dict(zip(*near[0], strict=True))
        miss = [abs(measured[x] - y) for x, y in zip(*entry.get_data(), strict=True)]
        assert np.median(miss) < 0.02 * span  # noise of 2 %


def test_figures_and_what_they_refuse() -> None:
    rotor = OneMode(law=Muszynska(), clearance_um=CLEARANCE_UM)
    fit = rf.fit(
        rotor, [sweep(ONE_MODE | POWER, levels=(3.0, 30.0), lines=20), static(ONE_MODE | POWER)], known={"Ds": 8.0}
    )
    radius, frequency = fit.plot.whirl(max_speed_rpm=6000, unit=("hz", "mil")).axes
    assert "mil" in radius.get_ylabel()
    line = frequency.get_lines()[0].get_xydata()
    onset = fit.threshold_speed()  # with the causes that were found
    assert line[0, 0] == pytest.approx(onset.value / (2 * np.pi), rel=1e-6)
    edges = radius.patches[0].get_xy()[[0, 2 * len(line) - 1]]  # where the branch begins, at right angles to it
    along, up = np.ptp(edges, axis=0) / (line[0, 0], CLEARANCE_UM / 25.4)
    assert (along + up**2 / along) * onset.value == pytest.approx(3.92 * onset.stderr, rel=0.02)
    _, load = fit.plot.side_load().axes
    assert "N" in load.get_xlabel()
    with refuses(ValueError):
        fit.plot.whirl(max_speed=1000 * np.pi / 30)
    linear = rf.fit(OneMode(), sweep(ONE_MODE | POWER, levels=(0.3,), lines=20), known={"K": 8e3, "Ds": 8.0})
    with refuses(ValueError):
        linear.plot.whirl()
