"""Fits to spectral lines of shafts that are not round: truth recovered, no false anisotropy, honest refusals."""

import numpy as np
import pytest
from line_tests import ALL, FORCE, SPEED, TORSION, VALUES, W, line_test
from plain import plain_fit, summary_words
from sentences import refuses

import rotorfit as rf
from rotorfit.identify.fitting.anisotropy import magnitude_interval


def test_lines_and_twist_give_every_parameter_with_errors_that_hold():
    model = rf.models.AnisotropicShaft()
    truth = VALUES | TORSION
    pulls = []
    for seed in range(12):
        test = line_test(model, truth, ALL, np.random.default_rng(seed), steady=("1x", "2x"))
        fit = plain_fit(model, test)
        assert fit.success
        assert 0.7 < fit.redchi < 1.3
        pulls.append([(fit.params[name].value - truth[name]) / fit.params[name].stderr for name in truth])
    pulls = np.array(pulls)
    # 12 x 14 pulls, correlated within a fit: rms one to 25 %, none beyond 4.5.
    assert np.abs(pulls).max() < 4.5
    assert 0.75 < np.sqrt(np.mean(pulls**2)) < 1.3


def test_stiffness_and_damping_of_the_twist_are_another_way_to_say_the_same():
    test = line_test(rf.models.AnisotropicShaft(), VALUES | TORSION, ALL, np.random.default_rng(3))
    modal = plain_fit(rf.models.AnisotropicShaft(), test, known={"J": 2e-4})
    stiff = plain_fit(rf.models.AnisotropicShaft(torsion="stiffness"), test, known={"J": 2e-4})
    assert stiff.chisqr == pytest.approx(modal.chisqr, rel=1e-8)
    assert stiff.params["kt"].value == pytest.approx(2e-4 * modal.params["nu_t"].value ** 2, rel=1e-6)


def test_what_the_lines_do_not_tell_is_said():
    few = -np.linspace(30.0, 310.0, 24)
    test = line_test(rf.models.AnisotropicShaft(), VALUES | TORSION, ALL, np.random.default_rng(3), sweep=few)
    fit = plain_fit(rf.models.AnisotropicShaft(), test)  # J, eccentricity and side load only by their ratios
    assert {"J", "ec", "es", "Px", "Py"} <= set(fit.identifiability.unresolved)
    assert fit.params["nu_t"].value == pytest.approx(340.0, rel=1e-3)
    lateral = line_test(rf.models.AnisotropicShaft(), VALUES | TORSION, ALL[:2], np.random.default_rng(3), sweep=few)
    assert {"ec", "Px"} <= set(plain_fit(rf.models.AnisotropicShaft(torsion=None), lateral).identifiability.unresolved)


def test_a_round_shaft_is_called_round_in_19_of_20_tests():
    model = rf.models.AnisotropicShaft(torsion=None)
    known = {"ec": 0.0, "es": 0.0, "Px": 0.0, "Py": 0.0}
    round_shaft = {"M": 1.0, "D": 14.0, "K": 4e4, "dK_cos": 0.0, "dK_sin": 0.0} | known
    rng, covered = np.random.default_rng(1), 0
    for _ in range(200):
        fit = plain_fit(model, line_test(model, round_shaft, ALL[:2], rng), known=known)
        covered += not fit.turning_anisotropy().significant
    # 95 % of 200 with the binomial's standard deviation 3.1: two of them to either side.
    assert 183 <= covered <= 197


@pytest.mark.parametrize("length", [0.0, 1.0, 2.5, 20.0])
def test_intervals_of_a_length_hold_it_at_their_level(length):
    rng = np.random.default_rng(2)
    covar = np.array([[1.0, 0.2], [0.2, 0.8]])
    points = np.array([length * 0.6, length * 0.8]) + rng.multivariate_normal([0, 0], covar, size=400)
    bounds = [magnitude_interval(point, covar, 0.9) for point in points]
    hits = sum(low <= length + 1e-9 and length <= high for low, high in bounds)
    # 360 of 400, standard deviation 6; an uneven covariance costs Rice's distribution a few per cent in between.
    assert 340 <= hits <= 385


def test_a_perturbation_test_without_images_fits_the_shaft_too():
    model = rf.models.AnisotropicShaft(torsion=None)
    theta, rng = model.vector(VALUES), np.random.default_rng(5)
    clean = model.lines(theta, "z", (1, 0), W, SPEED, FORCE)
    noisy = clean + 2e-8 * (rng.normal(size=W.size) + 1j * rng.normal(size=W.size))
    test = rf.perturbation_test(
        run="a", speed=SPEED, frequency=W, force_plane="disk", force=FORCE, plane="disk", direction="z",
        response=noisy, sigma=2e-8,
    )  # fmt: skip
    fit = plain_fit(model, test, known={"ec": 0.0, "es": 0.0, "Px": 0.0, "Py": 0.0})
    assert fit.params["K"].value == pytest.approx(4e4, rel=0.01)  # dK^2/K is what the image takes off at the most
    found = fit.turning_anisotropy()  # the angle leaves no trace at w
    assert not found.significant
    assert str(found) == "not determined by these data"


