"""Posteriors of a refined fit to the finite-element rig: what they hold, what follows, in ArviZ and in files."""

from __future__ import annotations

import re
from dataclasses import fields, replace

import numpy as np
import pytest
from posteriors import KNOWN, TRUTH, one_mode_test, quick
from sentences import refuses

import rotorfit as rf
from rotorfit.estimators.inference.log_posterior import LogPosterior
from rotorfit.identify.uncertainty.derived import Derived
from rotorfit.identify.uncertainty.posterior_file import load_arviz
from rotorfit.models import OneMode, threshold_speed
from rotorfit.models.motion.stability import threshold_speeds

# ---- the finite-element rig -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rig(rig_fit):
    return rig_fit.sample(seed=1, refine=True)


@pytest.mark.slow
def test_refined_intervals_contain_the_truth(rig):
    assert rig.converged
    assert "structure chosen by AIC: + coupling mass" in rig.treatment
    rpm = 30 / np.pi
    low, high = rig.threshold_speed().interval(0.99)
    assert low * rpm < 2656.7 < high * rpm
    assert (high - low) * rpm < 10
    for name, truth in {"D": 450.0, "lam": 0.475, "Mf": 0.35}.items():
        low, high = rig.interval(name, 0.99)
        assert low < truth < high


@pytest.fixture(scope="module")
def noise_alone():
    return rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0}, causes=None)


def test_posterior_agrees_with_the_normal_approximation(noise_alone):
    """1600 lines leave it close to normal: medians within a fifth of a standard error, widths of the noise alone."""
    post = quick(noise_alone, ess=4000)
    levels = LogPosterior(noise_alone.problem, "marginal", work=0).laplace(noise_alone.x)
    assert post.names == noise_alone.var_names
    width = np.sqrt(np.diag(levels[1]))
    np.testing.assert_allclose(np.median(post.samples, axis=0), levels[0], atol=0.2 * width.max(), rtol=0.01)
    np.testing.assert_allclose(post.samples.std(axis=0), width, rtol=0.1)


def test_channels_of_the_same_name_keep_levels_of_their_own(tmp_path):
    """Two files that both call their run a sweep."""
    tests = [one_mode_test(seed=s, speeds=(v,), sigma_known=True) for s, v in ((1, 100.0), (2, 180.0))]
    fit = rf.fit(OneMode(), [replace(t, run=np.full(len(t), "sweep")) for t in tests], known=KNOWN)
    post = quick(fit, noise="sampled", max_steps=100)
    assert post.names[-2:] == ("log_s[sweep (synthetic #1) / journal]", "log_s[sweep (synthetic #2) / journal]")
    post.save(tmp_path / "posterior.nc")
    np.testing.assert_array_equal(rf.load_posterior(tmp_path / "posterior.nc", fit).chain, post.chain)


def test_noise_levels_are_told_against_the_noise_of_the_data(rig):
    """A refined fit has levels of its own, which are no part of the noise given with the data."""
    levels = rig.fit.settings.noise_scale.values()
    told = re.search(r"at the optimum (\S+) to (\S+) times the noise given", rig.treatment)
    assert told is not None
    assert [float(level) for level in told.groups()] == pytest.approx([min(levels), max(levels)], rel=0.02)
    fixed = quick(rig.fit, noise="fixed", walkers=64, max_steps=100)
    assert fixed.treatment == (
        "noise of each response at the level of the residuals of the refined fit; "
        f"{len(rig.fit.settings.solved.causes)} causes beside the model integrated out. The uncertainty of the "
        "choice among candidate models, which standard errors hold, is not in these draws of one model"
    )


def test_model_limits_are_told(noise_alone):
    plain = quick(noise_alone, max_steps=50)
    assert "the model, not the noise, limits the fit" in plain.treatment
    assert "refine=True" in plain.treatment
    fixed = quick(noise_alone, noise="fixed")
    assert fixed.settings.inflation == noise_alone.redchi
    assert f"widened by {np.sqrt(noise_alone.redchi):.3g}" in fixed.treatment
    width = [noise_alone.params[name].stderr for name in fixed.names]
    np.testing.assert_allclose(fixed.samples.std(axis=0), width, rtol=0.1)


