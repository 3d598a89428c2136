"""Rigs with many causes at once, by equations of the benchmark: intervals hold, are narrow, and nothing false is named.

Bounds are those that a share of rigs, or a ratio of errors, passes once in a thousand where it is what is promised.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import newton
from slow_cases import slow_but

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import error_populations as rig
from error_populations import OUTPUTS, ROWS, Found, line_of

import rotorfit as rf
from rotorfit.estimators.inference.cause_acts import Motion
from rotorfit.lab.kinds.free_vibration import ImpulseTest

RARE = 1e-3


def drawn(row: str, rigs: int) -> list[Found]:
    """Fits of the rigs of a row."""
    return line_of(row, ROWS[row], rigs, seed=2)[1]


def assert_held(found: list[Found], promised: float) -> None:
    """Each output's interval holds the truth in no fewer rigs than chance explains."""
    held = np.sum([one.held for one in found], axis=0)
    fewest = stats.binom.ppf(RARE, len(found), promised)
    assert (held >= fewest).all(), dict(zip(OUTPUTS, held.tolist(), strict=True))


def ratios(found: list[Found]) -> np.ndarray:
    """Error over printed standard error of each output, root mean square."""
    return np.sqrt(np.mean([(one.error / one.deviation) ** 2 for one in found], axis=0))


def half_widths(found: list[Found]) -> dict[str, float]:
    """Median half width of the intervals, shares of the truth."""
    half = np.median([(one.high - one.low) / 2 for one in found], axis=0)
    return dict(zip(OUTPUTS, half.tolist(), strict=True))


def test_causes_move_orbits_as_they_move_a_rotor_with_a_law(monkeypatch: pytest.MonkeyPatch) -> None:
    """Columns of a rotor whose film grows with the orbit, which feeds back, against the rotor run by fixed point with a
    little of each cause."""
    monkeypatch.setattr(rig, "NOISE", 0.0)
    row = rig.Row(kind=rig.LAW)
    rotor = rig.rotor_of(rig.LAW, 0, 1)
    sweep = rig.sweep_of(rotor, row)

    def run(acting: dict[str, float]) -> np.ndarray:
        return rig.responses(rotor, sweep, acting, row, np.random.default_rng(0)).response

    exact = rig.responses(rotor, sweep, {}, row, np.random.default_rng(0))
    test = replace(exact, sigma=np.full(len(exact), 1e-3 * np.abs(exact.response).mean()))
    fit = rf.fit(rig.model_of(rig.LAW), test, known=rig.known_of(rig.LAW, rotor))
    model = fit.model
    laws = dict(zip(("n_K", "n_D", "b"), rotor.law, strict=True))
    theta = np.array([[laws[n] if n in laws else rotor.value(n) for n in model.parameter_names]])
    motion = Motion(block=fit.problem.blocks[0], theta=theta)
    assert motion.predicted == pytest.approx(run({}), rel=1e-9)
    moved = {}
    for cause in fit.settings.solved.causes:
        step = 1e-3 * cause.size
        plain = (run({cause.name: step}) - run({cause.name: -step})) / (2 * step)
        moved[cause.name] = np.abs(cause.act.change(motion) - plain).max() / np.abs(plain).max()
    assert {"damper[journal]", "loss", "hysteresis[journal]", "gyro[journal]", "flex[journal]"} < set(moved)
    assert max(moved.values()) < 1e-5, moved  # truncated at the square of the step


