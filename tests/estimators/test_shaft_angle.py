"""Edges of a phase reference, their count, and the smooth angle: against pulses made from a known angle."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import brentq
from sentences import refuses

from rotorfit.base.array_types import Float
from rotorfit.estimators.signals.pulse_numbers import from_index, number_pulses, uneven_turns
from rotorfit.estimators.signals.pulses import find_edges, find_levels
from rotorfit.estimators.signals.shaft_angle import smooth_angle

RATE = 6400.0


def turning(t: Float) -> Float:
    """Angle of a shaft that accelerates from 20 rad/s and wanders: rad."""
    return 20.0 * t + 8.0 * t**2 + 0.3 * np.sin(2.0 * t)


def speed(t: Float) -> Float:
    return 20.0 + 16.0 * t + 0.6 * np.cos(2.0 * t)


def voltage(angle: Float, *, per_turn: int = 1, notch: bool = True) -> Float:
    """-2 V outside and -8 V in a notch of a twelfth of a pitch, angle zero where it begins; rising for a projection."""
    inside = np.mod(angle * per_turn, 2 * np.pi) < 2 * np.pi / 12
    return np.where(inside, -8.0, -2.0) if notch else np.where(inside, -2.0, -8.0)


def pulse_times(end: float, per_turn: int = 1) -> Float:
    count = int(turning(np.array([end]))[0] / (2 * np.pi) * per_turn)
    angles = 2 * np.pi / per_turn * np.arange(1, count + 1)
    return np.array([brentq(lambda t, a=a: float(turning(np.array([t]))[0]) - a, 0, end, xtol=1e-13) for a in angles])


@pytest.mark.parametrize("notch", [True, False])
def test_level_polarity_and_edges_are_found(notch: bool) -> None:
    t = np.arange(0, 10, 1 / RATE)
    rng = np.random.default_rng(1)
    signal = voltage(turning(t), notch=notch) + 0.1 * rng.normal(size=t.size)
    levels = find_levels(signal)
    assert levels.falling is notch
    assert levels.low == pytest.approx(-8.0, abs=0.02)
    assert levels.high == pytest.approx(-2.0, abs=0.02)
    assert levels.duty == pytest.approx(1 / 12, rel=0.05)
    edges = find_edges([signal], levels)
    # an edge falls between two samples and is put where the straight line between them passes the level
    expected = pulse_times(10.0)
    np.testing.assert_allclose(edges / RATE, expected, atol=0.6 / RATE)
    pieces = find_edges(np.array_split(signal, 997), levels)
    np.testing.assert_allclose(pieces, edges, atol=1e-9)


def test_noise_at_the_edge_counts_once() -> None:
    """A slow edge that noise crosses several times is one edge, placed in the middle of its crossings."""
    t = np.arange(0, 4, 1e-3)
    rng = np.random.default_rng(2)
    ramp = np.clip(np.abs((t % 1.0) - 0.5) * 40 - 8, -3, 3)  # 150 samples from one voltage to the other
    edges = find_edges([ramp + 0.2 * rng.normal(size=t.size)], find_levels(ramp, edge="falling"))
    np.testing.assert_allclose(edges * 1e-3, 0.3 + np.arange(4), atol=0.01)


def test_missing_and_double_pulses_are_told_apart_and_the_count_holds() -> None:
    times = pulse_times(20.0)
    gone = np.array([3, 40, 41, 42, 200])
    double = times[[10, 60, 61, 150]] + 0.004
    seen = np.sort(np.concatenate([np.delete(times, gone), double]))
    pulses = number_pulses(seen)
    np.testing.assert_array_equal(pulses.extra, double)
    np.testing.assert_allclose(pulses.missing, times[[2, 39, 199]])
    np.testing.assert_array_equal(pulses.missing_count, [1, 3, 1])
    np.testing.assert_array_equal(pulses.numbers, np.delete(np.arange(times.size), gone))


@pytest.mark.parametrize("place", [0.1, 0.3, 0.45, 0.5, 0.55, 0.75])
def test_a_double_pulse_anywhere_in_a_turn_is_the_one_left_out(place: float) -> None:
    """At half a turn both intervals are short; near the ends, and beside a missing pulse, too."""
    marks = np.arange(60.0) * 0.04
    doubles = marks[[0, 9, 30, 57]] + place * 0.04
    found = number_pulses(np.sort(np.concatenate([np.delete(marks, 32), doubles])))
    np.testing.assert_array_equal(found.extra, doubles)
    assert found.numbers[-1] == 59
    np.testing.assert_array_equal(found.missing, marks[[31]])


@pytest.mark.parametrize("first", [1.0, 0.5, 0.2, 0.05])
@pytest.mark.parametrize("direction", [1, -1])
def test_start_from_rest_is_counted(first: float, direction: int) -> None:
    """Turns of a constant acceleration from rest shorten fast, the first by 1.3 to 2.2 times; none is missing."""
    times = np.sqrt(np.arange(first, 60.0))
    pulses = number_pulses(times if direction > 0 else (times[-1] - times)[::-1])
    assert pulses.missing.size == pulses.extra.size == 0
    seen = np.sort(np.append(np.delete(times, [6, 20, 21]), times[[10, 30]] + 0.01))
    mended = number_pulses(seen if direction > 0 else (times[-1] - seen)[::-1])
    numbers = np.delete(np.arange(times.size), [6, 20, 21])
    np.testing.assert_array_equal(mended.numbers, numbers if direction > 0 else (numbers[-1] - numbers)[::-1])


@pytest.mark.parametrize("sweeps", [False, True])
@pytest.mark.parametrize(("missing", "double"), [(0.1, 0.0), (0.2, 0.0), (0.0, 0.3), (0.1, 0.05)])
def test_a_badly_set_trigger_costs_pulses_and_no_turn(missing: float, double: float, sweeps: bool) -> None:
    """One pulse in ten or five missing at random, doubles anywhere in the turn, 0.1 % of jitter: all are counted."""
    rng = np.random.default_rng(3)
    turns = np.arange(800.0)
    times = (np.sqrt(1 + 5.5 * turns) - 1) / 2.75 if sweeps else 0.04 * turns
    length = np.gradient(times)
    times = times + 1e-3 * length * rng.normal(size=turns.size)
    inner = (turns > 12) & (turns < 788)
    kept = ~inner | (rng.random(turns.size) >= missing)
    doubled = inner & (rng.random(turns.size) < double)
    doubles = times[doubled] + length[doubled] * rng.uniform(0.1, 0.9, doubled.sum())
    found = number_pulses(np.sort(np.concatenate([times[kept], doubles])))
    np.testing.assert_array_equal(found.times, times[kept])
    np.testing.assert_array_equal(found.numbers, np.flatnonzero(kept))
    np.testing.assert_array_equal(found.extra, np.sort(doubles))


def test_a_mark_that_chatters_every_turn_counts_once() -> None:
    times = pulse_times(20.0)
    seen = np.sort(np.concatenate([times, times + 0.002]))
    np.testing.assert_array_equal(number_pulses(seen).times, times)


def test_round_off_of_the_pulses_does_not_move_the_angle() -> None:
    """How much to smooth is a flat minimum. A tenth of the millionth of a standard error that golden numbers allow."""
    rng = np.random.default_rng(5)
    exact = pulse_times(20.0)
    times = exact + 1e-4 * rng.normal(size=exact.size)
    t = np.linspace(exact[3], exact[-3], 4001)
    smooth = smooth_angle(number_pulses(times), duration=20.0)
    for _ in range(5):
        other = smooth_angle(number_pulses(times * (1 + 1e-16 * rng.normal(size=times.size))), duration=20.0)
        assert np.abs((other.angle(t) - smooth.angle(t)) / smooth.stderr(t)).max() < 1e-7


@pytest.mark.parametrize("jitter", [0.0, 1e-5, 1e-4])
def test_angle_is_smoothed_as_much_as_the_pulses_jitter(jitter: float) -> None:
    """The error of the angle is what its standard error says, and smaller than that of a single pulse."""
    exact = pulse_times(20.0)
    rng = np.random.default_rng(3)
    smooth = smooth_angle(number_pulses(exact + jitter * rng.normal(size=exact.size)), duration=20.0)
    t = np.linspace(exact[3], exact[-3], 4001)
    error = smooth.angle(t) - (turning(t) - 2 * np.pi)
    if jitter == 0.0:
        assert np.abs(error).max() < 2e-4  # what one pulse a turn leaves open of a wander with a period of 3 s
        return
    assert smooth.jitter == pytest.approx(
        jitter, rel=0.25
    )  # 270 pulses: 4 % from counting, the rest the spline's share
    ratio = float(np.sqrt(np.mean((error / smooth.stderr(t)) ** 2)))
    assert 0.6 < ratio < 1.5  # errors are correlated: some 20 independent ones, 1/sqrt(2 20) = 16 % each
    assert np.sqrt(np.mean((error / (speed(t) * jitter)) ** 2)) < 0.5
    inner = t[400:-400]
    assert np.abs(smooth.speed(inner) - speed(inner)).max() < 0.05 + 2e3 * jitter


def test_scatter_in_angle_is_told_from_scatter_in_time() -> None:
    """Noise on an edge that extends over some angle scatters the angle alike at all speeds; sampling scatters times."""
    exact = pulse_times(20.0)
    rng = np.random.default_rng(8)
    noise = rng.normal(size=exact.size)
    in_angle = smooth_angle(number_pulses(exact + 1e-3 / speed(exact) * noise), duration=20.0)
    in_time = smooth_angle(number_pulses(exact + 5e-6 * noise), duration=20.0)
    np.testing.assert_allclose(in_angle.scatter(np.array([3.0, 18.0])), 1e-3, rtol=0.25)  # 60 pulses: 9 % each
    np.testing.assert_allclose(in_time.scatter(np.array([3.0, 18.0])) / speed(np.array([3.0, 18.0])), 5e-6, rtol=0.25)


def test_pattern_of_a_wheel_is_taken_out() -> None:
    """36 teeth, each off its place by up to half a degree, every turn alike."""
    rng = np.random.default_rng(4)
    teeth = 36
    ahead = np.radians(0.3) * rng.normal(size=teeth)
    ahead -= ahead.mean()
    k = np.arange(1, 36 * 220)
    nominal = 2 * np.pi / teeth * k + ahead[k % teeth]
    t = np.linspace(0, 12.0, 400_001)
    seen = np.interp(nominal, turning(t), t)
    seen = seen[nominal < turning(np.array([11.0]))[0]]
    smooth = smooth_angle(number_pulses(seen), duration=11.5, pulses_per_turn=teeth)
    # the record begins with tooth 1, which is number 0 of the count
    np.testing.assert_allclose(smooth.pattern, np.roll(ahead, -1), atol=2e-4)
    inner = np.linspace(1, 10, 500)
    offset = smooth.angle(inner) - turning(inner)
    assert np.ptp(offset) < 1e-3


def test_a_wheel_with_an_index_gap_counts_from_it() -> None:
    """60 teeth less 2: whatever the record begins with, angle zero is the tooth after the gap."""
    count = np.arange(17, 60 * 40)
    kept = count[~np.isin(count % 60, (58, 59))]
    seen = 1.0 + kept / 60 / 25.0  # 25 turns a second
    pulses, gap = from_index(number_pulses(np.delete(seen, 700)), 60)
    assert gap == 2
    assert pulses.numbers[0] % 60 == 17
    np.testing.assert_array_equal(pulses.missing_count, [1])
    smooth = smooth_angle(pulses, duration=3.0, pulses_per_turn=60)
    t = np.linspace(1.4, 2.5, 100)
    np.testing.assert_allclose(np.exp(1j * smooth.angle(t)), np.exp(50j * np.pi * (t - 1.0)), atol=1e-6)
    whole, none = from_index(number_pulses(1.0 + count / 1500), 60)
    assert none == 0
    assert whole.numbers[0] == 0


def test_pulses_off_their_place_are_left_out_and_named() -> None:
    times = pulse_times(20.0) + 1e-5 * np.random.default_rng(5).normal(size=pulse_times(20.0).size)
    times[100] += 0.003
    smooth = smooth_angle(number_pulses(times), duration=20.0)
    np.testing.assert_array_equal(smooth.outlying, times[[100]])


@pytest.mark.parametrize(
    "signal",
    [
        np.full(1000, -2.0),
        np.random.default_rng(6).normal(size=100_000),
    ],
)
def test_channels_without_pulses_are_refused(signal: Float) -> None:
    with refuses(ValueError):
        find_levels(signal)


def test_irregular_edges_are_no_turns() -> None:
    with refuses(ValueError):
        number_pulses(np.sort(np.random.default_rng(7).uniform(0, 10, 300)))
    with refuses(ValueError):
        number_pulses(np.array([0.1, 0.2]))


def test_a_sweep_that_begins_slowly_has_no_missing_pulses() -> None:
    """60 to 5000 rpm in 10 s: the first turn takes twice as long as the second."""
    slope = 517.0 / 10.0
    turns = 2 * np.pi * np.arange(1, 300) - 6.2
    times = (-6.3 + np.sqrt(6.3**2 + 2 * slope * turns)) / slope
    assert np.diff(times)[0] > 1.5 * np.diff(times)[1]
    found = number_pulses(times)
    assert found.missing.size == 0
    gone = number_pulses(np.delete(times, [0, 7]))
    assert gone.missing_count.tolist() == [1]
    assert gone.missing[0] == pytest.approx(times[6])


def test_an_uneven_sweep_is_not_taken_for_jitter() -> None:
    """A speed that swings by 1 rad/s seven times in a sweep of 10 s: one record in fifty lost it to smoothing."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        slope, size, rate, mark = 51.7, 1.03, 4.59, float(rng.uniform(-np.pi, np.pi))
        t = np.linspace(0, 10, 200_001)
        angle = 6.28 * t + slope * t**2 / 2 - size / rate * (np.cos(rate * t) - 1) + mark
        passed = np.arange(np.ceil(angle[0] / (2 * np.pi)), np.floor(angle[-1] / (2 * np.pi)))
        times = np.interp(2 * np.pi * passed, angle, t) + 4e-6 * rng.standard_normal(passed.size)
        smooth = smooth_angle(number_pulses(times), duration=10.0)
        inside = t[(t > 1) & (t < 9)]
        off = smooth.angle(inside) - np.interp(inside, t, angle)
        assert np.ptp(off) < 0.01