def test_summary_is_complete(rig):
    az = load_arviz()

    text = rig.summary()
    assert text == str(rig)
    assert text.startswith("converged")
    for word in ("R-hat", "bulk ESS", "tail ESS", "acceptance", "seed 1", *rig.names):
        assert word in text
    table = az.summary(rig.to_arviz(), round_to="none")
    assert (table["r_hat"].astype(float) < 1.015).all()
    row = next(line for line in text.splitlines() if line.startswith("lam ")).split()
    assert float(row[7]) == pytest.approx(float(table.loc["lam", "ess_bulk"]), abs=1)
    # The tails of ArviZ's own table depend on its version: here those of the 90 % interval are shown.
    lam = rig.chain[:, :, rig.names.index("lam")].T
    tail = min(float(az.ess(lam, method="quantile", prob=q)) for q in (0.05, 0.95))
    assert float(row[8]) == pytest.approx(tail, abs=1)


# ---- derived quantities ---------------------------------------------------------------------------------------------


def test_many_thresholds_are_those_of_one_at_a_time(rig):
    model, band, theta = rig.fit.model, rig.fit.stability_band, rig.thetas(draws=25)
    speed, whirl = threshold_speeds(model, theta, band=band)
    for i, vector in enumerate(theta):
        one = threshold_speed(model, vector, band=band)
        assert speed[i] == pytest.approx(one.speed, rel=1e-9)
        assert whirl[i] == pytest.approx(one.whirl_frequency, rel=1e-9)


def test_draws_without_a_threshold():
    """lam near zero on either side: half of the rotors are never unstable forward; a dry one always."""
    model = OneMode()
    theta = np.tile(model.vector(TRUTH), (6, 1))
    theta[::2, model.parameter_names.index("D")] = 0.0  # no cross stiffness, no instability
    theta[::2, model.parameter_names.index("Mf")] = 0.0
    speed, whirl = threshold_speeds(model, theta)
    assert np.isinf(speed[::2]).all()
    assert np.isnan(whirl[::2]).all()
    np.testing.assert_allclose(speed[1::2], threshold_speed(model, theta[1]).speed, rtol=1e-9)
    unstable = theta[:3].copy()
    unstable[:, model.parameter_names.index("Ds")] = -2000.0
    np.testing.assert_array_equal(threshold_speeds(model, unstable)[0], 0.0)
    onset = Derived(name="threshold speed", unit="rad/s", samples=speed)
    assert onset.missing == 0.5
    assert onset.interval(0.95)[0] == speed[1]
    assert onset.interval(0.95)[1] == np.inf
    ratio = Derived(name="whirl ratio", unit="1", samples=whirl)
    assert np.isfinite([ratio.value, *ratio.interval()]).all()
    assert np.isnan(Derived(name="none", unit="1", samples=np.full(3, np.nan)).value)
    with refuses(ValueError):
        onset.interval(95)


@pytest.mark.slow
def test_derived_quantities_follow_the_draws(rig):
    fit, model = rig.fit, rig.fit.model
    assert rig.whirl_ratio().value == pytest.approx(fit.whirl_ratio(), rel=1e-3)
    onset, delta = rig.threshold_speed(), fit.threshold_speed()
    chosen = rf.fit(model, rf.datasets.rig_open(), known={"K3": 6000.0})
    assert onset.stderr == pytest.approx(chosen.threshold_speed().stderr, rel=0.1)
    assert onset.stderr < delta.stderr  # which holds the choice of the structure too
    assert abs(onset.value - delta.value) < 0.5 * delta.stderr
    for (frequency, damping, _), (w, zeta, _) in zip(
        rig.natural_frequencies(200.0), fit.natural_frequencies(200.0), strict=True
    ):
        assert abs(frequency.value - w.value) < 3 * w.stderr
        assert abs(damping.value - zeta.value) < 3 * zeta.stderr
    low, high = rig.lam_speed(200.0).interval()
    assert (low, high) == pytest.approx([200 * v for v in rig.interval("lam")])
    with refuses(KeyError):
        rig.lam_speed(200.0, name="lam_D")
    w = np.array([-150.0, 60.0])
    bands = rig.dynamic_stiffness(w, 200.0)
    one = model.dynamic_stiffness(rig.thetas()[7], w, 200.0)
    np.testing.assert_allclose(bands.direct.samples[7] + 1j * bands.quadrature.samples[7], one, rtol=1e-12)
    low, high = bands.quadrature.interval(0.9)
    assert low.shape == (2, 2, 2)
    assert ((low <= bands.quadrature.value) & (bands.quadrature.value <= high)).all()


