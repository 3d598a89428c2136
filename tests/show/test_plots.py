"""Figures: every model draws every figure, what is drawn is what was measured and fitted, in the units of the axes."""

from __future__ import annotations

import io
import itertools
import re
from dataclasses import replace
from functools import cache

import law_data
import numpy as np
import pytest
from drawn import conditions_of, faults_of, points_of, title_of
from plain import plain_fit
from slow_cases import slow_but
from synthetic import MODELS, SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.models import OneMode, WhirlWhip
from rotorfit.show.plots.style import PLAIN, decade_ticks, picture_of
from rotorfit.show.plots.uncertainty import plot_corner, plot_traces

RPM = 30 / np.pi
FIGURES = ("dynamic_stiffness", "bode", "polar", "residuals", "stability")


def fitted(name, noise=0.01, lines=40):
    model = MODELS[name]()
    theta = model.vector(TYPICAL[name])
    w = covering_frequencies(model, theta, SPEEDS[name], lines)
    test = circular_test(model, theta, speeds=SPEEDS[name], frequency=w, noise=noise)
    return plain_fit(model, test, known=known_of(name, TYPICAL[name]))


@cache
def figures(name):
    """Every figure of a fit, by the name of its kind."""
    fit = fitted(name)
    return {kind: getattr(fit.plot, kind)() for kind in FIGURES}


@cache
def fits_of_draws():
    """One mode at one speed under 80 draws of 2 % noise."""
    model, truth = OneMode(), TYPICAL["one-mode"]
    theta = model.vector(truth)
    w = covering_frequencies(model, theta, (100.0,), 60)
    tests = (
        circular_test(model, theta, speeds=(100.0,), frequency=w, noise=0.02, seed=seed, sigma_known=True)
        for seed in range(80)
    )
    return [plain_fit(model, test, known=known_of("one-mode", truth)) for test in tests]


@pytest.mark.parametrize("name", slow_but(MODELS, "whirl-whip", "anisotropic"))
def test_every_figure_of_every_model(name, tmp_path):
    for kind, figure in figures(name).items():
        figure.savefig(tmp_path / f"{kind}.png", dpi=40)
        assert (tmp_path / f"{kind}.png").stat().st_size > 2000
        labels = [axis.get_xlabel() for axis in figure.axes] + [axis.get_ylabel() for axis in figure.axes]
        assert any("rpm" in label for label in labels) or kind == "polar"


