"""Plans of tests: the errors that simulated fits scatter by, optimal shares that are known otherwise, and refusals."""

from __future__ import annotations

import importlib
import math
import pickle
import time
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from known_shaft import FITTED, known_rig
from plain import plain_fit
from scipy import optimize, stats
from seal_campaigns import KNOWN as SEAL_KNOWN
from seal_campaigns import seal_campaign
from sentences import refuses
from slow_cases import slow_but
from synthetic import TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.base.array_types import Float
from rotorfit.estimators.inference.optimal_shares import GAP, Lines, optimal_shares
from rotorfit.models import OneMode

ONE = rf.models.OneMode()
TRUTH = TYPICAL["one-mode"]
KNOWN = known_of("one-mode", TRUTH)
FREE = {name: value for name, value in TRUTH.items() if name not in KNOWN}
THETA = ONE.vector(TRUTH)
SPEEDS = (100.0, 180.0)
DRAWS = 40


def swept(seed: int) -> rf.PerturbationTest:
    w = covering_frequencies(ONE, THETA, SPEEDS, 30)
    return circular_test(ONE, THETA, speeds=SPEEDS, frequency=w, noise=0.01, seed=seed, sigma_known=True)


def test_errors_are_those_that_fits_scatter_by() -> None:
    plan = rf.plan(ONE, FREE, swept(0), known=KNOWN, quantity="lam", causes=None)
    fits = [plain_fit(ONE, swept(seed), known=KNOWN) for seed in range(DRAWS)]
    low, high = stats.chi2.ppf([0.5e-4, 1 - 0.5e-4], DRAWS)
    for name, one in plan.expected.items():
        found = [f.threshold_speed() if name == "threshold_speed" else f.params[name] for f in fits]
        pulls = [number.value - one.value for number in found]
        assert low < np.sum(np.square(pulls)) / one.stderr**2 < high, name


def benchmark(name: str) -> ModuleType:
    path = Path(__file__).parents[2] / "benchmarks"
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(path))
        return importlib.import_module(name)


@pytest.mark.parametrize(
    "case", slow_but(benchmark("plan_errors").CASES, "sweeps, jitter of the force 1 %", "impulses")
)
def test_errors_of_every_kind_of_test_and_noise(case: str) -> None:
    """The short form of benchmarks/plan_errors.py: a standard deviation of 25 fits has an error of 14 %."""
    for row in benchmark("plan_errors").study(case, 25):
        assert row.failures == 0
        assert abs(np.log(row.ratio)) < 0.1 + 4.4 * row.ratio_error, row


@pytest.mark.slow
@pytest.mark.parametrize("rig", benchmark("plan_gain").CASES)
def test_planned_tests_are_better_than_even_ones_as_predicted(rig: str) -> None:
    for row in benchmark("plan_gain").study(rig, 60):
        assert abs(np.log(row.gain / row.predicted)) < 0.1 + 4.4 * row.gain_error / row.gain, row


@pytest.mark.parametrize(("acting", "noise_told"), [(0.0, True), (0.5, True), (0.0, False)])
@pytest.mark.parametrize("kind", slow_but(benchmark("error_populations").KINDS, "one mode", "disk and journal"))
def test_promised_errors_are_those_that_fits_of_such_tests_print(kind: str, acting: float, noise_told: bool) -> None:
    """Noise and causes, of a repeat planned by an earlier fit alone. What fits print scatters with their values and
    with the noise that they estimate: the promise is one of them."""
    rigs = benchmark("error_populations")
    row, repeats = rigs.Row(kind=kind, noise_told=noise_told, factor=acting), 5
    rotor, model = rigs.rotor_of(kind, 1, 1), rigs.model_of(kind)
    sweep, known = rigs.sweep_of(rotor, row), rigs.known_of(kind, rotor)
    causes = rigs.acting_in(row, 1, 1, rigs.usual_sizes(kind, 1, 1, 2, True, ()), {}) if acting else {}
    tests = [rigs.responses(rotor, sweep, causes, row, np.random.default_rng([3, seed])) for seed in range(repeats)]
    first, *fits = [rf.fit(model, test, known=known) for test in tests]
    plan = rf.plan(model, first, tests[1], draws=1)
    for name, one in plan.expected.items():
        again = [fit.threshold_speed() if name == "threshold_speed" else fit.params[name] for fit in fits]
        for share in ("stderr",) if acting else ("stderr", "noise"):
            printed = np.log([getattr(found, share) for found in again])
            away = np.log(getattr(one, share)) - printed.mean()
            # Student's t of one more draw beside four, once in ten thousand; 2 % for errors to second order
            reach = stats.t.ppf(1 - 0.5e-4, len(fits) - 1) * printed.std(ddof=1) * math.sqrt(1 + 1 / len(fits))
            assert abs(away) < min(reach + 0.02, 0.25), (name, share)


