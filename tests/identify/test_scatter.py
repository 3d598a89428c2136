"""Where large residuals come from: a plateau, single lines, a bound, one component; not the noise, nor a jitter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import MODELS, SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.identify.fitting.fit import fitted
from rotorfit.identify.fitting.settings import FitSettings


def typical_test(name, noise=0.01, seed=1, **options):
    """A typical rotor's model and test of a hundred lines at each speed."""
    model = MODELS[name]()
    theta, speeds = model.vector(TYPICAL[name]), SPEEDS[name]
    frequency = covering_frequencies(model, theta, speeds, 100)
    return model, circular_test(model, theta, speeds=speeds, frequency=frequency, noise=noise, seed=seed, **options)


def hit(test, kick, row=37):
    """The test with one line of one run moved by a multiple of the typical reading."""
    line = (test.run == test.run[row]) & (test.frequency == test.frequency[row])
    moved = kick * np.median(np.abs(test.response)) * np.exp(0.7j)
    return replace(test, response=np.where(line, test.response + moved, test.response))


@pytest.mark.parametrize("kick", [3.0, 30.0])
@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize("name", ["one-mode", "whirl-whip"])
def test_one_line_that_was_hit_is_named_and_the_remedy_is_one(name, given, kick):
    model, test = typical_test(name, sigma_known=given)
    test, known = hit(test, kick), known_of(name, TYPICAL[name])
    fit = rf.fit(model, test, known=known)
    (words,) = [words for words in fit.warnings if "1 line alone" in words]
    w = np.abs(test.frequency[37]) * 30 / np.pi
    assert f"{test.run[37]} at {w:.4g} rpm" in words
    assert 'loss="soft_l1"' in words
    assert not any("the noise is larger" in one or "jitters" in one for one in fit.warnings)
    robust = rf.fit(model, test, known=known, loss="soft_l1")
    assert all(abs(p.value - TYPICAL[name][n]) < 5 * p.stderr for n, p in robust.params.items() if p.vary)
    assert not robust.notices


@pytest.mark.parametrize("factor", [10.0, 100.0])
@pytest.mark.parametrize("given", [True, False])
def test_a_line_that_draws_the_fit_to_itself_is_named_and_no_error_of_the_data(given, factor):
    """Unbalance is many times the response to a small perturbator where the line is at 1x."""
    model, test = typical_test("one-mode", sigma_known=given)
    at = int(np.argmin(np.abs(test.frequency - test.speed)))
    line = (test.run == test.run[at]) & (test.frequency == test.frequency[at])
    known = known_of("one-mode", TYPICAL["one-mode"])
    fit = rf.fit(model, replace(test, response=np.where(line, factor, 1.0) * test.response), known=known)
    codes = {finding.code: finding.severity for finding in fit.findings}
    assert "bad-lines" in codes
    assert "error" not in codes.values()
    assert "noise-larger" not in codes
    (words,) = [words for words in fit.warnings if "1 line alone" in words]
    assert "the turning speed)" in words
    left = rf.fit(model, test.select(~line), known=known)
    assert all(abs(p.value - TYPICAL["one-mode"][n]) < 4 * p.stderr for n, p in left.params.items() if p.vary)


def test_a_line_at_the_turning_speed_is_called_so():
    model, test = typical_test("one-mode", sigma_known=True)
    at = int(np.argmin(np.abs(test.frequency - test.speed)))
    assert abs(test.frequency[at] / test.speed[at] - 1) < 0.02
    fit = rf.fit(model, hit(test, 10.0, at), known={"K": 8000.0, "Ds": 8.0})
    assert any("the turning speed)" in words for words in fit.warnings)


def test_many_lines_are_no_single_ones():
    model, test = typical_test("one-mode", sigma_known=True)
    for row in range(0, len(test), 13):
        test = hit(test, 5.0, row)
    fit = rf.fit(model, test, known={"K": 8000.0, "Ds": 8.0})
    assert not any("line alone" in words or "lines alone" in words for words in fit.warnings)


def test_a_plateau_is_no_optimum():
    model, test = typical_test("one-mode")
    for start in ({"K0": 1e12}, {"D": -1e9, "M": 1e6}, {"M": 1e9, "Mf": 1e8}, {"K0": -1e9, "D": 1e10, "lam": 1.5}):
        # As no user's fit ends: that one is tried from the data too.
        fit = fitted(model, (test,), FitSettings(known={"K": 8000.0, "Ds": 8.0}, start=start, method="gauss-newton"))
        share = fit.chisqr / np.sum(np.abs(fit.problem.measured / fit.problem.sigma) ** 2)
        if share > 0.9:
            assert not fit.success
            assert np.isnan(fit.params["K0"].stderr)
            assert not any("noise is larger" in words for words in fit.warnings)