def test_causes_move_free_vibration_as_they_move_the_rotor() -> None:
    """Columns of eigenvalues that stand beside sweeps, against roots of the rig's own determinant."""
    kind = "disk and journal"
    rotor, row = rig.rotor_of(kind, 0, 1), rig.Row(kind=kind)
    sweep = rig.sweep_of(rotor, row)
    speed = sweep.speeds[1]
    first = [s for s in rotor._roots(speed) if abs(s.imag) > 3 * abs(s.real)]

    def roots(causes: dict[str, float]) -> np.ndarray:
        acting = {name: size for name, size in causes.items() if name != "drift"}  # which is along a sweep
        true = speed * (1 + acting.get("speed label", 0.0))

        def singular(s: complex) -> complex:
            return np.linalg.det(rotor.stiffness(np.array([s]), true, acting, sweep)[0] / rotor.K.max())

        return np.array([newton(singular, s, tol=1e-9) for s in first])

    s, rows = roots({}), len(first)
    hit = ImpulseTest(
        run=np.full(rows, "hit"), speed=np.full(rows, speed),
        frequency=np.abs(s.imag), damping_ratio=-s.real / np.abs(s),
        eccentricity=np.zeros(rows), position=np.full(rows, np.nan + 0j), sigma=1e-3 * np.abs(s),
    )  # fmt: skip
    test = rig.responses(rotor, sweep, {}, row, np.random.default_rng(0))
    fit = rf.fit(rig.model_of(kind), [test, hit], known=rig.known_of(kind, rotor))
    theta = np.array([[rotor.value(name) for name in fit.model.parameter_names]])
    motion = Motion(block=fit.problem.blocks[1], theta=theta)
    upright = np.where(s.imag > 0, s, s.conj())
    assert motion.predicted == pytest.approx(upright, rel=1e-9)
    moving = {}
    for cause in fit.settings.solved.causes:
        step = 1e-3 * cause.size
        by_step = (roots({cause.name: step}) - roots({cause.name: -step})) / (2 * step)
        plain = np.where(s.imag > 0, by_step, by_step.conj())
        off = np.abs(cause.act.change(motion) - plain).max()
        assert off <= 1e-5 * np.abs(plain).max() + 1e-9 * np.abs(s).max() / cause.size, cause.name
        moving[cause.name] = bool(plain.any())
    assert {name for name, moves in moving.items() if moves} > {
        "K3", "damper[journal]", "loss", "hysteresis[disk]", "gyro[disk]", "mass[disk, journal]", "lag", "speed label",
        "speed[K0]",
    }  # fmt: skip


DESIGNS = [
    (f"{kind}, {design}", rigs)
    for kind in ("one mode", "disk and journal", "chain of three")
    for design in ("2 speeds, both directions", "1 speed, both directions", "2 speeds, forward")
    for rigs in (6, 60)
]
QUICK = (("one mode, 2 speeds, both directions", 6), ("disk and journal, 2 speeds, both directions", 6))


@pytest.mark.parametrize(("design", "rigs"), slow_but(DESIGNS, *QUICK))
@pytest.mark.parametrize(("acting", "promised"), [("all at 0.5", 0.95), ("all at 1", 0.9)])
def test_intervals_hold_where_all_causes_act(design: str, rigs: int, acting: str, promised: float) -> None:
    one_speed_of_all = design.count("1 speed") and promised < 0.95  # thresholds are extrapolated there: 85 to 88 %
    found = drawn(f"{design}, {acting}", rigs)
    assert_held(found, 0.85 if one_speed_of_all else promised)
    # errors of a normal distribution whose deviation is at most 1 / 0.75 of the printed one
    assert (ratios(found) < np.sqrt(stats.chi2.ppf(1 - RARE, rigs) / rigs) / 0.75).all(), ratios(found)


@pytest.mark.parametrize(("design", "rigs"), slow_but([one for one in DESIGNS if "2 speeds, both" in one[0]], *QUICK))
def test_rigs_on_which_nothing_acts_have_narrow_intervals_that_hold(design: str, rigs: int) -> None:
    found = drawn(f"{design}, nothing acts", rigs)
    assert_held(found, 0.95)
    half = half_widths(found)
    assert half["threshold"] < 0.025
    assert half["lam"] < 0.045
    apart = ratios(found)[:5]  # without the threshold, of which a quarter is noise
    assert (apart < 0.25 * np.sqrt(stats.chi2.ppf(1 - RARE, rigs) / rigs)).all(), apart
    assert sum(bool(one.false) for one in found) <= stats.binom.ppf(1 - RARE, rigs, 0.01)


def test_calibrated_gains_leave_the_damping_four_percent() -> None:
    found = drawn("one mode, gains calibrated to 0.5 %, nothing acts", 6)
    assert half_widths(found)["D"] < 0.04


@pytest.mark.parametrize(
    "row",
    slow_but(
        [
            f"one mode, {one}"
            for one in (
                "common gain 1.5 %",
                "phase reference 2 deg, forward",
                "lag 3 deg",
                "damper 3 % told as known 0",
                "film of a short bearing",
                "at rest off the centre, listed",
            )
        ],
        "one mode, phase reference 2 deg, forward",
        "one mode, damper 3 % told as known 0",
        "one mode, film of a short bearing",
        "one mode, at rest off the centre, listed",
    ),
)
def test_a_cause_that_no_test_of_the_kind_shows_is_in_the_interval(row: str) -> None:
    assert_held(drawn(row, 6), 0.9)


