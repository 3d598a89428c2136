"""Correction weights: least squares, limits, holes, and intervals that hold the weights exact influences would give."""

from __future__ import annotations

import numpy as np
import pytest
from kept_weights import MORE, Complex, best_weights, held, random_rig, runs
from scipy.stats import binom
from sentences import refuses

import rotorfit as rf
from rotorfit.base.significance import quantile


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