def test_results_are_saved_and_read_again(tmp_path):
    model = rf.models.AnisotropicShaft()
    fit = plain_fit(model, line_test(model, VALUES | TORSION, ALL, np.random.default_rng(3)), known={"J": 2e-4})
    fit.save(tmp_path / "fit.json")
    again = rf.load_fit(tmp_path / "fit.json")
    assert again.turning_anisotropy() == fit.turning_anisotropy()
    assert "turning anisotropy: dK = " in summary_words(again)


def test_wrong_lines_models_and_planes_are_refused_in_words():
    model = rf.models.AnisotropicShaft()
    test = line_test(model, VALUES | TORSION, ALL, np.random.default_rng(0))
    with refuses(ValueError):
        plain_fit(rf.models.OneMode(), test)
    with refuses(ValueError):
        plain_fit(rf.models.AnisotropicShaft(torsion=None), test)
    with refuses(ValueError):
        plain_fit(rf.models.AnisotropicShaft(planes=("rotor",)), test)


def test_figures_show_lines_and_unstable_bands(tmp_path):
    model = rf.models.AnisotropicShaft()
    test = line_test(model, VALUES | TORSION | {"D": 6.0}, ALL, np.random.default_rng(3))
    fit = plain_fit(model, test, known={"J": 2e-4})
    lines = fit.plot.lines()
    assert len(lines.axes) == 8
    # |kappa(Om)|^2 = dK^2 with D = 6: a quadratic in Om^2.
    (band,) = rf.models.unstable_bands(model, fit.theta(), 400.0)
    half = np.sqrt(2000.0**2 - (6.0 * 200.0) ** 2)
    assert band == pytest.approx(np.sqrt([4e4 - half, 4e4 + half]), rel=2e-3)
    words = " ".join(text.get_text() for text in fit.plot.stability().legends[0].get_texts())
    assert "unstable, 18" in words
    assert "unstable by turning anisotropy: 18" in summary_words(fit)
    assert fit.plot.stability(unit="hz").axes[0].get_xlabel() == "rotative speed, Hz"
    page = rf.write_report(fit, tmp_path / "report.html").read_text()
    assert "Spectral lines" in page
    with refuses(ValueError):
        plain_fit(rf.models.OneMode(), round_test(), known=KNOWN_MODE).plot.lines()


KNOWN_MODE = {"K0": 0.0, "D": 0.0, "lam": 0.0, "Mf": 0.0}


def round_test():
    """A perturbation test of one mode."""
    mode = rf.models.OneMode(planes=("journal",))
    theta = mode.vector({"M": 1.0, "K": 4e4, "Ds": 14.0} | KNOWN_MODE)
    response = FORCE * mode.receptance(theta, W, SPEED)[:, 0, 0]
    return rf.perturbation_test(
        run="a", speed=SPEED, frequency=W, force_plane="journal", force=FORCE, plane="journal", direction="z",
        response=response, sigma=1e-8,
    )  # fmt: skip


@pytest.mark.parametrize("suffix", [".csv", ".nc"])
def test_line_tests_are_written_and_read_again(tmp_path, suffix):
    model = rf.models.AnisotropicShaft()
    test = line_test(model, VALUES | TORSION, ALL, np.random.default_rng(3), steady=("1x",))
    rf.write(test, tmp_path / f"lines{suffix}")
    again = rf.read(tmp_path / f"lines{suffix}")
    for name in ("run", "force_plane", "plane", "direction", "line"):
        assert (getattr(again, name) == getattr(test, name)).all()
    for name in ("speed", "frequency", "force", "response", "sigma"):
        assert getattr(again, name) == pytest.approx(getattr(test, name), rel=1e-12)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("sweep,", ","),
        (",w-Om,", ",w-5Om,"),
        (",twist,", ",tw,"),
        ("frequency_rpm", "frequency_xyz"),
        ("real_um", "real_volts"),
    ],
)
def test_damaged_files_of_lines_are_refused_in_words(tmp_path, old, new):
    model = rf.models.AnisotropicShaft()
    test = line_test(model, VALUES | TORSION, ALL, np.random.default_rng(3))
    rf.write(test, tmp_path / "lines.csv")
    text = (tmp_path / "lines.csv").read_text()
    assert old in text
    (tmp_path / "bad.csv").write_text(text.replace(old, new, 1))
    with refuses(ValueError):
        plain_fit(model, rf.read(tmp_path / "bad.csv"), known={"J": 2e-4})
