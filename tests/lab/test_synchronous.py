import itertools
from dataclasses import replace

import numpy as np
import pytest
from plain import plain_fit
from sentences import refuses, warns

import rotorfit as rf
from rotorfit import datasets  # noqa: F401 - the package has to be importable
from rotorfit.estimators.blocks.set_speeds import set_speeds
from rotorfit.lab.data.from_arrays import perturbation_test
from rotorfit.lab.data.synchronous import DIFFERENCED, difference_synchronous
from rotorfit.lab.io.files import read, write
from rotorfit.models import TwoDisk

VALUES = {
    "M1": 0.73, "M2": 0.79, "K1": 18900.0, "K2": 63700.0, "K3": 22600.0,
    "D11": 14.2, "D12": 7.0, "D21": 7.0, "D22": 14.8, "beta1": 1.0, "beta2": 1.0,
}  # fmt: skip
MODEL = TwoDisk()
THETA = MODEL.vector(VALUES)
MR = 1.5e-5  # kg m


def start_up(name, angle, speed, *, plane="inboard", mr=MR, residual=True, sigma=np.nan):
    """Exact x readings of a start-up with a weight, residual unbalance, bow and run-out."""
    force = mr * speed**2 * np.exp(1j * np.radians(angle))
    vector = MODEL.force_vector(plane, speed, force)
    if residual:
        vector = vector + MODEL.force_vector("outboard", speed, 8e-6 * speed**2 * np.exp(0.7j))
    response = np.einsum("lij,lj->li", MODEL.receptance(THETA, speed, speed), vector)
    if residual:
        response = response + 4e-6 * np.exp(2j)
    return [
        {
            "run": name, "speed": speed, "frequency": speed, "force_plane": plane, "force": force, "plane": at,
            "direction": "x", "response": response[:, i], "sigma": sigma, "attributes": {"oil": 40 + angle / 18},
        }
        for i, at in enumerate(MODEL.planes)
    ]  # fmt: skip


def join(*starts):
    parts = [perturbation_test(**start) for start in itertools.chain.from_iterable(starts)]
    columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in parts[0]._columns()}
    attributes = {"oil": np.concatenate([part.attributes["oil"] for part in parts])}
    return perturbation_test(**columns, attributes=attributes, source="start-ups")


def exact(test):
    """What the weights alone would give."""
    h = MODEL.receptance(THETA, test.speed, test.speed)
    row = [MODEL.planes.index(plane) for plane in test.plane]
    column = [MODEL.planes.index(plane) for plane in test.force_plane]
    return h[np.arange(len(test)), row, column] * test.force


SPEED = np.linspace(30.0, 600.0, 241)


def test_the_full_difference_belongs_to_twice_the_force():
    test = difference_synchronous(join(start_up("a", 30, SPEED), start_up("b", 210, SPEED)))
    assert test.runs == ("a minus b",)
    np.testing.assert_allclose(test.force, 2 * MR * test.speed**2 * np.exp(1j * np.pi / 6), rtol=1e-12)
    # what cancels is up to a hundred times what is left
    np.testing.assert_allclose(test.response, exact(test), rtol=1e-11)
    assert (test.attribute(DIFFERENCED) == 1).all()
    np.testing.assert_allclose(test.attribute("oil"), 40 + (30 + 210) / 2 / 18)


def test_unequal_weights_and_angles_are_differenced_exactly():
    test = difference_synchronous(join(start_up("a", 30, SPEED), start_up("b", 212, SPEED, mr=0.7 * MR)))
    np.testing.assert_allclose(test.response, exact(test), rtol=1e-11)


def test_noise_adds_in_squares():
    test = difference_synchronous(join(start_up("a", 0, SPEED, sigma=3e-7), start_up("b", 180, SPEED, sigma=4e-7)))
    np.testing.assert_allclose(test.sigma, 5e-7)


def interpolation_error(lines):
    """Largest error of a difference of start-ups that are sampled at other speeds, over the largest response."""
    rng = np.random.default_rng(3)
    step = 570 / (lines - 1)
    one, two = (30 + step * (np.arange(lines) + rng.uniform(-0.3, 0.3, lines)) for _ in range(2))
    test = difference_synchronous(join(start_up("a", 0, one), start_up("b", 180, two)))
    np.testing.assert_array_equal(np.unique(test.speed), one[(one >= two.min()) & (one <= two.max())])
    return (np.abs(test.response - exact(test)) / np.abs(exact(test)).max()).max()