def test_what_no_averaging_lowers_is_named_with_what_would_bound_it() -> None:
    """Where lam is wanted to less than a damper on trust leaves, no averaging does it; a measured one lets it."""
    fit = rf.fit(ONE, swept(0), known=KNOWN)
    plan = rf.plan(ONE, fit, swept(1), quantity="lam", wanted=0.25 * fit.params["lam"].stderr / fit.params["lam"].value)
    said = " ".join(plan.suggestions)
    assert "No averaging brings lam" in said
    assert "errors stay: lam" in said
    assert "resting on damper[" in said
    assert "to bound it, measure a ring-down without fluid" in said
    floor = plan.expected["lam"].floor
    assert floor is not None
    longer = rf.plan(ONE, fit, [swept(seed) for seed in range(8)], quantity="lam").expected["lam"]
    assert floor.stderr < longer.stderr < plan.expected["lam"].stderr
    told = rf.plan(ONE, fit, swept(1), known={**KNOWN, "Ds": (KNOWN["Ds"], 0.2)}, quantity="lam")
    assert told.expected["lam"].stderr < 0.5 * floor.stderr


def test_runs_are_ranked_by_the_whole_error() -> None:
    """Of one sweep forward the phase reference stays on trust: the sweep backward is worth most, which the noise alone
    does not say; fits of both print it."""
    known = {"K": (KNOWN["K"], 1.0), "Ds": (KNOWN["Ds"], 0.02)}
    options = {"known": known, "quantity": "lam"}
    speeds = (100.0, 130.0)
    w = covering_frequencies(ONE, THETA, speeds, 30)
    test = circular_test(ONE, THETA, speeds=speeds, frequency=w, noise=0.01, seed=0, sigma_known=True)
    slow, forward = test.speed == speeds[0], test.frequency > 0
    first = test.select(slow & forward)
    backward, faster = test.select(slow), test.select(forward)

    def best(**how: object) -> str:
        said = rf.plan(ONE, FREE, first, **options, **how).suggestions
        return next(sentence for sentence in said if sentence.startswith("Add "))

    assert best().startswith("Add journal 954.93 rpm backward")
    assert best(causes=None).startswith("Add journal 1241.4 rpm forward")
    errors = [rf.fit(ONE, both, known=known).params["lam"].stderr for both in (first, backward, faster)]
    assert errors[1] < errors[2] < errors[0]


def test_readings_of_a_pattern_do_not_count() -> None:
    one, other = (rf.plan(ONE, FREE, swept(seed), known=KNOWN, quantity="lam") for seed in (1, 2))
    assert one.expected["lam"].stderr == other.expected["lam"].stderr


def polynomial(powers: int, x: Float, gradient: Float | None = None) -> Lines:
    rows = x[:, None] ** np.arange(powers)
    gradients = np.zeros((1, 0, powers)) if gradient is None else gradient[None, None]
    return Lines(rows=rows[None], line=np.arange(x.size), fixed=np.zeros((1, powers, powers)), gradients=gradients)


