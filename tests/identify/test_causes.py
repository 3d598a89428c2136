"""Causes beside the fitted values: their columns by finite differences, their effect in full, and what a fit prints."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic import TYPICAL, circular_test

import rotorfit as rf
from rotorfit.estimators.inference.causes import columns, with_causes
from rotorfit.identify.fitting.causes.listing import listed
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.settings import FitSettings

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from error_populations import ROTORS, Row, acting_in, known_of, model_of, responses, rotor_of, sweep_of, usual_sizes

SPEEDS = (100.0, 180.0)
W = np.r_[-np.linspace(20, 250, 12)[::-1], np.linspace(20, 250, 12)]

CHAIN = {
    "M1": 1.0, "M2": 0.8, "M3": 0.3, "K1": 2e4, "K2": 2.5e4, "K3": 2e4, "K4": 6e3, "Ds1": 3.0, "Ds2": 3.0, "Ds3": 0.0,
    "K0": 9e3, "D": 400.0, "lam": 0.46, "Mf": 0.3,
}  # fmt: skip

MODELS: dict[str, tuple[rf.models.RotorModel, dict[str, float], tuple[str, ...]]] = {
    "one mode": (rf.models.OneMode(), TYPICAL["one-mode"], ("K", "Ds")),
    "one mode, clearance known": (rf.models.OneMode(clearance_um=5000.0), TYPICAL["one-mode"], ("K", "Ds")),
    "one mode, two ratios": (
        rf.models.OneMode(two_lam=True),
        {n: v for n, v in TYPICAL["one-mode"].items() if n != "lam"} | {"lam_D": 0.46, "lam_M": 0.44},
        ("K", "Ds"),
    ),
    "disk and journal": (rf.models.WhirlWhip(), TYPICAL["whirl-whip"], ("K3",)),
    "disk and journal, gyroscopic": (
        rf.models.WhirlWhip(blocks=("gyroscopic",)),
        TYPICAL["whirl-whip"] | {"g11": 0.02, "g22": 0.01, "g12": 0.0},
        ("K3",),
    ),
    "two disks": (rf.models.TwoDisk(), TYPICAL["two-disk"], ()),
    "chain of three": (rf.models.Chain(planes=("left", "disk", "journal"), fluid="journal"), CHAIN, ("K4", "Ds3")),
}


def setting(name: str) -> tuple[Any, Any, np.ndarray, tuple[Any, ...], np.ndarray]:
    """A problem at its true values, and its causes with their sizes."""
    model, truth, known = MODELS[name]
    truth = {n: truth.get(n, 0.0) for n in model.parameter_names}
    test = circular_test(model, model.vector(truth), speeds=SPEEDS, frequency=W, noise=0.005, seed=1, sigma_known=True)
    problem = build_problem(model, (test,), FitSettings(known={n: truth[n] for n in known}))
    x = np.array([truth[n] for n in problem.space.base])
    causes = listed(problem, x, {})
    return model, problem, x, causes, np.array([cause.size for cause in causes])


def by_differences(problem: Any, x: np.ndarray, causes: Any, at: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Columns by central differences of the predictions with causes in full."""
    found = []
    for place, step in enumerate(1e-4 * size):
        up, down = (
            with_causes(problem, x, causes, at + way * step * np.eye(size.size)[place]).residuals(x) for way in (1, -1)
        )
        found.append((up - down) / (2 * step))
    return np.array(found).T


@pytest.mark.parametrize("name", MODELS)
def test_columns_are_the_derivatives_of_predictions_with_causes(name: str) -> None:
    _, problem, x, causes, size = setting(name)
    found, none = columns(problem, x, causes), np.zeros(size.size)
    apart = np.linalg.norm((found - by_differences(problem, x, causes, none, size)) * size, axis=0)
    length = np.linalg.norm(found * size, axis=0)
    assert (length > 0).all(), [cause.name for cause, own in zip(causes, length, strict=True) if not own]
    assert (apart < 1e-4 * length).all(), {c.name: a / b for c, a, b in zip(causes, apart, length, strict=True)}


