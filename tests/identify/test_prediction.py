"""Predictions elsewhere: bands that hold the truth and new readings at their level, and what they cannot know."""

from __future__ import annotations

from functools import cache

import law_data
import numpy as np
import pytest
from scipy import stats
from sentences import refuses
from slow_cases import slow_but
from synthetic import TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.base.array_types import Float
from rotorfit.identify.fitting.quantities import Share

NAME, TESTED, ELSEWHERE = "whirl-whip", (100.0, 180.0), 220.0
DRAWS, LEVEL = 60, 0.9
CHANGE = "speed[lam]"
FREQUENCY = np.linspace(30.0, 400.0, 40)
WHERE = {"force_plane": "disk", "plane": "journal"}
MODEL = rf.models.WhirlWhip()
THETA = MODEL.vector(TYPICAL[NAME])


def truth() -> Float:
    """The response at an untested speed by the model's own matrices, without any of the fit's code."""
    kappa = MODEL.dynamic_stiffness(THETA, FREQUENCY, ELSEWHERE)
    disk, journal = (MODEL.coordinate(plane, "z") for plane in ("disk", "journal"))
    return np.linalg.inv(kappa)[:, journal, disk]


@cache
def drawn(whole: bool) -> list[tuple[rf.FitResult, object]]:
    """Fits of simulated tests at two speeds, and what each predicts at a third for the plane that is not forced."""
    w = covering_frequencies(MODEL, THETA, TESTED, 25)
    found = []
    for seed in range(DRAWS):
        test = circular_test(MODEL, THETA, speeds=TESTED, frequency=w, noise=0.02, seed=seed, sigma_known=True)
        fit = rf.fit(MODEL, test, known=known_of(NAME, TYPICAL[NAME]), causes=None)
        found.append(
            (
                fit,
                fit.predict(FREQUENCY, ELSEWHERE, **WHERE, level=LEVEL, whole=whole),
            )
        )
    return found


def held(band: object, values: Float) -> Float:
    """Whether amplitudes lie in a band of amplitudes and phases in one of phases, shape ``(2, N)``."""
    size = np.abs(values)
    inside = (band.amplitude[:, 0] <= size) & (size <= band.amplitude[:, 1])
    middle = band.phase.mean(axis=1)
    turn = np.angle(values * np.exp(-1j * middle))
    return np.stack([inside, np.abs(turn) <= np.diff(band.phase, axis=1)[:, 0] / 2])


def within(count: int, draws: int) -> bool:
    """Whether a count is no surprise, one in ten thousand, at the level."""
    low, high = stats.binom.ppf([0.5e-4, 1 - 0.5e-4], draws, LEVEL)
    return bool(low <= count <= high)


def test_bands_hold_the_truth_at_an_untested_speed() -> None:
    exact = truth()
    each = np.array([held(p.band, exact) for _, p in drawn(False)])  # (draws, 2, N)
    for point in (0, 13, 26, 39):  # points of one draw err together: few of them are looked at, each by itself
        assert within(int(each[:, 0, point].sum()), DRAWS), point
        assert within(int(each[:, 1, point].sum()), DRAWS), point
    assert within(sum(held(p.band, exact).all() for _, p in drawn(True)), DRAWS)


def truth_with(assumed: str, size: float, speed: float) -> Float:
    """Parameters at a speed where a known value is another, or lam changes by a share at twice the mean speed."""
    values = TYPICAL[NAME]
    if assumed == "Mf":
        return MODEL.vector(values | {"Mf": values["Mf"] + size})
    mean = float(np.mean(TESTED))
    return MODEL.vector(values | {"lam": values["lam"] * (1 + size * (speed - mean) / mean)})