def test_shares_of_polynomials_are_those_of_the_literature() -> None:
    """D-optimal: thirds at -1, 0, 1 of a parabola (Fedorov 1972). c-optimal: a line extrapolated to 2, by Elfving."""
    x = np.linspace(-1.0, 1.0, 41)
    lines = polynomial(3, x)
    found = optimal_shares(lines, even=1e-9)
    assert found.optimal
    thirds = np.isin(np.arange(x.size), (0, 20, 40)) / 3
    assert 0 <= lines.criterion(found.share) - lines.criterion(thirds) <= GAP
    # 1 + 2 x = 3/2 (1 + x at 1) - 1/2 (at -1): shares 3/4 and 1/4, variance (3/2 + 1/2)^2.
    lines = polynomial(2, x, np.array([1.0, 2.0]))
    found = optimal_shares(lines, even=1e-9)
    # A gap of 1 % lets the neighbours of the two ends have a part.
    assert found.share[x > 0.5].sum() == pytest.approx(0.75, abs=0.03)
    assert found.share[x < -0.5].sum() == pytest.approx(0.25, abs=0.03)
    assert float(lines.variances(found.share)[0, 0]) == pytest.approx(4.0, rel=0.015)
    mixed = optimal_shares(lines, even=0.3)
    assert float(lines.variances(mixed.share)[0, 0]) <= 4.0 / mixed.efficiency
    assert mixed.share.min() >= 0.3 / x.size * (1 - 1e-12)


def test_shares_for_a_quantity_are_those_of_a_linear_programme() -> None:
    """Elfving's theorem: the least variance is the square of the least sum of |u_k| with sum u_k x_k = g."""
    rng = np.random.default_rng(7)
    for _ in range(5):
        x, g = rng.normal(size=(40, 4)), rng.normal(size=4)
        found = optimize.linprog(np.ones(80), A_eq=np.hstack([x.T, -x.T]), b_eq=g)
        lines = Lines(rows=x[None], line=np.arange(40), fixed=np.zeros((1, 4, 4)), gradients=g[None, None])
        shares = optimal_shares(lines, even=1e-6)
        variance = float(lines.variances(shares.share)[0, 0])
        assert found.fun**2 <= variance <= found.fun**2 * (1 + 2 * GAP)
        assert variance * shares.efficiency <= found.fun**2


def evening(**more: object) -> rf.Plan:
    model = rf.models.WhirlWhip()
    values = {name: (0.8 * value, 1.2 * value) for name, value in TYPICAL["whirl-whip"].items()}
    values |= {"lam": (0.45, 0.49), "sigma": 0.95, "K3": 6000.0}
    design = rf.Design(
        speed_rpm=[600, 1000, 1400, 1800, 2200, 2500],
        frequency_rpm=np.linspace(100, 3000, 40),
        force_N=5.0,
        clearance_share=0.1,
        clearance_um=200.0,
        speed_count=3,
    )
    options: dict[str, object] = {"noise_um": 0.5, "quantity": ("lam", "threshold_speed"), **more}
    return rf.plan(model, values, design, known={"K3": 6000.0}, **options)


def test_an_evening_of_three_speeds(tmp_path: Path) -> None:
    begin = time.process_time()
    plan = evening()
    assert time.process_time() - begin < 5.0
    assert plan.certificate.optimal
    assert len(np.unique(plan.lines.speed)) == 3
    assert any("Run at" in sentence and "of 20 choices of 3 speeds" in sentence for sentence in plan.suggestions)
    for name in plan.quantity:
        one = plan.expected[name]
        assert one.stderr < plan.even[name].stderr
        assert one.low < one.stderr < one.high
    assert len(plan.to_dataframe()) == plan.share.size == 3 * 2 * 2 * 40
    assert plan.share.sum() == pytest.approx(1.0)
    plan.to_csv(tmp_path / "planned.csv")
    head = (tmp_path / "planned.csv").read_text(encoding="utf-8").splitlines()[:3]
    assert "amplitude_um" in head[1]
    plan.plot()


def test_what_stays_open_is_said() -> None:
    """Without a known support stiffness, static and fluid stiffness are one sum, whatever is measured."""
    design = rf.Design(speed_rpm=[900, 1700], frequency_rpm=np.linspace(200, 2400, 20), force_N=5.0)
    plan = rf.plan(ONE, {**FREE, "K": TRUTH["K"]}, design, noise_um=0.1, known={"Ds": TRUTH["Ds"]}, quantity="K")
    assert not np.isfinite(plan.expected["K"].stderr)
    assert np.isfinite(plan.expected["M"].stderr)
    assert any("K + K0 only as a sum" in sentence for sentence in plan.suggestions)