@pytest.mark.parametrize("name", MODELS)
def test_columns_are_the_derivatives_where_all_causes_act(name: str) -> None:
    """What each does beside all others, to an eighth; a speed label leaves out what gyroscopic effects do with it."""
    _, problem, x, causes, size = setting(name)
    at = size * np.abs(np.random.default_rng(2).normal(size=size.size))
    found = columns(with_causes(problem, x, causes, at), x, causes)
    apart = np.linalg.norm((found - by_differences(problem, x, causes, at, size)) * size, axis=0)
    share = dict(zip((c.name for c in causes), apart / np.linalg.norm(found * size, axis=0), strict=True))
    assert share.pop("speed label", 0.0) < 0.3
    assert all(own < 1 / 8 for own in share.values()), share


@pytest.mark.parametrize("kind", ROTORS)
@pytest.mark.parametrize("factor", [0.5, 1.0])
def test_predictions_with_causes_are_those_of_equations_of_motion_written_out(kind: str, factor: float) -> None:
    """True values and causes of a rig leave its noise; readings number 100 to 500, and parts left out thousands."""
    for number in range(4):
        row = Row(kind=kind, factor=factor)
        rotor = rotor_of(kind, number, 1)
        sizes = usual_sizes(kind, number, 1, row.speeds, row.both, ())
        sweep = sweep_of(rotor, row)
        acting = acting_in(row, number, 1, sizes, {})
        test = responses(rotor, sweep, acting, row, np.random.default_rng(number))
        problem = build_problem(model_of(kind), (test,), FitSettings(known=known_of(kind, rotor)))
        x = np.array([rotor.value(name) for name in problem.space.base])
        causes = listed(problem, x, {})
        there = np.array([acting.get(cause.name, 0.0) for cause in causes])
        square = float(np.sum(np.abs(with_causes(problem, x, causes, there).residuals(x)) ** 2))
        expected = problem.n_data
        # four standard deviations of chi-squared, and a tenth of the noise's power for products of causes
        assert square < 1.1 * expected + 4 * np.sqrt(2 * expected), (number, square, expected)


def one_mode(known: dict[str, float], seed: int = 1, causes: Any = {}, damping: float = 0.0) -> Any:  # noqa: B006
    """A fit of a rig whose external damping is nearly none."""
    model = rf.models.OneMode()
    truth = TYPICAL["one-mode"] | {"Ds": damping}
    test = circular_test(
        model, model.vector(truth), speeds=SPEEDS, frequency=W, noise=0.005, seed=seed, sigma_known=True
    )
    return rf.fit(model, test, known={"K": truth["K"], **known}, causes=causes)


def test_a_damping_that_is_known_to_be_nothing_and_to_be_next_to_nothing_give_one_interval() -> None:
    nothing, next_to = one_mode({"Ds": 0.0}), one_mode({"Ds": 1e-9})
    for name in ("M", "K0", "D", "lam", "Mf"):
        for a, b in zip(nothing.params[name].interval(0.95), next_to.params[name].interval(0.95), strict=True):
            assert a == pytest.approx(b, rel=1e-6)
    a, b = (fit.threshold_speed().interval(0.95) for fit in (nothing, next_to))
    assert a == pytest.approx(b, rel=1e-6)


def test_a_damper_on_trust_lengthens_the_interval_to_the_side_that_it_can_move_to() -> None:
    """A damper beside the fluid's damping: D is lower than the whole, and lam, of which D lam is seen, higher."""
    fit = one_mode({"Ds": 0.0}, causes={"gain": 0.001})
    for name, longer in (("D", 0), ("lam", 1)):
        value, ends = fit.params[name].value, fit.params[name].interval(0.95)
        reach = abs(ends[0] - value), abs(ends[1] - value)
        assert reach[longer] > 1.5 * reach[1 - longer], (name, value, ends)


def test_one_speed_leaves_what_changes_with_it_on_trust() -> None:
    model, truth = rf.models.OneMode(), TYPICAL["one-mode"]
    test = circular_test(
        model, model.vector(truth), speeds=(120.0,), frequency=W, noise=0.005, seed=1, sigma_known=True
    )
    fit = rf.fit(model, test, known={"K": truth["K"], "Ds": truth["Ds"]})
    on_trust = fit.threshold_speed().error.on_trust
    assert abs(on_trust["speed[lam]"]) > 3 * abs(on_trust["speed label"])


def test_without_causes_a_fit_is_of_the_noise_alone() -> None:
    known = {"Ds": 8.0}
    with_them, without = one_mode(known, damping=8.0), one_mode(known, damping=8.0, causes=None)
    for name in ("M", "K0", "D", "lam", "Mf"):
        ours, plain = with_them.params[name], without.params[name]
        assert ours.plain == pytest.approx(plain.value, rel=1e-9)
        assert ours.noise == pytest.approx(plain.stderr, rel=0.1)  # by the derivatives at the joint values
        assert plain.bounded == plain.trust == 0.0
        assert abs(ours.value - ours.plain) < ours.stderr / 2