def test_readings_that_are_noise_are_fitted():
    # Noise as large as the readings leaves residuals as large, and redchi says that they are noise.
    model, test = typical_test("one-mode", noise=3.0, sigma_known=True)
    fit = rf.fit(model, test, known={"K": 8000.0, "Ds": 8.0})
    assert fit.redchi < 1.5
    assert "nothing explained" not in fit.message


def test_a_bound_that_keeps_the_model_from_the_data_is_named_and_no_jitter():
    model, test = typical_test("one-mode")
    for pair in ((0.44, 0.458), (0.3, 0.456)):
        fit = rf.fit(model, test, known={"K": 8000.0, "Ds": 8.0}, bounds={"lam": pair})
        assert fit.params["lam"].at_bound
        assert not any("jitters" in words for words in fit.warnings)
        assert any("lam rests on its bound" in words for words in fit.warnings)


def test_noise_on_amplitudes_alone_is_no_jitter():
    model, test = typical_test("whirl-whip", noise=0.0)
    error = 0.03 * np.random.default_rng(2).normal(size=len(test))
    fit = rf.fit(model, replace(test, response=test.response * (1 + error)), known={"K3": 6000.0})
    said = [words for words in fit.warnings if "scatter more" in words]
    assert all("amplitudes" in words for words in said)
    assert not any("jitters" in words for words in fit.warnings)


def test_noise_on_amplitudes_of_few_readings_is_no_jitter():
    """Values that are fitted carry a part of it over to the phases."""
    model, theta = MODELS["one-mode"](), TYPICAL["one-mode"]
    frequency = covering_frequencies(model, model.vector(theta), SPEEDS["one-mode"], 12)
    test = circular_test(model, model.vector(theta), speeds=SPEEDS["one-mode"], frequency=frequency, noise=0.0)
    error = 0.03 * np.random.default_rng(2).normal(size=len(test))
    noisy = replace(test, response=test.response * (1 + error), sigma=0.005 * np.abs(test.response))
    fit = rf.fit(model, noisy, known=known_of("one-mode", theta))
    assert any("only in their amplitudes, as where noise was simulated" in words for words in fit.warnings)


@pytest.mark.parametrize("given", [True, False])
def test_a_mode_that_the_model_lacks_is_no_jitter_and_no_line_alone(given):
    """Displacement of a disk that tilts, fitted as one mode, on lines too coarse for residuals to follow each other."""
    disk = {"M": 5.0, "It": 0.05, "Ip": 0.09, "k11": 4e6, "k12": -3e5, "k22": 4e4, "d1": 60.0, "d2": 0.6}
    w = np.pi / 30 * np.arange(400.0, 14001.0, 340.0)
    rng, rows = np.random.default_rng(3), []
    for speed in np.pi / 30 * np.array([2500.0, 6500.0]):
        for s in np.concatenate([w, -w]):
            z = disk["k11"] - disk["M"] * s**2 + 1j * s * disk["d1"]
            tilt = disk["k22"] - disk["It"] * s**2 + disk["Ip"] * speed * s + 1j * s * disk["d2"]
            rows.append((speed, s, 10.0 / (z - disk["k12"] ** 2 / tilt)))
    speed, frequency, response = (np.array(column) for column in zip(*rows, strict=True))
    noise = 2e-8
    test = rf.PerturbationTest(
        run=np.array([f"{v:.0f} {'f' if s > 0 else 'b'}" for v, s in zip(speed, frequency, strict=True)]),
        speed=speed.real,
        frequency=frequency.real,
        force_plane=np.full(len(rows), "disk"),
        force=np.full(len(rows), 10.0 + 0j),
        plane=np.full(len(rows), "disk"),
        direction=np.full(len(rows), "z"),
        response=response + noise * (rng.normal(size=len(rows)) + 1j * rng.normal(size=len(rows))),
        sigma=np.full(len(rows), noise if given else np.nan),
    )
    fit = rf.fit(rf.models.OneMode(("disk",)), test)
    assert fit.redchi > 1e4
    assert not any("alone (" in words or "jitters" in words for words in fit.warnings)
    if not given:
        assert any("which is no jitter: the model misses a mode" in words for words in fit.warnings)