@pytest.mark.parametrize(
    "change",
    [
        {"speed_rpm": 9000},
        {"force_planes": "disk"},
        {"probes": "coupling"},
        {"force_N": -1.0},
        {"force_N": None},
        {"clearance_share": 1.5, "clearance_um": 100},
        {"clearance_share": 0.1},
        {"speed_count": 2},
        {"directions": "sideways"},
        {"frequency_rpm": [-100.0, 100.0]},
        {"frequency_rpm": []},
    ],
)
def test_impossible_designs_are_refused_in_one_sentence(change: dict[str, object]) -> None:
    options: dict[str, object] = {"speed_rpm": 1000, "frequency_rpm": [400.0, 800.0, 1200.0], "force_N": 5.0, **change}
    with refuses(ValueError) as refused:
        rf.plan(ONE, FREE, rf.Design(**options), noise_um=0.1, known=KNOWN, quantity="lam")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"noise_um": None}, ValueError),
        ({"noise_um": -1.0}, ValueError),
        ({"noise_um": {"disk": 0.1}}, ValueError),
        ({"quantity": "lamb"}, KeyError),
        ({"quantity": "K"}, ValueError),
        ({"values": {**FREE, "D": (2.0, 1.0)}}, ValueError),
        ({"values": {**FREE, "M": -5.0}}, ValueError),
        ({"values": {"lam": 0.4}}, ValueError),
        ({"values": {**FREE, "Q": 0.4}}, KeyError),
        ({"values": 3.0}, TypeError),
        ({"even": 0.0}, ValueError),
        ({"wanted": -1.0}, ValueError),
        ({"draws": 0}, ValueError),
        ({"noise_share": 2.0}, ValueError),
        ({"memory": (0.5, 1.5)}, ValueError),
        ({"runs": {"K0": 0.0}}, ValueError),
        ({"runs": {"torque": 0.1}}, ValueError),
    ],
)
def test_impossible_wishes_are_refused_in_one_sentence(change: dict[str, object], error: type[Exception]) -> None:
    design = rf.Design(speed_rpm=1000, frequency_rpm=[400.0, 800.0, 1200.0, 1600.0], force_N=5.0)
    options: dict[str, object] = {"values": FREE, "noise_um": 0.1, "quantity": "lam", **change}
    with refuses(error):
        rf.plan(ONE, tests=design, known=KNOWN, **options)


def test_runs_that_are_worth_adding_are_named_with_their_time() -> None:
    """Forces at the journal alone leave the disk's masses and springs open; a run at the disk settles them."""
    model, truth = rf.models.WhirlWhip(), TYPICAL["whirl-whip"]
    pattern = circular_test(
        model, model.vector(truth), speeds=(100.0,), frequency=np.linspace(20, 300, 25), noise=0.02,
        force_planes=("journal",), sigma_known=True,
    )  # fmt: skip
    plan = rf.plan(model, truth, pattern, known={"K3": 6000.0}, quantity="lam", wanted=0.002)
    said = " ".join(plan.suggestions)
    assert "One run more would settle it: disk" in said
    assert "Add " in said
    assert "25 lines," in said
    backward = circular_test(
        model, model.vector(truth), speeds=(100.0,), frequency=-np.linspace(20, 300, 25), noise=0.02,
        force_planes=("disk",), sigma_known=True,
    )  # fmt: skip
    both = rf.plan(model, truth, [pattern, backward], known={"K3": 6000.0}, quantity="lam")
    assert not both.identifiability.combinations
    assert both.expected["lam"].stderr < plan.expected["lam"].stderr