@pytest.mark.parametrize("kind", ["even", "exponential"])
@pytest.mark.parametrize("falls", [False, True])
def test_missing_beside_double_pulses_are_counted_right_or_it_is_said(kind: str, falls: bool) -> None:
    """25 sweeps of 90 to 5000 rpm of each kind, each with up to four pulses missing and four edges too many within nine
    turns, twice.

    A spurious edge that is kept for a true one swings the sweep rate by thousands of rpm/s, a turn too many shifts the
    angle by 360 degrees.
    """
    rng = np.random.default_rng(7)
    duration, rate, first, last = 25.0, 8192.0, 1.5, 5000 / 60
    t = np.linspace(0.0, duration, 200_001)
    speed = first + (last - first) * t / duration if kind == "even" else first * (last / first) ** (t / duration)
    turned = cumulative_trapezoid(speed[::-1] if falls else speed, t, initial=0.0)
    true = np.interp(np.arange(1.0, np.floor(turned[-1])), turned, t)
    inside = np.linspace(true[3], true[-4], 2000)
    said, wrong = 0, []
    for draw in range(25):
        gone, extra = [], []
        for middle in rng.integers(8, true.size - 8, 2).tolist():
            near = np.arange(max(middle - 4, 3), min(middle + 5, true.size - 3))
            gone += rng.choice(near, size=rng.integers(0, 5), replace=False).tolist()
            before = rng.choice(near, size=rng.integers(0, 5), replace=False)
            extra += (true[before] + (true[before + 1] - true[before]) * rng.uniform(0.03, 0.97, before.size)).tolist()
        jitter = rng.uniform(-0.15, 0.15, true.size) / rate
        pulses = number_pulses(np.unique(np.concatenate([np.delete(true + jitter, gone), extra])))
        smooth = smooth_angle(pulses, duration=duration, resolution=1 / rate)
        used = ~np.isin(pulses.times, smooth.outlying)
        off = smooth.angle(inside) / (2 * np.pi) - np.interp(inside, t, turned)
        if pulses.unsure.size or uneven_turns(pulses.times[used], np.diff(pulses.numbers[used])).size:
            said += 1
        elif np.abs(off - np.median(off)).max() > 0.03:  # of a turn
            wrong.append(draw)
    assert wrong == []
    assert said <= 4