def test_start_ups_sampled_at_other_speeds_are_interpolated():
    # A response to unbalance, bow and run-out is a ratio of polynomials of degree four, round-off apart, however few
    # the lines: 61 are 9.5 rad/s apart, twice the half width of the first resonance, where a spline errs by a third.
    for lines in (61, 121, 481):
        assert interpolation_error(lines) < 1e-9


def noisy(parts, seed):
    """Start-ups with noise of the size of their sigma."""
    test, rng = join(*parts), np.random.default_rng(seed)
    noise = rng.normal(size=len(test)) + 1j * rng.normal(size=len(test))
    return replace(test, response=test.response + test.sigma * noise)


def coarse(seed):
    """Sixty speeds over both resonances, other ones for every seed."""
    rng = np.random.default_rng(seed)
    return 60 + 9 * (np.arange(60) + rng.uniform(-0.3, 0.3) + rng.uniform(-0.2, 0.2, 60))


@pytest.mark.parametrize("reference", [False, True])
def test_coarse_start_ups_at_other_speeds_give_errors_that_hold(reference):
    """0 and 180 degrees, or one angle beside a run without a weight: what is left is noise, and so are the pulls."""
    names, pulls, misses = ("K1", "K2", "K3", "M1", "M2", "D11", "D22"), [], []
    for draw in range(6):
        parts = [
            start_up(f"{plane} {angle}", angle, coarse(10 * draw + k), plane=plane, sigma=3e-7)
            for k, (plane, angle) in enumerate(itertools.product(MODEL.planes, (0,) if reference else (0, 180)))
        ]
        bare = [start_up("bare", 0, coarse(10 * draw + 9), mr=0.0, sigma=3e-7)] if reference else []
        test = difference_synchronous(noisy([*parts, *bare], draw))
        assert (test.attribute(DIFFERENCED) == 1).all()
        misses.append(np.mean(np.abs((test.response - exact(test)) / test.sigma) ** 2) / 2)
        if draw < 2:
            fit = plain_fit(MODEL, test, known={"beta1": 1.0, "beta2": 1.0})
            pulls += [(fit.params[name].value - VALUES[name]) / fit.params[name].stderr for name in names]
    # 1,400 real readings each, of which neighbours share noise: a spline of noise has 0.7 to 1 of its variance.
    assert 0.8 < np.mean(misses) < 1.1
    assert np.abs(pulls).max() < 4


def test_equal_speeds_are_not_interpolated():
    rng = np.random.default_rng(4)
    raw = join(start_up("a", 0, SPEED), start_up("b", 180, SPEED))
    noisy = replace(raw, response=raw.response + 1e-6 * rng.normal(size=len(raw)))
    test = difference_synchronous(noisy)
    n = len(SPEED)
    np.testing.assert_array_equal(test.response[:n], noisy.response[:n] - noisy.response[2 * n : 3 * n])


def test_no_extrapolation_and_nothing_across_a_gap():
    covered = SPEED[(SPEED > 100) & ((SPEED < 200) | (SPEED > 300)) & (SPEED < 500)] + 0.7
    test = difference_synchronous(join(start_up("a", 0, SPEED), start_up("b", 180, covered)))
    done = test.select(test.attribute(DIFFERENCED) == 1)
    assert done.speed.min() > 100
    assert done.speed.max() < 501
    assert not ((done.speed > 201) & (done.speed < 300)).any()


def test_runs_without_partner_stay_as_they_are_and_twice_is_once(tmp_path):
    raw = join(start_up("a", 0, SPEED), start_up("b", 180, SPEED), start_up("c", 180, SPEED), start_up("d", 90, SPEED))
    test = difference_synchronous(raw)
    assert test.runs == ("a minus b", "c", "d")
    np.testing.assert_array_equal(test.response[test.run == "c"], raw.response[raw.run == "c"])
    write(test, tmp_path / "t.csv")
    again = read(tmp_path / "t.csv")
    assert again.runs == test.runs
    np.testing.assert_allclose(again.force, test.force, rtol=1e-13)


def test_other_planes_are_no_partners():
    raw = join(start_up("a", 0, SPEED), start_up("b", 180, SPEED, plane="outboard"))
    assert difference_synchronous(raw) is raw


def test_a_channel_of_one_run_only_is_kept_raw():
    raw = join(start_up("a", 0, SPEED), start_up("b", 180, SPEED)[:1])
    test = difference_synchronous(raw)
    assert test.runs == ("a minus b", "a")
    assert set(test.plane[test.run == "a"]) == {"outboard"}