def test_a_virtual_run_is_fitted_as_planned() -> None:
    """Integrated in time, read with the planned noise: pulls and redchi as the plan promises, lines unequally long."""
    design = rf.Design(speed_rpm=[900, 1700], frequency_rpm=np.linspace(200, 2400, 12), force_N=3.0)
    noise = {"noise_um": 0.5, "noise_share": 0.004, "common_share": 0.003}
    plan = rf.plan(ONE, FREE, design, known=KNOWN, quantity="lam", **noise)
    test = plan.virtual_run(seed=5)
    fit = plain_fit(ONE, test, known=KNOWN)
    limits = stats.chi2.ppf([0.5e-4, 1 - 0.5e-4], fit.nfree) / fit.nfree
    assert limits[0] < fit.redchi < limits[1]
    for name, value in FREE.items():
        assert abs(fit.params[name].value - value) < 4.5 * plan.expected[name].stderr, name
    other = plan.virtual_run(values={"lam": 0.40}, seed=5)
    assert plain_fit(ONE, other, known=KNOWN).params["lam"].value == pytest.approx(0.40, rel=0.01)


def test_one_level_of_motion_leaves_a_law_of_eccentricity_open() -> None:
    """At one eccentricity stiffness and exponent are one number; several levels of force tell them apart."""
    model = rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=200.0)
    values = {**TRUTH, "n_K": 2.0, "n_D": 1.4, "b": 0.5}
    lines = {"speed_rpm": [900, 1700], "frequency_rpm": np.linspace(200, 2000, 12), "clearance_share": 0.5}
    options = {"noise_um": 0.5, "known": KNOWN, "quantity": "b"}
    one = rf.plan(model, values, rf.Design(**lines), **options)
    assert not np.isfinite(one.expected["b"].stderr)
    assert any("lam, b only in combination" in said for said in one.suggestions)
    several = rf.plan(model, values, rf.Design(**lines, levels=(0.3, 1.0)), **options)
    assert several.expected["b"].relative < 0.1


def test_what_is_measured_already_counts_and_moves_the_plan_elsewhere() -> None:
    """Planned beside sweeps at one speed: errors as of a fit of both, and less time where the sweeps have been."""
    done = swept(0).select(swept(0).speed == SPEEDS[0])
    design = rf.Design(speed_rpm=np.array(SPEEDS) * 30 / np.pi, frequency_rpm=np.linspace(200, 2400, 12), force_N=5.0)
    options = {"known": KNOWN, "noise_um": 5.0, "quantity": "threshold_speed", "causes": None}
    alone, beside = rf.plan(ONE, FREE, design, **options), rf.plan(ONE, FREE, [done, design], **options)
    assert beside.expected["threshold_speed"].stderr < alone.expected["threshold_speed"].stderr
    slow = np.isclose(alone.lines.speed, SPEEDS[0])
    assert beside.share[slow].sum() <= alone.share[slow].sum() + 0.01
    errors = rf.plan(ONE, FREE, [done, beside.virtual_run(seed=1)], known=KNOWN, quantity="threshold_speed")
    assert beside.test is not None
    assert len(beside.lines.run) == 2 * 2 * 12
    assert errors.expected["lam"].stderr > 0


def test_terms_that_hold_in_the_band_leave_a_rotor_that_can_be_planned_for() -> None:
    """As a polynomial the out-of-band block has unstable roots at every speed, which are none of the rotor's."""
    model = rf.models.WhirlWhip(blocks=("coupling_mass", "gyroscopic", "out_of_band"))
    fit = plain_fit(model, rf.datasets.rig_open(), known={"K3": 6000.0})
    design = rf.Design(speed_rpm=[1000, 1800], frequency_rpm=np.linspace(300, 3000, 10), force_N=1.0)
    plan = rf.plan(model, fit, design, noise_um=0.5, quantity="threshold_speed", draws=2)
    assert plan.expected["threshold_speed"].value == pytest.approx(fit.threshold_speed().value, rel=1e-9)
    assert math.isfinite(plan.expected["threshold_speed"].stderr)
    with refuses(ValueError):
        rf.plan(model, fit, replace(design, speed_rpm=3000), noise_um=0.5)