@pytest.mark.parametrize(("assumed", "size"), slow_but([("Mf", 0.1), (CHANGE, 0.03)], (CHANGE, 0.03)))
def test_bands_hold_what_the_model_takes_as_known(assumed: str, size: float) -> None:
    """A known value that is wrong at random, a lam that changes with speed: the truth by the model's own matrices."""
    rng, w = np.random.default_rng(4), covering_frequencies(MODEL, THETA, TESTED, 10)
    known = known_of(NAME, TYPICAL[NAME]) | ({"Mf": TYPICAL[NAME]["Mf"]} if assumed == "Mf" else {})
    journal, disk = (MODEL.coordinate(plane, "z") for plane in ("journal", "disk"))
    others: dict[str, float] = {}
    counts: dict[Share, Float] = {"all": np.zeros(FREQUENCY.size), "noise": np.zeros(FREQUENCY.size)}
    for seed in range(DRAWS):
        truly = size * rng.normal()
        parts = [
            circular_test(
                MODEL, truth_with(assumed, truly, speed), speeds=(speed,), frequency=w, noise=0.02,
                seed=1000 * k + seed, sigma_known=True,
            )
            for k, speed in enumerate(TESTED)
        ]  # fmt: skip
        given = {assumed: size * (TYPICAL[NAME]["Mf"] if assumed == "Mf" else 1.0)}
        others = others or {cause.name: 0.0 for cause in rf.fit(MODEL, parts, known=known).causes}
        fit = rf.fit(MODEL, parts, known=known, causes=others | given)
        theta = truth_with(assumed, truly, ELSEWHERE)
        exact = np.linalg.inv(MODEL.dynamic_stiffness(theta, FREQUENCY, ELSEWHERE))[:, journal, disk]
        for share in counts:
            found = fit.predict(FREQUENCY, ELSEWHERE, **WHERE, level=LEVEL, share=share)
            counts[share] += held(found.band, exact)[0]
    assert all(within(int(counts["all"][point]), DRAWS) for point in (0, 13, 26, 39))
    assert counts["noise"].min() < 0.8 * DRAWS


def test_bands_hold_new_readings() -> None:
    exact, rng = truth(), np.random.default_rng(99)
    counts, whole = 0, 0
    for (fit, each), (_, all_) in zip(drawn(False), drawn(True), strict=True):
        base = fit.problem.blocks[0]
        sigma = float(np.median(base.sigma[base.coordinate == MODEL.coordinate("journal", "z")]))
        reading = exact + sigma * (rng.normal(size=exact.size) + 1j * rng.normal(size=exact.size))
        counts += int(held(each.band_new, reading)[0].sum())
        whole += bool(held(all_.band_new, reading).all())
    # Noise of the readings, which are independent, makes most of their band.
    assert within(counts, DRAWS * exact.size)
    assert within(whole, DRAWS)


def test_one_reading_is_the_fitted_response_and_its_spread_that_of_fits() -> None:
    exact = truth()
    pulls = np.array([(p.response - exact) / p.stderr.real for _, p in drawn(False)]).real
    low, high = stats.chi2.ppf([0.5e-4, 1 - 0.5e-4], DRAWS)
    for point in (0, 13, 26, 39):
        assert low < np.sum(pulls[:, point] ** 2) < high


def test_the_curve_is_drawn_inside_its_bands() -> None:
    """At low frequency an unbalance moves less than the noise: the band of a new reading holds zero."""
    fit, _ = drawn(False)[0]
    prediction = fit.predict(np.linspace(5.0, 300.0, 60), 150.0, **WHERE, mr=1e-5)
    assert prediction.band_new.amplitude[0, 0] == 0
    amplitude = prediction.plot().axes[0]
    (curve,) = (line.get_ydata() for line in amplitude.get_lines())
    for band in amplitude.collections:
        edge = band.get_paths()[0].vertices[:, 1]
        assert edge.min() <= curve.min()
    assert amplitude.get_ylim()[0] < curve.min()


def test_once_per_turn_is_the_response_to_the_force_of_an_unbalance() -> None:
    fit, _ = drawn(False)[0]
    speeds = np.linspace(80.0, 200.0, 7)
    start_up = fit.predict(None, speeds, force_plane="disk", mr=2e-5, plane="journal")
    for i, speed in enumerate(speeds.tolist()):
        one = fit.predict(speed, speed, force_plane="disk", force=2e-5 * speed**2, plane="journal")
        assert start_up.response[i] == pytest.approx(one.response[0], rel=1e-12)
        np.testing.assert_allclose(start_up.band.amplitude[i], one.band.amplitude[0], rtol=1e-9)


