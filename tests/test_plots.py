"""Figures: every model draws every figure, what is drawn is what was measured and fitted, in the units of the axes."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import MODELS, SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.models import OneMode, WhirlWhip
from rotorfit.plots.responses import plot_corner, plot_traces

RPM = 30 / np.pi
FIGURES = ("dynamic_stiffness", "bode", "polar", "residuals", "stability")


def fitted(name, noise=0.01, lines=40):
    model = MODELS[name]()
    theta = model.vector(TYPICAL[name])
    w = covering_frequencies(model, theta, SPEEDS[name], lines)
    test = circular_test(model, theta, speeds=SPEEDS[name], frequency=w, noise=noise)
    return rf.fit(model, test, known=known_of(name, TYPICAL[name]))


@pytest.mark.parametrize("name", MODELS)
def test_every_figure_of_every_model(name, tmp_path):
    fit = fitted(name)
    for kind in FIGURES:
        figure = getattr(fit, f"plot_{kind}")()
        figure.savefig(tmp_path / f"{kind}.png", dpi=40)
        assert (tmp_path / f"{kind}.png").stat().st_size > 2000
        labels = [axis.get_xlabel() for axis in figure.axes] + [axis.get_ylabel() for axis in figure.axes]
        assert any("rpm" in label for label in labels) or kind == "polar"


def test_dynamic_stiffness_panels_show_force_over_response():
    fit = fitted("one-mode")
    figure = fit.plot_dynamic_stiffness()
    direct, quadrature = figure.axes
    measured = rf.dynamic_stiffness(fit.experiments[0])
    chosen = measured.speed == SPEEDS["one-mode"][0]
    container = direct.containers[0]
    x, y = container.lines[0].get_data()
    np.testing.assert_allclose(x, measured.frequency[chosen] * RPM)
    np.testing.assert_allclose(y, measured.kappa[chosen, 0, 0].real * 1e-3, rtol=1e-12)  # kN/m
    assert "kN/m" in direct.get_ylabel()
    # The fitted quadrature line crosses zero at lam Omega, where the mark says it does.
    line = next(line for line in quadrature.lines if len(line.get_xdata()) > 100)
    p = {name: q.value for name, q in fit.params.items()}
    whirl = p["lam"] * SPEEDS["one-mode"][0]
    expected = (p["D"] * (line.get_xdata() / RPM - whirl) + p["Ds"] * line.get_xdata() / RPM) * 1e-3
    np.testing.assert_allclose(line.get_ydata(), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    texts = [text.get_text() for text in quadrature.texts]
    assert any(f"{whirl * RPM:.0f} rpm" in text for text in texts)


def test_confidence_band_is_that_of_refitted_noise():
    """Half-width of the band at one frequency against the scatter of fits to fresh noise."""
    from rotorfit.plots.dynamic_stiffness import _conditions, _fitted

    model, truth = OneMode(), TYPICAL["one-mode"]
    theta = model.vector(truth)
    w = covering_frequencies(model, theta, (100.0,), 60)
    values = []
    for seed in range(80):
        test = circular_test(model, theta, speeds=(100.0,), frequency=w, noise=0.02, seed=seed, sigma_known=True)
        fit = rf.fit(model, test, known=known_of("one-mode", truth))
        (condition,) = _conditions(fit.problem.blocks[0])
        _, kappa, direct, quadrature = _fitted(fit, condition, 0, 0, True)
        values.append(kappa[[10, 200]])
    band = np.array([direct[[10, 200]], quadrature[[10, 200]]]) / 1.96
    scatter = np.array([np.std(np.real(values), axis=0), np.std(np.imag(values), axis=0)])
    # The standard deviation of 80 draws is known to 8 % (one sd).
    np.testing.assert_allclose(band, scatter, rtol=0.3)


def test_missing_planes_draw_the_drive_point():
    rig = rf.datasets.rig_open()
    fit = rf.fit(WhirlWhip(), rig.select(rig.force_plane == "journal"), known={"K3": 6000.0})
    figure = fit.plot_dynamic_stiffness()
    assert "Drive-point" in figure.get_suptitle()
    assert len(figure.axes) == 2


def test_stability_shows_the_threshold_and_the_tested_speeds():
    fit = fitted("one-mode")
    figure = fit.plot_stability()
    legend = " ".join(text.get_text() for text in figure.legends[0].get_texts())
    assert f"threshold {fit.threshold_speed().value * RPM:.1f}" in legend
    assert "tested speeds" in legend
    marks = [line.get_xdata()[0] for line in figure.axes[0].lines if line.get_marker() == "^"]
    np.testing.assert_allclose(sorted(marks), sorted(np.array(SPEEDS["one-mode"]) * RPM))


def test_posterior_figures(tmp_path):
    chain = np.random.default_rng(0).normal(size=(60, 16, 3))
    plot_corner(chain.reshape(-1, 3), ["a", "b", "c"], {"a": 0.0}).savefig(tmp_path / "corner.png", dpi=40)
    plot_traces(chain, ["a", "b", "c"]).savefig(tmp_path / "traces.png", dpi=40)
    assert len(plot_corner(chain.reshape(-1, 3), ["a", "b", "c"]).axes) == 9