def test_a_known_shaft_settles_as_fast_as_its_planes_do() -> None:
    """The many modes far above the band are hardly damped, and no reading waits for them."""
    model = known_rig()
    design = rf.Design(speed_rpm=1000, frequency_rpm=[600, 1200, 1800], force_N=1.0)
    plan = rf.plan(model, FITTED, design, noise_um=0.5, quantity="lam")
    s = rf.models.eigenvalues(model, model.vector(FITTED), 1000 * np.pi / 30)
    slow = max(z.real for z in s if abs(z) < 3000 * np.pi / 30)
    np.testing.assert_allclose(plan.lines.settle, math.log(100) / -slow)


def test_a_modal_design_reads_the_planes_alone() -> None:
    model = rf.models.Modal(("inboard", "outboard"), modes=1, gains="plane")
    values = {q.name: 1.0 for q in model.parameters} | {"wn": 160.0, "zeta": 0.03}
    design = rf.Design(speed_rpm=0, frequency_rpm=np.linspace(1000, 2000, 10), force_N=1.0)
    plan = rf.plan(model, values, design, noise_um=0.5)
    assert plan.test is not None
    assert set(plan.test.plane.tolist()) == {"inboard", "outboard"}


def test_lines_of_a_shaft_that_is_not_round_are_patterns_and_no_design() -> None:
    shaft = rf.models.AnisotropicShaft(torsion=None)
    values = {"M": 4.0, "D": 40.0, "K": 4e5, "dK_cos": 8e3, "dK_sin": 2e3}
    known = dict.fromkeys(("ec", "es", "Px", "Py"), 0.0)
    w, size = np.tile(np.linspace(50, 300, 40), 2), 80
    lines = rf.LineTest(
        run=np.full(size, "r"), speed=np.full(size, 150.0), frequency=w, force_plane=np.full(size, "disk"),
        force=np.full(size, 3 + 0j), plane=np.full(size, "disk"), direction=np.full(size, "z"),
        line=np.repeat(["w", "2Om-w"], 40), response=np.full(size, 1e-5 + 0j), sigma=np.full(size, 1e-7),
    )  # fmt: skip
    both = rf.plan(shaft, values, lines, known=known, quantity="dK_cos")
    direct = rf.plan(shaft, values, lines.select(lines.line == "w"), known=known, quantity="dK_cos")
    assert both.expected["dK_cos"].stderr < 0.5 * direct.expected["dK_cos"].stderr
    design = rf.Design(speed_rpm=900, frequency_rpm=[500, 1500], force_N=1.0)
    with refuses(ValueError):
        rf.plan(shaft, values, design, known=known, noise_um=1.0)


def test_noise_of_motion_is_none_of_eigenvalues() -> None:
    """A share of a probe's reading and differences of runs say nothing of the decay of an impulse."""
    model = rf.models.OneMode()
    hit = rf.ImpulseTest(
        run=np.array(["a", "b", "c"]), speed=np.array([50.0, 100.0, 150.0]), frequency=np.full(3, 60.0),
        damping_ratio=np.full(3, 0.3), eccentricity=np.zeros(3), position=np.full(3, np.nan + 0j),
        sigma=np.full(3, 0.3),
    )  # fmt: skip
    known = {**KNOWN, "M": 1.2, "Mf": 0.4}
    values = {name: TRUTH[name] for name in ("K0", "D", "lam")}
    plain, shared = (rf.plan(model, values, hit, known=known, noise_share=s) for s in (0.0, 0.05))
    assert plain.expected["D"].stderr == shared.expected["D"].stderr
    with refuses(ValueError):
        rf.plan(model, values, hit, known=known, runs={"force": 0.01})


def test_a_quantity_that_is_weak_is_planned_for() -> None:
    """What little averaging leaves at more than its own size is not open: shares and time are found for it."""
    design = rf.Design(speed_rpm=900, frequency_rpm=np.linspace(200, 1200, 8), force_N=0.01)
    plan = rf.plan(ONE, FREE, design, known=KNOWN, noise_um=0.5, quantity="Mf", wanted=0.1, causes=None)
    assert plan.certificate.optimal
    assert 1 < plan.expected["Mf"].relative < plan.even["Mf"].relative
    assert any(sentence.startswith("Weak") for sentence in plan.suggestions)
    assert any("times the averaging" in sentence for sentence in plan.suggestions)