def test_what_a_prediction_cannot_know_is_said() -> None:
    fit, inside = drawn(False)[0]
    assert any("speeds" in note and "outside the tested" in note for note in inside.notes)
    assert fit.predict(200.0, 120.0, force_plane="disk").notes == ()
    (both,) = fit.predict(200.0, [80.0, 120.0, 200.0], force_plane="disk").notes
    assert both.startswith(
        "Extrapolated: 2 of 3 speeds, 763.94 and 1909.9 rpm, lie outside the tested 954.93 to 1718.9"
    )
    with refuses(ValueError):
        fit.predict(200.0, 2000.0, force_plane="disk")
    with refuses(ValueError):
        fit.predict(200.0, 120.0)
    with refuses(ValueError):
        fit.predict(200.0, 120.0, force_plane="dsik")
    with refuses(ValueError):
        fit.predict(200.0, 120.0, force_plane="disk", force=1.0, mr=1e-5)
    with refuses(ValueError):
        fit.predict([200.0, 210.0], [120.0, 121.0, 122.0], force_plane="disk")
    journal = rf.datasets.rig_open()
    unread = rf.fit(MODEL, journal.select(journal.plane == "journal"), known={"K3": 6e3, "Md": 1.0, "Ds": 10.0})
    blind = unread.predict(200.0, 120.0, force_plane="disk")
    assert np.isnan(blind.noise).all()
    assert any("No readings at disk" in note for note in blind.notes)


def test_a_place_without_a_probe_moves_by_the_shares_of_the_planes() -> None:
    model = rf.models.WhirlWhip(probes={"quarter": {"disk": 0.6, "journal": 0.4}})
    fit = rf.fit(model, rf.datasets.rig_lumped(), known={"K3": 6000.0})
    w = np.array([120.0, 190.0])
    disk, journal, between = (
        fit.predict(w, 150.0, force_plane="disk", plane=plane) for plane in ("disk", "journal", "quarter")
    )
    np.testing.assert_allclose(between.response, 0.6 * disk.response + 0.4 * journal.response, rtol=1e-9)
    assert any("No readings at quarter" in note for note in between.notes)
    judged = fit.stability_report(unbalance_g_mm={"disk": 30.0}, plane="quarter")
    assert any("at quarter" in criterion.name for criterion in judged.criteria)
    with refuses(ValueError):
        fit.predict(w, 150.0, force_plane="quarter")


def test_a_fluid_that_changes_with_eccentricity_and_a_rotor_tested_at_rest() -> None:
    """Orbits by the roots of another program; at rest nothing shows gyroscopic effects, small all the same."""
    law = rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=law_data.CLEARANCE_UM)
    data = [law_data.sweep(law_data.ONE_MODE, levels=(3.0, 30.0), lines=20), law_data.static(law_data.ONE_MODE)]
    fit = rf.fit(law, data, known={"Ds": 8.0})
    found = fit.predict([60.0, 120.0], 120.0, force=20.0)
    for w, response in zip((60.0, 120.0), found.response, strict=True):
        ((_, orbit),) = law_data.orbits(law_data.ONE_MODE, w, 120.0, np.array([20.0 + 0j]))
        assert abs(response - orbit[0]) < 0.05 * abs(orbit[0])
    disks = rf.models.TwoDisk()
    theta = disks.vector(TYPICAL["two-disk"])
    w = covering_frequencies(disks, theta, (0.0,), 20)
    test = circular_test(disks, theta, speeds=(0.0,), frequency=w, noise=0.02, seed=3)
    turning = rf.fit(disks, test, known=known_of("two-disk", TYPICAL["two-disk"])).predict(
        120.0, 120.0, force_plane=disks.planes[0]
    )
    assert turning.band.amplitude[0, 1] < 1.3 * abs(turning.response[0])


def test_derived_quantities_have_the_error_of_their_parameters_together() -> None:
    fit, _ = drawn(False)[0]
    ratio = fit.derive(lambda p: p.K0 / p.D, unit="1/s")
    i, j = (fit.var_names.index(name) for name in ("K0", "D"))
    gradient = np.zeros(len(fit.var_names))
    K0, D = (fit.params[name].value for name in ("K0", "D"))
    gradient[[i, j]] = 1 / D, -K0 / D**2
    assert ratio.value == pytest.approx(K0 / D, rel=1e-14)
    assert ratio.stderr == pytest.approx(np.sqrt(gradient @ fit.covar @ gradient), rel=1e-12)
    same = fit.derive(lambda p: p.lam)
    assert (same.value, same.stderr) == pytest.approx((fit.params["lam"].value, fit.params["lam"].stderr), rel=1e-12)
    assert fit.threshold_speed().to("rpm").value == pytest.approx(fit.threshold_speed().value * 30 / np.pi)
    with refuses(AttributeError):
        fit.derive(lambda p: p.K9)
    with refuses(ValueError):
        fit.derive(lambda p: "K0")
    with refuses(ValueError):
        fit.threshold_speed().to("furlong")