def test_edges_in_doubt_that_nothing_tells_apart_are_named() -> None:
    """An edge too many beside a missing pulse, four turns from the end."""
    true = 0.04 * np.arange(100.0)
    pulses = number_pulses(np.sort(np.append(np.delete(true, [95, 96]), true[94] + 0.02)))
    ((begin, end),) = pulses.unsure
    assert true[92] < begin < true[94] + 0.02 < end < true[98]
    assert not number_pulses(np.sort(np.append(np.delete(true, [55, 56]), true[54] + 0.02))).unsure.size


def test_a_spurious_edge_just_before_a_true_one_beside_missing_ones_is_left_out() -> None:
    """Pulses missing after 5.135 and 5.411 s, an edge 5.5 ms before the true one at 5.62 s: an edge that chatters comes
    after its own, this one does not."""
    first, slope = 2 * np.pi * 1.5, 2 * np.pi * (5000 - 90) / 60 / 25
    true = (np.sqrt(first**2 + 4 * np.pi * slope * np.arange(1, 1000)) - first) / slope
    late = int(np.argmin(np.abs(true - 5.6235)))
    gone = [int(np.searchsorted(true, at)) for at in (5.14, 5.42)]
    edges = np.sort(np.concatenate([np.delete(true, gone), [true[late] - 5.5e-3, 6.559]]))
    np.testing.assert_allclose(number_pulses(edges).extra, [true[late] - 5.5e-3, 6.559])


def test_a_spurious_edge_in_place_of_the_missing_one_is_left_out_and_named() -> None:
    """65 degrees ahead of the missing pulse, in a sweep that jitters by the sampling alone: a smooth angle fitted
    with it follows it, and then finds nothing odd."""
    rng = np.random.default_rng(3)
    rate, duration = 8192.0, 25.0
    growth = np.log(5000 / 90) / duration
    true = np.log1p(np.arange(1, 500) * growth / 1.5) / growth  # of 1.5 exp(growth t) turns a second
    gone = int(np.argmin(np.abs(true - 12.2032)))
    edges = np.round(np.sort(np.append(np.delete(true + rng.uniform(-0.1, 0.1, true.size) / rate, gone), 12.1866)), 6)
    smooth = smooth_angle(number_pulses(edges), duration=duration, resolution=1 / rate)
    np.testing.assert_allclose(smooth.outlying, [12.1866])
    inside = np.linspace(true[2], true[-3], 1000)
    off = smooth.angle(inside) - 2 * np.pi * 1.5 * np.expm1(growth * inside) / growth
    assert np.ptp(off) < np.radians(5)