def test_values_that_change_with_speed_are_causes_of_laws_as_well() -> None:
    """Without them the threshold had a third of the interval, and missed by ten times its error."""
    found = drawn("law of eccentricity, 2 speeds, both directions, all at 1", 4)
    assert_held(found, 0.9)
    assert (ratios(found) < 2).all()  # of four rigs a root mean square exceeds that once in a thousand
    assert half_widths(found)["threshold"] < 0.01


def test_factors_of_readings_act_in_full_on_rotors_that_are_not_linear() -> None:
    """To first order AC coupling of 0.5 Hz, a third of the lowest frequency, left redchi above 2 and missed values."""
    found = drawn("law of eccentricity, AC coupling 0.5 Hz", 4)
    assert_held(found, 0.95)
    assert all(one.redchi < 1.3 for one in found)
    assert (ratios(found) < 1).all()


@pytest.mark.parametrize("kind", slow_but(["one mode", "disk and journal"], "one mode"))
def test_differences_of_four_runs_are_given_to_no_cause(kind: str) -> None:
    """Two speeds, two directions: what runs differ by looks like a value that changes with speed, or an angle."""
    found = drawn(f"{kind}, runs differ by 0.5 %, 0.5 deg, nothing else", 12)
    assert sum(bool(one.false) for one in found) <= stats.binom.ppf(1 - RARE, 12, 0.01)
    assert_held(found, 0.95)


@pytest.mark.slow
@pytest.mark.parametrize("cause", ["turned", "phase", "curve", "speed[lam]", "speed[K0]", "speed[D]", "drift"])
def test_causes_of_three_sizes_that_the_data_tell_are_named_and_covered(cause: str) -> None:
    found = drawn(f"one mode, {cause} alone, three sizes", 20)
    assert sum(bool(one.right) for one in found) >= stats.binom.ppf(RARE, 20, 0.75)
    assert_held(found, 0.95)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["one mode", "disk and journal"])
def test_a_resonance_of_the_foundation_is_given_to_no_cause(kind: str) -> None:
    found = drawn(f"{kind}, foundation 1 % in the band", 12)
    assert all(one.redchi > 1.3 for one in found)
    assert not any(one.false for one in found)
    assert_held(found, 0.9)


def test_a_change_between_two_tests_counts_what_both_rest_on_once() -> None:
    """A worn bearing, read by the same probes: all causes at one size act in both tests alike, those of each sweep
    anew. Independent errors would be ten times as wide."""
    row, rigs, names = rig.Row(factor=1.0), 8, ("D", "lam", "K0", "Mf")
    held, width = [], []
    for number in range(rigs):
        rotor = rig.rotor_of(row.kind, number, 1)
        worn = replace(rotor, D=0.97 * rotor.D, K0=1.02 * rotor.K0, lam=0.99 * rotor.lam)
        sweep, listed = rig.sweep_of(rotor, row), rig.usual_sizes(row.kind, number, 1, 2, True, ())
        acting, rng = rig.acting_in(row, number, 1, listed, {}, rigs), np.random.default_rng([9, number])
        fits = []
        for one in (rotor, worn):
            own = acting | {name: rng.normal() * listed[name][0] for name in ("drift", "clock")}
            known = rig.known_of(row.kind, rotor)
            fits.append(rf.fit(rig.model_of(row.kind), rig.responses(one, sweep, own, row, rng), known=known))
        before, after = (fit.params for fit in fits)
        changes = [after[name].change_from(before[name]) for name in names]
        true = [getattr(worn, name) - getattr(rotor, name) for name in names]
        held.append([abs(found.value - own) < 1.96 * found.stderr for found, own in zip(changes, true, strict=True)])
        width.append([found.stderr / (after[n] - before[n]).stderr for found, n in zip(changes, names, strict=True)])
    assert (np.sum(held, axis=0) >= stats.binom.ppf(RARE, rigs, 0.9)).all(), held
    assert (np.median(width, axis=0)[:3] < 0.2).all(), width