def test_mode_shapes_solve_the_equation_of_motion(rig):
    model, theta = rig.fit.model, rig.thetas()
    for mode in rig.modal_parameters(200.0):
        shape = mode.amplitude.samples * np.exp(1j * mode.phase.samples)
        s = -mode.decay_rate.samples + 1j * mode.frequency.samples
        np.testing.assert_allclose(mode.damping_ratio.samples, mode.decay_rate.samples / np.abs(s))
        for n in (0, 500, 1999):
            coefficients = model.motion(theta[n], 200.0)
            kappa = np.einsum("k,kij->ij", s[n] ** np.arange(len(coefficients)), coefficients)
            assert np.abs(kappa @ shape[n]).max() < 1e-6 * np.abs(kappa).max()
        assert np.abs(shape).max() == pytest.approx(1.0)


def test_figures_are_drawn():
    post = quick(rf.fit(OneMode(), one_mode_test(), known=KNOWN), max_steps=60)
    assert len(post.plot.traces().axes) == len(post.names)
    assert post.plot.corner().axes


# ---- ArviZ and files ------------------------------------------------------------------------------------------------


def test_arviz_holds_every_draw(rig, monkeypatch):
    az = load_arviz()
    import xarray as xr

    tree = rig.to_arviz()
    old = int(az.__version__.partition(".")[0]) < 1
    assert isinstance(tree, az.InferenceData if old else xr.DataTree)
    for i, name in enumerate(rig.names):
        np.testing.assert_array_equal(tree["posterior"][name].values, rig.chain[:, :, i].T)
    np.testing.assert_array_equal(tree["sample_stats"]["lp"].values, rig.log_density.T)
    monkeypatch.setattr(az, "__version__", "1.0.0")
    later = rig.to_arviz()
    assert isinstance(later, xr.DataTree)
    np.testing.assert_array_equal(later["posterior"]["D"].values, rig.chain[:, :, rig.names.index("D")].T)


def test_files_read_back_the_same(tmp_path, rig):
    az = load_arviz()

    path = tmp_path / "posterior.nc"
    rig.save(path)
    assert [p.name for p in tmp_path.iterdir()] == ["posterior.nc"]
    again = rf.load_posterior(path, rig.fit)
    for field in fields(rig):
        ours, theirs = getattr(rig, field.name), getattr(again, field.name)
        if isinstance(ours, np.ndarray):
            np.testing.assert_array_equal(ours, theirs)
        else:
            assert ours == theirs
    np.testing.assert_array_equal(
        az.from_netcdf(str(path))["posterior"]["lam"].values, again.to_arviz()["posterior"]["lam"]
    )


def test_names_with_a_slash_are_kept(tmp_path):
    test = one_mode_test()
    test = replace(test, run=np.char.replace(test.run, " ", "/"))
    post = quick(rf.fit(OneMode(), test, known=KNOWN, phase_offsets=True), ess=100, max_steps=100)
    assert any("/" in name for name in post.names)
    post.save(tmp_path / "p.nc")
    assert rf.load_posterior(tmp_path / "p.nc", post.fit).names == post.names


def test_files_of_something_else_are_refused(tmp_path, rig, rig_fit):
    path = tmp_path / "p.nc"
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN)
    quick(fit, max_steps=40).save(path)
    with refuses(ValueError):
        rf.load_posterior(path, rig_fit)
    other = rf.fit(OneMode(), one_mode_test(seed=9), known=KNOWN)
    with refuses(ValueError):
        rf.load_posterior(path, other)
    rf.write(one_mode_test(), tmp_path / "test.nc")
    with refuses(ValueError):
        rf.load_posterior(tmp_path / "test.nc", fit)
    (tmp_path / "text.nc").write_text("not netCDF")
    with refuses(ValueError):
        rf.load_posterior(tmp_path / "text.nc", fit)
    with pytest.raises(FileNotFoundError):
        rf.load_posterior(tmp_path / "missing.nc", fit)