def test_attributes_of_text_are_joined():
    raw = join(start_up("a", 0, SPEED), start_up("b", 180, SPEED + 0.1))
    oil = np.where(raw.run == "a", "VG 32", "VG 46")
    test = difference_synchronous(replace(raw, attributes={"oil": oil, "site": np.full(len(raw), "lab")}))
    assert set(test.attribute("oil")) == {"VG 32 | VG 46"}
    assert set(test.attribute("site")) == {"lab"}


def test_a_test_at_constant_speed_is_refused():
    raw = join(start_up("a", 0, SPEED))
    with refuses(ValueError):
        difference_synchronous(replace(raw, frequency=raw.frequency * 1.1))


def test_reading_differences_unless_told_otherwise(tmp_path):
    path = tmp_path / "t.csv"
    write(join(start_up("a", 0, SPEED), start_up("b", 180, SPEED)), path)
    assert read(path).runs == ("a minus b",)
    assert read(path, difference=False).runs == ("a", "b")


def test_speed_groups_do_not_touch_synchronous_runs_and_settle_at_once():
    speed = np.array([100.0, 100.2, 100.4, 100.0, 100.1, 300.0])
    frequency = np.array([10.0, 20.0, 30.0, 100.0, 100.1, 30.0])
    run = np.array([0, 0, 0, 1, 1, 2])
    grouped = set_speeds(speed, frequency, run)
    np.testing.assert_allclose(grouped, [100.2, 100.2, 100.2, 100.0, 100.1, 300.0])
    np.testing.assert_array_equal(set_speeds(grouped, frequency, run), grouped)


def test_start_ups_are_compared_with_a_reference_run_without_a_weight() -> None:
    """Residual unbalance drops out; the reference is sampled at other speeds than the run with the weight."""
    model = rf.models.TwoDisk()
    truth = rf.datasets.truth("two_disk")
    (d11, d12), (d21, d22) = truth["D"]
    theta = model.vector(
        {name: truth[name] for name in ("M1", "M2", "K1", "K2", "K3")}
        | {"D11": d11, "D12": -d12, "D21": -d21, "D22": d22}
    )
    parts = []
    for run, speed, mr in (("trial", np.linspace(60, 200, 90), 2e-5), ("bare", np.linspace(55, 205, 101), 0.0)):
        H = model.receptance(theta, speed, 0.0)[:, 0, 0]
        response = H * speed**2 * (mr * np.exp(0.4j) + 6e-5j) + 3e-6
        parts.append((run, speed, mr * np.exp(0.4j) * speed**2, response))
    test = rf.perturbation_test(
        run=np.concatenate([[run] * s.size for run, s, _, _ in parts]),
        speed=np.concatenate([s for _, s, _, _ in parts]),
        frequency=np.concatenate([s for _, s, _, _ in parts]),
        force_plane="inboard",
        force=np.concatenate([f for _, _, f, _ in parts]),
        plane="inboard",
        direction="z",
        response=np.concatenate([r for _, _, _, r in parts]),
    )
    net = rf.difference_synchronous(test)
    assert net.runs == ("trial minus bare",)
    assert not (net.force == 0).any()
    expected = model.receptance(theta, net.speed, 0.0)[:, 0, 0] * net.force
    # a cubic spline through steps of 1.5 rad/s across a resonance 10 rad/s wide: some 1e-4 of the reference's peak
    np.testing.assert_allclose(net.response, expected, atol=1e-3 * np.abs(test.response).max())


def test_each_plane_is_compared_with_a_reference_run_of_its_own():
    speed = np.linspace(60.0, 200.0, 90)
    starts = [
        start_up(f"{plane} {'trial' if mr else 'bare'}", 20, speed, plane=plane, mr=mr)
        for plane in MODEL.planes
        for mr in (0.0, MR)
    ]
    net = difference_synchronous(join(*starts))
    assert net.runs == tuple(f"{plane} trial minus {plane} bare" for plane in MODEL.planes)
    np.testing.assert_allclose(net.response, exact(net), atol=1e-12)


def test_opposite_weights_of_different_size_are_warned_of(tmp_path):
    path = tmp_path / "ups.csv"
    write(join(start_up("a", 30, SPEED), start_up("b", 210, SPEED, mr=10 * MR)), path)
    with warns(UserWarning):
        told = read(path).findings
    assert [finding.code for finding in told] == ["uneven-weights"]
    write(join(start_up("a", 30, SPEED), start_up("b", 210, SPEED, mr=1.02 * MR)), path)
    assert not read(path).findings
