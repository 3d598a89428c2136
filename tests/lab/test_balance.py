"""Correction weights: least squares, limits, holes, and intervals that hold the weights exact influences would give."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from kept_weights import MORE, Complex, best_weights, held, random_rig, runs
from scipy.stats import binom
from sentences import refuses

import rotorfit as rf
from rotorfit.base.significance import quantile
from rotorfit.lab.data.probes import subtract_measured_slow_roll
from rotorfit.lab.data.synchronous import join


@pytest.mark.parametrize("draws", [60, pytest.param(500, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("given", "further", "limit"),
    [(True, (), np.inf), (False, MORE, np.inf), (True, (), 6e-6)],
    ids=["noise given", "noise from two runs more", "limits"],
)
def test_intervals_of_correction_weights_cover(
    draws: int, given: bool, further: tuple[Complex, ...], limit: float
) -> None:
    rng = np.random.default_rng(5)
    inside: list[bool] = []
    residuals: list[bool] = []
    for _ in range(draws):
        residual, influence = random_rig(rng)
        found = rf.balance(rf.influence(runs(rng, residual, influence, further, given=given)), limits=limit)
        inside += held(found, best_weights(residual, influence, limit))
        off = (residual + influence @ found.weight - found.expected) / found.stderr
        within = quantile(0.95, found.freedom)
        residuals += [*(np.abs(off.real) <= within), *(np.abs(off.imag) <= within)]
    # the four intervals of a draw share its noise: as many independent ones as draws, the 0.1 % point of the binomial
    assert np.mean(inside) >= binom.ppf(0.001, draws, 0.95) / draws
    assert np.mean(residuals) >= binom.ppf(0.001, draws, 0.95) / draws
    if draws > 100:  # and no wider than they need be
        assert np.mean(inside) <= binom.ppf(0.999, draws, 0.95) / draws


def test_weights_of_the_field_case_are_least_squares() -> None:
    test = rf.read(rf.datasets.path("field_balance.csv"))
    influences = rf.influence(test)
    found = rf.balance(influences, "trial 2")
    before = test.response[test.run == "trial 2"]
    expected = best_weights(before, influences.solved.influence)
    np.testing.assert_allclose(found.weight, expected, rtol=1e-9)
    np.testing.assert_allclose(found.before, before, rtol=1e-9)
    np.testing.assert_allclose(found.expected, before + influences.solved.influence @ expected, rtol=1e-9)
    assert "trial 2 stay in: 11.1 g mm at -35.0 deg in aft, 3.7 g mm at -135.0 deg in fwd" in found.summary()
    assert "no error of the weights is known" in found.summary()
    left = before + influences.solved.influence @ expected
    worst = [f"{1e6 * np.abs(z).max():.3g}" for z in (before, left)]
    said = f"The largest vibration, {worst[0]} um 0-pk"
    assert found.summary().startswith(said)
    assert f"is expected to become {worst[1]} +- ? um 0-pk" in found.verdict  # whose error no run tells
    # from the reference the same weights are those in trial 2 and what comes on top of them
    kept = np.array([11.1 * np.exp(-1j * np.radians(35)), 3.7 * np.exp(-1j * np.radians(135))]) * 1e-6
    np.testing.assert_allclose(rf.balance(influences).weight, kept + expected, rtol=1e-9)


def test_limits_are_kept_and_no_allowed_weight_is_better() -> None:
    rng = np.random.default_rng(8)
    influences = rf.influence(runs(rng, *random_rig(rng), given=True))
    limit = 0.4 * abs(rf.balance(influences).weight[0])
    found = rf.balance(influences, limits={"aft": limit})
    assert found.at_limit == ("aft",)
    (low, high), _ = found.interval("aft")
    np.testing.assert_allclose([abs(found.weight[0]), low, high], limit, rtol=1e-6)
    least = np.sum(np.abs(found.expected) ** 2)
    for _ in range(2000):
        other = found.weight + 1e-7 * (rng.normal(size=2) + 1j * rng.normal(size=2))
        if abs(other[0]) <= limit:
            left = influences.solved.residual + influences.solved.influence @ other
            assert np.sum(np.abs(left) ** 2) >= least * (1 - 1e-9)


def test_holes_beside_the_angle_carry_the_weight() -> None:
    influences = rf.influence(rf.read(rf.datasets.path("field_balance.csv")))
    for holes in (24, 3, [10.0, 95.0, 140.0, 222.0, 318.0], {"aft": 8, "fwd": [0.0, 120.0, 240.0]}):
        found = rf.balance(influences, holes=holes)
        for plane, weight in zip(found.planes, found.weight.tolist(), strict=True):
            pair = found.holes[plane]
            assert sum(mr * np.exp(1j * angle) for angle, mr in pair) == pytest.approx(weight, rel=1e-12)
            assert all(mr >= 0 for _, mr in pair)
    for bad in (2, 0, [0.0, 90.0, 180.0]):
        with refuses(ValueError):
            rf.balance(influences, holes=bad)


def test_planes_that_act_alike_are_named() -> None:
    rng = np.random.default_rng(2)
    residual, influence = random_rig(rng)
    influence[:, 1] = influence[:, 0] * 1.3 * np.exp(0.4j) * (1 + 0.01 * rng.normal(size=8))
    found = rf.balance(rf.influence(runs(rng, residual, influence, given=True)))
    assert any("planes aft and fwd act alike on these readings" in remark for remark in found.remarks)
    one = rf.balance(rf.influence(runs(rng, residual, influence, given=True)), planes=["aft"])
    assert one.planes == ("aft",)
    assert not any("alike" in remark for remark in one.remarks)


def test_readings_of_today_with_influences_of_then() -> None:
    rng = np.random.default_rng(4)
    residual, influence = random_rig(rng)
    influences = rf.influence(runs(rng, residual, influence, given=True))
    now, _ = random_rig(rng)
    today = runs(rng, now, influence, given=True)
    today = today.select((today.run == "run 0") & (today.plane == "aft"))
    found = rf.balance(influences, today)
    assert held(found, best_weights(now[:4], influence[:4])) == [True] * 4
    assert "no reading of them: fwd x at 2865 rpm, fwd x at 3600 rpm, fwd y" in found.summary()
    with refuses(ValueError):
        rf.balance(influences, rf.read(rf.datasets.path("two_disk.csv")))  # type: ignore[arg-type]


def test_a_probe_that_one_trial_run_lacks_keeps_what_is_known_of_it() -> None:
    """Its level and its influence by the weight of the other runs; what the second weight does to it is said."""
    rng = np.random.default_rng(6)
    residual, influence = random_rig(rng)
    whole = runs(rng, residual, influence, given=True)
    last = whole.runs[-1]
    lacking = whole.select(~((whole.run == last) & (whole.plane == "fwd") & (whole.direction == "y")))
    known, all_known = rf.influence(lacking), rf.influence(whole)
    assert "fwd y at 2865 rpm, fwd y at 3600 rpm do not tell the influence of fwd" in known.summary()
    found = rf.balance(known)
    there = np.isfinite(found.expected)
    probes = np.array([" ".join(reading) for reading in found.readings])
    assert set(probes[~there]) == {"fwd y"}
    assert any("NOT CONTROLLED" in remark and "fwd y at 3600 rpm" in remark for remark in found.remarks)
    assert "fwd y" not in found.verdict.partition("is expected")[0]  # of which nothing says what it becomes
    assert found.verdict.endswith("What becomes of fwd y at 2865 rpm, fwd y at 3600 rpm is open.")
    level = {
        tuple(cell): value for cell, value in zip(zip(probes, found.speed, strict=True), found.before, strict=True)
    }
    right = rf.balance(all_known)
    for probe, speed, before in zip(right.readings, right.speed, right.before, strict=True):
        assert level[" ".join(probe), speed] == pytest.approx(before, rel=1e-9)
    # and with the other plane alone it is a reading like all others
    one, same = rf.balance(known, planes=["aft"]), rf.balance(all_known, planes=["aft"])
    assert np.isfinite(one.expected).all()
    np.testing.assert_allclose(one.weight, same.weight, rtol=1e-9)
    # readings of today give its level; what the second weight does to it stays unknown
    today = whole.select(whole.run == whole.runs[0])
    assert np.isnan(rf.balance(known, today).expected).sum() == 2


def recorded_up(
    rng: np.random.Generator, vibration: Callable[[float, complex], complex], *, trial: float, sigma: float, step: float
) -> rf.PerturbationTest:
    """What one probe reads of a rotor that is run up to 3000 rpm without and with a weight, kg m."""
    speed = np.arange(300.0, 3001.0, step) * np.pi / 30
    parts = []
    for name, weight in (("reference", 0.0), ("trial", trial)):
        noise = sigma * (rng.normal(size=speed.size) + 1j * rng.normal(size=speed.size))
        parts.append(
            rf.PerturbationTest(
                run=np.full(speed.size, name),
                speed=speed,
                frequency=speed,
                force_plane=np.full(speed.size, "aft"),
                force=(weight * speed**2).astype(complex),
                plane=np.full(speed.size, "aft"),
                direction=np.full(speed.size, "x"),
                response=np.array([vibration(v, weight) for v in speed.tolist()]) + noise,
                sigma=np.full(speed.size, sigma),
            )
        )
    return rf.join_runs(parts, difference=False)


def start_ups(
    rng: np.random.Generator, sigma: float
) -> tuple[rf.PerturbationTest, Callable[[float, complex], complex]]:
    """A rotor of one mode, run up without and with a weight, and its vibration by speed, rad/s, and weight, kg m."""
    natural, damping, own = 180.0, 0.04, 2.5e-5 * np.exp(1.2j)

    def vibration(speed: float, weight: complex) -> complex:
        return complex((own + weight) / 2.0 * speed**2 / (natural**2 - speed**2 + 2j * damping * natural * speed))

    return recorded_up(rng, vibration, trial=2e-5, sigma=sigma, step=20.0), vibration


def test_a_run_up_with_given_weights_is_that_of_the_rotor_within_its_band() -> None:
    inside, weight = [], 1.7e-5 * np.exp(-1.7j)
    for seed in range(4):
        test, vibration = start_ups(np.random.default_rng(seed), 1e-7)
        found = rf.run_up(test, {"aft": weight})
        assert found.speed.size == 64
        truth = np.array([vibration(v, weight) for v in found.speed.tolist()])
        off = (found.expected - truth) / found.stderr
        inside += [*(np.abs(off.real) < 1.96), *(np.abs(off.imag) < 1.96)]
        before = np.array([vibration(v, 0.0) for v in found.speed.tolist()])
        np.testing.assert_allclose(found.before, before, atol=6e-7)
    # a curve of 64 points has some 4 x 64 independent ones, the 0.1 % point of the binomial; neighbours share readings
    assert np.mean(inside) > 0.90
    figure = found.plot()
    assert [line.get_label() for line in figure.axes[0].lines] == ["as it is", "with the weights"]


def test_run_out_is_read_at_rest_and_its_error_is_in_the_band() -> None:
    """Slow readings hold what unbalance moves there too, 0.4 um of it: their mean would take that out as well."""
    slow, inside = 410 * np.pi / 30, []
    for seed, sigma in enumerate((1e-12, 1e-7, 1e-7, 1e-7, 1e-7)):
        raw, vibration = start_ups(np.random.default_rng(seed), sigma)
        test = subtract_measured_slow_roll(raw.subtract_slow_roll({("aft", "x"): -4e-6 - 2e-6j}), slow)
        found = rf.run_up(test, {"aft": 1e-5 + 0j})
        truth = np.array([vibration(v, 1e-5) for v in found.speed.tolist()])
        if sigma < 1e-9:
            np.testing.assert_allclose(found.expected, truth, atol=1e-7)
        else:
            off = (found.expected - truth) / found.stderr
            inside += [*(np.abs(off.real) < 1.96), *(np.abs(off.imag) < 1.96)]
    assert np.mean(inside) > 0.9  # as for run-ups without run-out


def test_a_slow_roll_read_once_is_taken_out_and_left_out() -> None:
    """It is no reading of zero beside others, and no speed at which weights would have to do something."""
    rng = np.random.default_rng(8)
    residual, influence = random_rig(rng)
    whole = runs(rng, residual, influence, given=True)
    fast = whole.select(whole.speed == whole.speed.max())
    run_out = 5e-6 * np.exp(1j * (np.arange(len(fast)) % 4))
    slow = replace(fast, speed=fast.speed / 10, frequency=fast.frequency / 10, response=run_out)
    both = join([replace(fast, response=fast.response + run_out), slow])
    cleared = subtract_measured_slow_roll(both, float(fast.speed.max()) / 2)
    assert len(cleared) == len(fast)
    assert cleared.response == pytest.approx(fast.response)
    assert rf.influence(cleared).modes_told == rf.influence(fast).modes_told


def test_weights_of_whole_pieces_leave_the_least_of_all_that_can_be_mounted() -> None:
    rng = np.random.default_rng(3)
    influences = rf.influence(runs(rng, *random_rig(rng), given=True))
    ideal = rf.balance(influences, holes=12)
    piece = 0.3 * min(abs(ideal.weight))
    found = rf.balance(influences, holes=12, smallest=piece)
    put = {plane: sum(mr * np.exp(1j * at) for at, mr in pair) for plane, pair in found.holes.items()}
    for pair in found.holes.values():
        for _, mr in pair:
            assert mr / piece == pytest.approx(round(mr / piece), abs=1e-9)
    same = rf.balance(influences, weights=put)
    np.testing.assert_allclose(same.expected, found.expected, rtol=1e-9)
    least = np.sum(np.abs(found.expected) ** 2)
    assert least > np.sum(np.abs(ideal.expected) ** 2)
    for plane, pair in ideal.holes.items():  # rounded down, as a fitter would
        down = sum(np.floor(mr / piece) * piece * np.exp(1j * at) for at, mr in pair)
        assert np.sum(np.abs(rf.balance(influences, weights={**put, plane: down}).expected) ** 2) >= least * (1 - 1e-9)
    with refuses(ValueError):
        rf.balance(influences, weights=put, holes=12)
    with refuses(ValueError):
        rf.balance(influences, holes=12, smallest=-1e-6)
    with refuses(ValueError):
        rf.balance(influences, weights={"middle": 1e-5})


def test_run_out_of_start_ups_is_said_to_stay_in_or_to_be_out() -> None:
    """Truth: one probe, an influence that grows as the square of the speed, and 5 um of run-out."""

    def vibration(speed: float, weight: complex) -> complex:
        return complex(5e-6 + (3e-5 + weight * 2.0) * (speed / (100 * np.pi)) ** 2 * np.exp(0.5j))

    raw = recorded_up(np.random.default_rng(2), vibration, trial=1e-5, sigma=2e-8, step=50.0)
    at = [2500.0 * np.pi / 30]
    found = rf.balance(rf.influence(raw, at))
    assert any("stays in: at 300 to 450 rpm aft x reads 5" in remark for remark in found.remarks)
    out = rf.balance(rf.influence(raw.subtract_slow_roll({("aft", "x"): 5e-6 + 0j}), at))
    assert not any("stays in" in remark for remark in out.remarks)
    assert out.weight[0] == pytest.approx(-1.5e-5, rel=0.01)
    assert abs(found.weight[0] + 1.5e-5) > 1e-6
    fast = raw.select(raw.speed > 1000 * np.pi / 30)
    assert any("no reading is as slow as 625 rpm" in remark for remark in rf.influence(fast, at).remarks)