def test_a_cause_of_no_size_is_not_listed() -> None:
    fit = one_mode({"Ds": 0.0}, causes={"damper[journal]": 0, "gain": 0.001})
    names = [cause.name for cause in fit.settings.solved.causes]
    assert "damper[journal]" not in names
    assert {"gain", "lag", "phase"} <= set(names)


def test_speeds_that_were_counted_are_known_better_than_labels() -> None:
    model, truth = rf.models.OneMode(), TYPICAL["one-mode"]
    test = circular_test(model, model.vector(truth), speeds=SPEEDS, frequency=W, noise=0.005, seed=1, sigma_known=True)
    scatter = 1 + 1e-6 * np.random.default_rng(1).normal(size=len(test))
    labels, counted = (
        rf.fit(model, one, known={"K": truth["K"], "Ds": truth["Ds"]})
        for one in (test, replace(test, speed=scatter * test.speed))
    )
    assert labels.causes["speed label"].size == pytest.approx(4 * counted.causes["speed label"].size)
    shares = [abs(fit.threshold_speed().error.on_trust["speed label"]) for fit in (labels, counted)]
    assert shares[0] == pytest.approx(4 * shares[1], rel=0.05)


def test_a_run_a_little_off_the_set_speed_has_a_label_all_the_same() -> None:
    rig = rf.datasets.rig_open()
    off = replace(rig, speed=rig.speed + np.where(rig.run == rig.runs[0], 0.02 * np.pi / 30, 0.0))
    sizes = [
        rf.fit(rf.models.WhirlWhip(), test, known={"K3": 6000.0}).causes["speed label"].size for test in (rig, off)
    ]
    assert sizes[1] == pytest.approx(sizes[0])


def test_supports_that_differ_in_two_directions_need_no_cause() -> None:
    """Of a rig whose K is larger along x and smaller along y by a fifth, circular responses lack the second order
    alone, and the pairs of probes name it. Equations of x + jy and its conjugate, and their roots, are written out."""
    truth, share = TYPICAL["one-mode"], 0.2
    M, K, Ds, K0, D, lam, Mf = (truth[name] for name in ("M", "K", "Ds", "K0", "D", "lam", "Mf"))

    def polynomial(speed: float) -> np.ndarray:
        turn = -1j * lam * speed
        return np.array([M + Mf, Ds + D + 2 * Mf * turn, K + K0 + D * turn + Mf * turn**2])

    rows: dict[str, list[np.ndarray]] = {name: [] for name in ("run", "speed", "frequency", "direction", "response")}
    rng = np.random.default_rng(3)
    for speed in SPEEDS:
        for w in (W[W < 0], W[W > 0]):
            one, other = np.polyval(polynomial(speed), 1j * w), np.polyval(polynomial(speed).conj(), 1j * w)
            forward = other / (one * other - (share * K) ** 2)
            backward = -share * K * forward / other  # conjugate of the part that turns the other way
            x, y = forward + backward, (forward - backward) / 1j
            for direction, z in (("x", x), ("y", y)):
                noise = (
                    0.005 * np.sqrt(np.mean(np.abs(z) ** 2)) * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
                )
                read = np.where(w < 0, z.conj(), z) + noise
                for name, own in zip(rows, (f"{speed} {w[0]}", speed, w, direction, read), strict=True):
                    rows[name].append(np.broadcast_to(own, w.shape))
    cells = {name: np.concatenate(parts) for name, parts in rows.items()}
    test = rf.perturbation_test(force_plane="journal", plane="journal", force=1.0, **cells)
    fit = rf.fit(rf.models.OneMode(), test, known={"K": K, "Ds": Ds})
    assert "anisotropy" in {finding.code for finding in fit.findings}
    for name in ("M", "K0", "D", "lam", "Mf"):
        assert abs(fit.params[name].value - truth[name]) < fit.params[name].stderr, name

    def grows(speed: float) -> bool:
        one = polynomial(speed)
        return bool(np.roots(np.polysub(np.polymul(one, one.conj()), [(share * K) ** 2])).real.max() > 0)

    low, high = fit.threshold_speed().interval()
    assert not grows(low)
    assert grows(high)