def test_a_speed_that_leaves_the_quantity_open_is_not_chosen() -> None:
    """At rest nothing turns the fluid: lam is not seen there."""
    lines = {"frequency_rpm": np.linspace(200, 2400, 12), "force_N": 3.0}
    design = rf.Design(speed_rpm=[0, 900], speed_count=1, **lines)
    plan = rf.plan(ONE, FREE, design, known=KNOWN, noise_um=0.5, quantity="lam")
    assert set(np.round(plan.lines.speed * 30 / np.pi)) == {900}


def test_draws_without_a_threshold_are_left_out() -> None:
    """Without swirl the rotor is stable at every speed: the plan is made for the others."""
    design = rf.Design(speed_rpm=[600, 900], speed_count=1, frequency_rpm=np.linspace(200, 2400, 12), force_N=3.0)
    plan = rf.plan(
        ONE, {**FREE, "lam": (-0.03, 0.5)}, design, known=KNOWN, noise_um=0.5, quantity=("threshold_speed", "lam")
    )
    assert np.isfinite(plan.share).all()
    assert plan.certificate.optimal
    stable = rf.plan(ONE, {**FREE, "lam": 0.0}, design, known=KNOWN, noise_um=0.5, quantity="threshold_speed")
    assert not np.isfinite(stable.expected["threshold_speed"].stderr)
    assert "threshold_speed stays open." in stable.notes


def test_draws_that_are_unstable_do_not_make_errors_small() -> None:
    """Over a wide range the rotor whirls by itself at some draws: these tell nothing, and are counted in a sentence."""
    values = {**FREE, "D": stats.norm(450.0, 400.0)}
    design = rf.Design(speed_rpm=1000, frequency_rpm=np.linspace(100, 3000, 20), force_N=1e3)
    for quantity in (None, "lam"):
        plan = rf.plan(ONE, values, design, known=KNOWN, noise_um=0.5, quantity=quantity)
        assert any("of 16 draws of the values the rotor is unstable" in note for note in plan.notes)
        assert 0 < plan.expected["lam"].low < plan.expected["lam"].high < np.inf
        assert np.isfinite(plan.share).all()
        assert any("beyond what probes read" in note for note in plan.notes)


def test_a_plan_that_is_filled_in_is_read_back(tmp_path: Path) -> None:
    design = rf.Design(speed_rpm=900, frequency_rpm=np.linspace(200, 2400, 12), force_N=3.0)
    plan = rf.plan(ONE, FREE, design, known=KNOWN, quantity="lam", noise_um=0.5)
    plan.to_csv(tmp_path / "plan.csv")
    lines = (tmp_path / "plan.csv").read_text(encoding="utf-8").splitlines()
    head = lines[1].split(",")
    run = plan.virtual_run(seed=2)
    filled = []
    for line, reading in zip(lines[2:], run.response.tolist(), strict=True):
        cells = dict(zip(head, line.split(","), strict=True))
        cells["amplitude_um"], cells["phase_deg"] = f"{abs(reading) * 1e6}", f"{np.degrees(np.angle(reading))}"
        filled.append(",".join(cells[name] for name in head))
    (tmp_path / "filled.csv").write_text("\n".join([lines[1], *filled]), encoding="utf-8")
    back = rf.read(tmp_path / "filled.csv")
    np.testing.assert_allclose(back.response, run.response, rtol=1e-9)
    np.testing.assert_allclose(back.sigma, plan.test.sigma, rtol=1e-9)


def test_a_fit_and_a_plan_can_be_sent():
    fit = plain_fit(OneMode(), seal_campaign(1)[0], known=SEAL_KNOWN)
    sent = pickle.loads(pickle.dumps(fit))
    np.testing.assert_array_equal(sent.sample(seed=1, ess=20).chain, fit.sample(seed=1, ess=20).chain)
    design = rf.Design(speed_rpm=[500, 900], frequency_rpm=range(200, 2001, 200), force_N=5.0)
    plan = rf.plan(OneMode(), fit, design, noise_um=0.5, quantity="lam")
    assert str(pickle.loads(pickle.dumps(plan))) == str(plan)