def test_dynamic_stiffness_panels_show_force_over_response():
    fit = fitted("one-mode")
    figure = fit.plot.dynamic_stiffness()
    direct, quadrature = figure.axes
    measured = rf.dynamic_stiffness(fit.experiments[0])
    chosen = measured.speed == SPEEDS["one-mode"][0]
    x, y = points_of(direct)[: np.count_nonzero(chosen)].T
    np.testing.assert_allclose(x, measured.frequency[chosen] * RPM)
    np.testing.assert_allclose(y, measured.kappa[chosen, 0, 0].real * 1e-3, rtol=1e-12)  # kN/m
    assert "kN/m" in title_of(direct)
    # The fitted quadrature line crosses zero at lam Omega, where the mark says it does.
    line = next(line for line in quadrature.lines if len(line.get_xdata()) > 100)
    p = {name: q.value for name, q in fit.params.items()}
    whirl = p["lam"] * SPEEDS["one-mode"][0]
    expected = (p["D"] * (line.get_xdata() / RPM - whirl) + p["Ds"] * line.get_xdata() / RPM) * 1e-3
    np.testing.assert_allclose(line.get_ydata(), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    texts = [text.get_text() for text in quadrature.texts]
    assert any(f"{whirl * RPM:.4g} rpm" in text for text in texts)


def test_confidence_band_is_that_of_refitted_noise():
    """Half-width of the band at one frequency against the scatter of fits to fresh noise."""
    from rotorfit.show.plots.dynamic_stiffness import _fitted, _shown

    values = []
    for fit in fits_of_draws():
        (condition,) = _shown(PLAIN, fit)
        line = _fitted(fit, condition, 0, 0, True)
        values.append(line.kappa[[10, 200]])
    band = np.array([line.direct[[10, 200]], line.quadrature[[10, 200]]]) / 1.96
    scatter = np.array([np.std(np.real(values), axis=0), np.std(np.imag(values), axis=0)])
    # The standard deviation of 80 draws is known to 8 % (one sd).
    np.testing.assert_allclose(band, scatter, rtol=0.3)


def test_missing_planes_draw_the_drive_point():
    rig = rf.datasets.rig_open()
    fit = rf.fit(WhirlWhip(), rig.select(rig.force_plane == "journal"), known={"K3": 6000.0})
    figure = fit.plot.dynamic_stiffness()
    assert "drive-point" in figure.get_suptitle()
    assert len(figure.axes) == 2


def test_axes_hold_the_middle_of_the_data_where_the_fit_is_next_to_nothing():
    """The quadrature between disk and journal is noise about a line that is nearly zero."""
    rig = rf.datasets.rig_open()
    fit = rf.fit(WhirlWhip(blocks=("coupling_mass", "coupling_damping")), rig, known={"K3": 6000.0})
    figure = fit.plot.dynamic_stiffness()
    for axis in figure.axes:
        low, high = axis.get_ylim()
        value = points_of(axis)[:, 1]
        assert value.size > 100
        assert np.all((value > low) & (value < high))


def test_stability_shows_the_threshold_and_the_tested_speeds():
    fit = fitted("one-mode")
    figure = fit.plot.stability()
    words = " ".join(text.get_text() for text in figure.axes[0].texts)
    (threshold,) = re.findall(r"threshold ([\d.]+) ±", words)
    assert float(threshold) == pytest.approx(fit.threshold_speed().value * RPM, abs=0.5)
    np.testing.assert_allclose(marked_speeds(figure), sorted(SPEEDS["one-mode"]))


def marked_speeds(figure):
    """Speeds, rad/s, at the circles of the figure of stability."""
    circles = [line.get_xdata() for line in figure.axes[0].lines if line.get_marker() == "o"]
    return sorted({round(float(rpm) / RPM, 6) for x in circles for rpm in x})


def test_tested_speeds_are_those_of_all_tests_and_those_that_were_set():
    """Constant loads and ring-downs have speeds too, and logged speeds wander about those that were set."""
    law = law_data.ONE_MODE
    model = OneMode(law=rf.models.Muszynska(), clearance_um=law_data.CLEARANCE_UM)
    tests = [law_data.ring_down(law, speed=220.0), law_data.static(law, speeds=(100.0, 180.0))]
    fit = rf.fit(model, tests, known={"K": law["K"], "Ds": law["Ds"]})
    np.testing.assert_allclose(fit.speeds, [100.0, 180.0, 220.0])
    np.testing.assert_allclose(marked_speeds(fit.plot.stability()), fit.speeds, rtol=1e-6)
    rig = rf.datasets.rig_open()
    logged = rig.speed * (1 + 1e-3 * np.random.default_rng(1).normal(size=len(rig)))
    fit = rf.fit(WhirlWhip(), replace(rig, speed=logged), known={"K3": 6000.0})
    np.testing.assert_allclose(marked_speeds(fit.plot.stability()), np.unique(rig.speed), rtol=1e-3)


def test_posterior_figures(tmp_path):
    chain = np.random.default_rng(0).normal(size=(60, 16, 3))
    plot_corner(chain.reshape(-1, 3), ["a", "b", "c"], {"a": 0.0}).savefig(tmp_path / "corner.png", dpi=40)
    plot_traces(chain, ["a", "b", "c"]).savefig(tmp_path / "traces.png", dpi=40)
    assert len(plot_corner(chain.reshape(-1, 3), ["a", "b", "c"]).axes) == 9


def texts_of(figure):
    from matplotlib.text import Text

    figure.draw_without_rendering()
    return [text for text in figure.findobj(Text) if text.get_text().strip() and text.get_visible()]


LONG = ("K0[speed_rpm=1000], N/m", "D[speed_rpm=1000], N s/m", "Ds[journal], N s/m", "phase[run=journal fwd 1500], rad")
SHORT = ("Md, kg", "Ds, N s/m", "K1, N/m", "lam")


@pytest.mark.parametrize(
    ("count", "names"), slow_but([(4, LONG), (8, SHORT), (8, LONG), (12, LONG)], (4, LONG), (8, LONG))
)
def test_labels_of_a_corner_plot_do_not_touch(count: int, names: tuple[str, ...]) -> None:
    """Labels, numbers along y and offsets of their axes; numbers along x are askew and compared by their distance."""
    rng = np.random.default_rng(1)
    about = rng.permutation(np.resize([1.6, 14835.1, 0.47332, 12.0], count))
    spread = about * np.resize([1e-3, 1e-4, 1e-5, 0.1, 1e-7], count)
    samples = about + spread * rng.normal(size=(500, count))
    figure = plot_corner(samples, [f"{i}{names[i % 4]}" for i in range(count)], {})
    picture_of(figure, dpi=100)
    boxes = {}
    for k, axis in enumerate(figure.axes):
        if not axis.get_visible():
            continue
        for side in (axis.xaxis, axis.yaxis):
            offset = side.get_offset_text()
            texts = [side.label, *([offset] if side.get_tick_params()[_SHOWN[side.axis_name]] else [])]
            texts += [t for t in _drawn_numbers(axis.yaxis) if axis.yaxis is side]
            boxes |= {(k, side.axis_name, t.get_text()): t.get_window_extent() for t in texts if t.get_text()}
        ends = [t.get_transform().transform(t.get_position())[0] for t in _drawn_numbers(axis.xaxis)]
        if axis.xaxis.label.get_text():
            assert len(ends) >= 2
            line = axis.get_xticklabels()[0].get_fontsize() * figure.dpi / 72
            assert np.diff(sorted(ends)).min() * np.sin(np.pi / 4) > line
    assert len(boxes) > 2 * count
    touching = [(a, b) for a, b in itertools.combinations(boxes, 2) if boxes[a].overlaps(boxes[b])]
    assert touching == []


def _drawn_numbers(side):
    """Numbers along an axis, but those of ticks beyond its ends, which are made and not drawn."""
    low, high = sorted(side.get_view_interval())
    shown = [tick.label1 for tick in side.get_major_ticks() if low <= tick.get_loc() <= high]
    return [label for label in shown if label.get_text() and label.get_visible()]


_SHOWN = {"x": "labelbottom", "y": "labelleft"}


@pytest.mark.parametrize("name", slow_but(["whirl-whip", "anisotropic", "one-mode"], "whirl-whip"))
def test_text_is_at_least_seven_points_on_a_page_of_a4(name):
    for kind, figure in figures(name).items():
        # A report leaves 180 mm by 225 mm of a page for a figure; a larger one is made smaller, and its text with it.
        shrunk = min(1.0, 180 / 25.4 / figure.get_figwidth(), 225 / 25.4 / figure.get_figheight())
        assert min(text.get_fontsize() for text in texts_of(figure)) * shrunk >= 6.99, kind


def two_files():
    """Three speeds not in order in one file, one of them again in a second file, read a little off."""
    model = OneMode()
    theta = model.vector(TYPICAL["one-mode"])
    w = covering_frequencies(model, theta, (100.0,), 30)
    first = circular_test(model, theta, speeds=(180.0, 60.0, 100.0), frequency=w, noise=0.01)
    again = circular_test(model, theta, speeds=(100.02,), frequency=w, noise=0.01, seed=1)
    return [first, again]


def test_a_legend_names_each_speed_once_and_in_order():
    fit = rf.fit(OneMode(), two_files(), known=known_of("one-mode", TYPICAL["one-mode"]))
    for kind in ("dynamic_stiffness", "bode", "polar", "residuals"):
        figure = getattr(fit.plot, kind)()
        words = conditions_of(figure) if kind != "dynamic_stiffness" else ends_of(figure.axes[1])
        assert [word for word in words if "rpm" in word and word[0].isdigit()] == ["573 rpm", "955 rpm", "1719 rpm"]


def ends_of(axis):
    """Names at the ends of lines, from the lowest in speed."""
    words = [
        text.get_text() for text in axis.texts if text.get_text().endswith(" rpm") and text.get_text()[0].isdigit()
    ]
    return sorted(words, key=lambda text: float(text.split()[0]))


def test_boxes_and_stability_say_which_speed_they_hold_for():
    fit = rf.fit(OneMode(), two_files()[0], known=known_of("one-mode", TYPICAL["one-mode"]), per={"D": "speed_rpm"})
    boxes = [t.get_text() for axis in fit.plot.dynamic_stiffness().axes for t in axis.texts if "slope" in t.get_text()]
    assert boxes[0].startswith("slope, 1719 rpm:")
    from rotorfit.show.plots.stability import plot_stability
    from rotorfit.show.report.parts import groups_of

    labels = [label for label, _ in groups_of(fit)]
    assert [round(float(label.partition("=")[2])) for label in labels] == [573, 955, 1719]
    for label, group in groups_of(fit):
        figure = plot_stability(fit, group=group)
        assert label in figure.get_suptitle()
        # only the speed that this group was tested at
        np.testing.assert_allclose(np.array(marked_speeds(figure)) * RPM, [float(label.partition("=")[2])], rtol=1e-6)


def test_damping_ratio_and_decrement_are_those_of_the_eigenvalues():
    fit = fitted("one-mode")
    figure = fit.plot.stability()
    _, damping, decrement = figure.axes
    curves = [line for line in damping.lines if len(line.get_xdata()) > 100]
    speeds = curves[0].get_xdata() / RPM
    k = 200
    expected = sorted(q.value for _, q, _ in fit.natural_frequencies(float(speeds[k])))
    np.testing.assert_allclose(sorted(line.get_ydata()[k] for line in curves), expected, rtol=1e-9)
    assert decrement.get_ylim() == damping.get_ylim()
    for at, label in zip(decrement.get_yticks(), decrement.get_yticklabels(), strict=True):
        zeta = float(at)
        assert float(label.get_text().replace("−", "-")) == pytest.approx(2 * np.pi * zeta / np.sqrt(1 - zeta**2))
    assert len({line.get_color() for line in curves}) == len({line.get_linestyle() for line in curves}) == 2


def test_no_panel_is_empty():
    """Only the drive points measured: each disk's own probe, when it was forced."""
    model = MODELS["two-disk"]()
    theta = model.vector(TYPICAL["two-disk"])
    w = covering_frequencies(model, theta, (0.0,), 30)
    test = circular_test(model, theta, speeds=(0.0,), frequency=w, noise=0.01)
    known, start = known_of("two-disk", TYPICAL["two-disk"]), dict(TYPICAL["two-disk"])
    for name in known:
        del start[name]
    fit = rf.fit(model, test.select(test.plane == test.force_plane), known=known, start=start)
    for kind in ("bode", "polar", "residuals"):
        figure = getattr(fit.plot, kind)()
        assert all(axis.lines or axis.patches for axis in figure.axes)
        assert len({title_of(axis) for axis in figure.axes} - {""}) == 2


def test_bode_bands_are_those_of_refitted_noise():
    logs, bands = [], []
    from rotorfit.show.plots.sweeps import curves

    for fit in fits_of_draws():
        forward = curves(fit)[1][1]
        logs.append(np.log(forward.fitted[[100, 900]]))
        bands.append(np.array(forward.band)[:, [100, 900]] / 1.96)
    scatter = np.array([np.std(np.real(logs), axis=0), np.std(np.imag(logs), axis=0)])
    # The standard deviation of 80 draws is known to 8 % (one sd).
    np.testing.assert_allclose(np.mean(bands, axis=0), scatter, rtol=0.3)


def test_points_are_shown_without_the_fits_errors_of_phase():
    """A trial weight put 0.2 rad from where it was said: the points move to the line, not the line to the points."""
    model, truth = OneMode(), TYPICAL["one-mode"]
    theta = model.vector(truth)
    w = covering_frequencies(model, theta, (100.0,), 40)
    tests = [
        circular_test(model, theta, speeds=(speed,), frequency=w, noise=0.002, force=5.0 * np.exp(1j * angle))
        for speed, angle in ((100.0, 0.4), (140.0, 0.4))
    ]
    from dataclasses import replace

    off = replace(tests[1], force=tests[1].force * np.exp(0.2j), run=np.array(["b" + r for r in tests[1].run]))
    fit = rf.fit(model, [tests[0], off], known=known_of("one-mode", truth), phase_offsets=True)
    from rotorfit.show.plots.sweeps import curves

    for curve in curves(fit)[1]:
        at = np.interp(curve.frequency, curve.fine, np.unwrap(np.angle(curve.fitted)))
        miss = np.angle(curve.measured * np.exp(-1j * at))
        # noise 0.2 % of the rms, resonances apart some per cent; the error was 0.2
        assert np.median(np.abs(miss)) < 0.02


def labels_on_page(figure, axis):
    """Boxes of the labels of an axis that have text and lie on it, with their sizes of type."""
    figure.savefig(io.BytesIO())
    low, high = sorted(axis.get_view_interval())
    ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
    shown = [t.label1 for t in ticks if t.label1.get_text() and low <= t.get_loc() <= high]
    return [label.get_window_extent() for label in shown], {label.get_fontsize() for label in shown}


@pytest.mark.slow
def test_labels_of_low_logarithmic_panels_stand_apart_and_are_of_one_size():
    """Eight panels above each other, each over a third of a decade."""
    fit = rf.fit(rf.models.Modal(("disk2", "disk1")), rf.datasets.rk4(), phase_offsets="common")
    figure = fit.plot.bode()
    for axis in figure.axes[::2]:
        boxes, sizes = labels_on_page(figure, axis.yaxis)
        assert len(boxes) >= 2
        assert len(sizes) == 1
        boxes.sort(key=lambda box: box.y0)
        assert all(below.y1 < above.y0 + 1 for below, above in itertools.pairwise(boxes))


def test_numbers_below_one_are_written_as_people_write_them() -> None:
    from matplotlib.figure import Figure

    axis = Figure().add_subplot()
    axis.set_yscale("log")
    axis.set_ylim(0.05, 200.0)
    decade_ticks(axis.yaxis)
    shown = [label.get_text() for label in axis.get_yticklabels()]
    assert {"0.1", "1", "10", "100"} <= set(shown)
    assert not any("e" in words for words in shown)


def test_labels_of_lam_omega_stand_apart_and_inside() -> None:
    """Of many speeds, some nearly alike, each has a mark, few have words; one is next to the end of the axis."""
    model = OneMode()
    theta = model.vector(TYPICAL["one-mode"])
    for speeds in ((60.0, 64.0, 100.0, 140.0, 170.0, 172.0, 174.0, 178.0, 180.0, 182.0), (60.0, 100.0, 178.0, 182.0)):
        labels_stand_apart(model, theta, speeds)


def labels_stand_apart(model, theta, speeds) -> None:
    w = np.linspace(5.0, 1.02 * 182.0 * TYPICAL["one-mode"]["lam"], 12)
    test = circular_test(model, theta, speeds=speeds, frequency=w, noise=0.01, seed=2)
    for options in ({}, {"per": {"lam": "speed_rpm"}}):
        fit = rf.fit(model, test, known=known_of("one-mode", TYPICAL["one-mode"]), **options)
        figure = fit.plot.dynamic_stiffness(against="ratio" if options else "frequency")
        figure.canvas.draw()
        axis = figure.axes[1]
        marks = [line for line in axis.lines if line.get_marker() == "D"]
        assert len(marks) == len(speeds)
        labels = [text for text in axis.texts if text.get_text().startswith("λ")]
        assert len(labels) == (len(speeds) if len(speeds) <= 4 else 0)
        assert [fault for fault in faults_of(figure) if "λ" in fault] == []


def test_readings_of_dynamic_stiffness_hide_no_fit(rig_refinement):
    figure = rig_refinement.best.plot.dynamic_stiffness()
    figure.canvas.draw()
    boxes = [(axis, text) for axis in figure.axes for text in axis.texts if "at 0" in text.get_text()]
    boxes += [(axis, text) for axis in figure.axes for text in axis.texts if "slope" in text.get_text()]
    assert len(boxes) == 5  # the model that is kept has no damping between the planes, which have one panel
    for axis, text in boxes:
        covered = text.get_window_extent()
        for line in (line for line in axis.lines if line.get_linestyle() == "-" and line.get_linewidth() > 1):
            at = axis.transData.transform(line.get_xydata())
            assert not any(covered.contains(x, y) for x, y in at.tolist()), text.get_text()


def test_labels_name_the_frequency_that_the_table_has(rig_fit: rf.FitResult) -> None:
    """Of the mode at the tested speed, not at the nearest speed of the curve."""
    fit = plain_fit(rig_fit.model, rig_fit.experiments, known=rig_fit.settings.known)
    top = float(np.max(fit.speeds))
    words = " ".join(text.get_text() for text in fit.plot.stability().axes[0].texts)
    for frequency, ratio, _ in fit.natural_frequencies(top):
        rpm = abs(frequency.value) * 30 / np.pi
        assert f" {rpm:.0f}" in words or ratio.value > 0.99


def test_modes_against_speed_are_those_of_the_tables_with_the_causes_found() -> None:
    """The bundled rig's gyroscopic effects move its threshold by 1.4 %: the curve of damping crosses zero there."""
    fit = rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0})
    figure = fit.plot.stability()
    frequency, damping = (axis.get_lines() for axis in figure.axes[:2])
    to_rad_s, onset = np.pi / 30, fit.threshold_speed().value
    curves = [np.asarray(line.get_xydata(), dtype=float) for line in damping if len(line.get_xdata()) > 100]
    falling = next(curve for curve in curves if curve[-1, 1] < 0)[::-1]
    last = falling[: np.argmax(falling[:, 1]) + 1]  # from the fastest speed to where damping is largest
    crossed = to_rad_s * np.interp(0.0, last[:, 1], last[:, 0])
    assert abs(crossed - onset) < 0.1 * abs(fit.onset(0).speed - onset)  # what is to second order
    tested = float(fit.speeds[-1])
    drawn = [np.asarray(line.get_xydata(), dtype=float) for line in frequency if len(line.get_xdata()) > 100]
    shown = sorted(to_rad_s * np.interp(tested / to_rad_s, *line.T) for line in drawn[:4])
    printed = sorted(mode.value for mode, *_ in fit.natural_frequencies(tested))
    np.testing.assert_allclose(shown, printed, rtol=1e-6, atol=1e-6)


def test_a_phase_that_may_be_any_fills_turns_that_can_be_counted(
    rig_fit: rf.FitResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fit far from its data has bands of any width; marks every half turn of them would take all memory."""
    from rotorfit.show.plots import bode, sweeps

    conditions, found = sweeps.curves(rig_fit)
    wild = [replace(curve, band=(curve.band[0], np.full_like(curve.band[1], 1e12))) for curve in found]
    monkeypatch.setattr(bode, "curves", lambda *_: (conditions, wild))
    drawn = rig_fit.plot.bode()
    ends = [end for axes in drawn.axes if "angle" in axes.get_ylabel() for end in axes.get_ylim()]
    assert ends
    assert max(map(abs, ends)) < 5 * 360
