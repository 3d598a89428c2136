"""Campaigns: run by run, with shared parameters, and their trends."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest
from drawn import faults_of
from plain import plain_fit
from scipy.stats import norm
from seal_campaigns import FLUID, KNOWN, seal_campaign
from sentences import refuses
from turbulence import recorded

import rotorfit as rf
from rotorfit.estimators.minimisation.least_squares import minimise
from rotorfit.estimators.starting.starts import find_start
from rotorfit.identify.fitting.problem_setup import build_problem
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.models import OneMode


@pytest.fixture(scope="module")
def small():
    return seal_campaign(20)


@pytest.fixture(scope="module")
def fitted(small):
    return rf.campaign(OneMode(), small[0], known=KNOWN)


# ---- run by run -------------------------------------------------------------------------------------------------


def test_runs_of_operating_vibration_say_something():
    values = {"M": 1.0, "K": 7000.0, "Ds": 5.0, "K0": 3000.0, "D": 400.0, "lam": 0.40, "Mf": 0.2}
    test = recorded(OneMode(), values, np.array([200.0]), minutes=3, seed=3, width=0.5)
    known = {name: values[name] for name in ("M", "K", "Ds", "K0", "D", "Mf")}
    assert not rf.campaign(OneMode(), [test], known=known).runs[0].silent


def test_every_run_is_found(small, fitted):
    _, truths = small
    assert fitted.success
    assert len(fitted.runs) == 20
    assert [run.name for run in fitted.runs] == [f"r{i:02d}" for i in range(20)]
    pulls = []
    for name in FLUID:
        value, stderr = fitted.values(name)
        pulls.append((value - [truth[name] for truth in truths]) / stderr)
    # 80 correlated standard normal pulls: none beyond 4 (p = 0.005), mean square 1 within 4 of its deviations.
    assert np.abs(pulls).max() < 4
    assert abs(np.mean(np.square(pulls)) - 1) < 4 * np.sqrt(2 / 20)
    assert all(0.6 < run.redchi < 1.4 for run in fitted.runs)


def test_a_run_alone_gives_the_same(small, fitted):
    table, _ = small
    alone = plain_fit(OneMode(), table.select(table.run == "r07"), known=KNOWN)
    again = fitted.fit("r07")
    run = fitted.runs[7]
    assert run.attributes["inlet"] == "anti-swirl"
    assert run.attributes["speed_rpm"] == pytest.approx(table.speed[table.run == "r07"][0] * 30 / np.pi, abs=1e-6)
    for result in (alone, again):
        for name in FLUID:
            assert result.params[name].value == pytest.approx(run.params[name].value, rel=1e-9)
        np.testing.assert_allclose(result.covar, run.covar, rtol=1e-6)
    with refuses(KeyError):
        fitted.fit("r99")


def test_experiments_of_their_own(small, fitted):
    """One experiment a run, instead of one table; names that several files share are told apart."""
    table, _ = small
    tests = [replace(table.select(table.run == f"r{i:02d}"), source=f"file{i}") for i in range(4)]
    found = rf.campaign(OneMode(), tests, known=KNOWN, split=None)
    assert [run.name for run in found.runs] == ["file0", "file1", "file2", "file3"]
    assert found.runs[3].params["lam"].value == pytest.approx(fitted.runs[3].params["lam"].value, rel=1e-9)
    twice = [replace(test, run=np.full(len(test), "same")) for test in tests[:2]]
    assert [run.name for run in rf.campaign(OneMode(), twice, known=KNOWN).runs] == ["same (file0)", "same (file1)"]
    nameless = [replace(test, source="") for test in twice]
    assert [run.name for run in rf.campaign(OneMode(), nameless, known=KNOWN).runs] == ["same #1", "same #2"]


def test_split_by_another_attribute(small):
    """Forward and backward sweep are runs of their own in the file, one test in the campaign."""
    table, truths = small
    sense = np.where(table.frequency > 0, "fwd", "bwd")
    parted = replace(
        table, run=np.char.add(table.run, sense), attributes={**table.attributes, "test": table.run}
    ).select(np.isin(table.run, ["r00", "r01"]))
    found = rf.campaign(OneMode(), parted, known=KNOWN, split="test")
    assert [run.name for run in found.runs] == ["r00", "r01"]
    value, stderr = found.values("lam")
    assert np.all(np.abs(value - [truth["lam"] for truth in truths[:2]]) < 4 * stderr)


def test_a_hopeless_run_does_not_stop_the_others(small):
    table, _ = small
    response = table.response.copy()
    response[np.flatnonzero(table.run == "r03")[5]] = np.nan
    keep = ~((table.run == "r05") & (np.arange(len(table)) != np.flatnonzero(table.run == "r05")[0]))
    found = rf.campaign(OneMode(), replace(table, response=response).select(keep), known=KNOWN)
    assert not found.success
    bad = {run.name: run.message for run in found.runs if not run.params}
    assert set(bad) == {"r03", "r05"}
    assert "not finite" in bad["r03"]
    assert "unknowns" in bad["r05"]
    assert "r03" in found.summary()
    assert "not finite" in found.table()
    value, stderr = found.values("D")
    assert np.isnan(value[[3, 5]]).all()
    assert np.isfinite(np.delete(stderr, [3, 5])).all()
    assert sum(len(trend.runs) for trend in found.trends("D", against="pressure_psi", by="inlet")) == 18
    row = list(csv.DictReader(found.to_csv().splitlines()))[3]
    assert row["D"] == ""
    assert row["success"] == "False"


# ---- shared parameters --------------------------------------------------------------------------------------------


def test_shared_parameters_are_those_of_the_joint_fit(small):
    """Fitted run by run around a common mass, against one large problem with all parameters: the same numbers."""
    table, _ = small
    part = table.select(np.isin(table.run, [f"r{i:02d}" for i in range(6)]))
    known = {"K": 8000.0, "Ds": 8.0}
    found = rf.campaign(OneMode(), part, known=known, shared=["M"])
    joint = plain_fit(OneMode(), part, known=known, per=dict.fromkeys(FLUID, "run"))
    assert found.success
    assert found.shared["M"].value == pytest.approx(joint.params["M"].value, rel=1e-7)
    assert found.shared["M"].stderr == pytest.approx(joint.params["M"].stderr, rel=1e-4)
    for run in found.runs:
        assert "M" not in run.params
        for name in FLUID:
            other = joint.params[f"{name}[run={run.name}]"]
            assert abs(run.params[name].value - other.value) < 1e-4 * other.stderr
            # by the noise alone: a run's own share is as wide as its own redchi asks, the joint fit's as all readings'
            widest = np.sqrt(max(1.0, run.redchi))
            assert (1 - 1e-3) * other.stderr < run.params[name].stderr < (1 + 1e-3) * widest * other.stderr
    assert "shared M" in found.summary()
    value, stderr = found.values("M")
    assert np.ptp(value) == 0
    assert stderr[0] == found.shared["M"].stderr
    # The mass comes out of all runs better than of any one.
    alone = plain_fit(OneMode(), part.select(part.run == "r00"), known=known)
    assert found.shared["M"].stderr < 0.6 * alone.params["M"].stderr


def test_two_shared_parameters_and_a_robust_loss(small):
    table, _ = small
    part = table.select(np.isin(table.run, [f"r{i:02d}" for i in range(4)]))
    known = {"K": 8000.0, "Ds": 8.0}
    found = rf.campaign(OneMode(), part, known=known, shared=("M", "Mf"), loss="soft_l1")
    per = dict.fromkeys(("K0", "D", "lam"), "run")
    joint = plain_fit(OneMode(), part, known=known, per=per, loss="soft_l1")
    for name in ("M", "Mf"):
        assert abs(found.shared[name].value - joint.params[name].value) < 1e-3 * joint.params[name].stderr


def same_errors(found, joint):
    """Errors of a campaign against those of one large problem: the points differ by 1e-4 of an error at most, and the
    errors change with the point by less than that share of themselves."""
    for name, parameter in found.shared.items():
        for kind in ("stderr", "noise"):
            assert getattr(parameter, kind) == pytest.approx(getattr(joint.params[name], kind), rel=1e-3)
    places = [joint.var_names.index(name) for name in found.shared]
    np.testing.assert_allclose(found.shared_covar, joint.covar[np.ix_(places, places)], rtol=2e-3)


@pytest.mark.parametrize("loss", ["soft_l1", "huber", "cauchy"])
def test_errors_of_a_robust_loss_are_those_of_the_joint_fit(small, loss):
    """One reading in twenty thrown far off: a chi-squared over them would make the errors five times too large."""
    table, _ = small
    part = table.select(np.isin(table.run, [f"r{i:02d}" for i in range(6)]))
    rng = np.random.default_rng(5)
    thrown = rng.random(len(part)) < 0.05
    response = part.response * np.where(thrown, 1 + 0.6 * np.exp(2j * np.pi * rng.random(len(part))), 1.0)
    part = replace(part, response=response)
    known = {"K": 8000.0, "Ds": 8.0}
    found = rf.campaign(OneMode(), part, known=known, shared=("M", "Mf"), loss=loss)
    joint = plain_fit(OneMode(), part, known=known, per=dict.fromkeys(("K0", "D", "lam"), "run"), loss=loss)
    assert joint.redchi > 2  # what must not widen anything
    same_errors(found, joint)
    for run in found.runs:
        for name, parameter in run.params.items():
            other = joint.params.get(f"{name}[run={run.name}]")
            if other is not None:
                assert parameter.stderr == pytest.approx(other.stderr, rel=1e-3)


@pytest.mark.parametrize("priors", [{}, {"D": norm(500.0, 3.0)}])
def test_errors_of_a_model_that_does_not_fit_are_those_of_the_joint_fit(small, priors):
    """Without the fluid's mass the model misses the data; squares widen the readings' part, but not the priors'."""
    table, _ = small
    part = table.select(np.isin(table.run, [f"r{i:02d}" for i in range(4)]))
    known = {"K": 8000.0, "Ds": 8.0, "Mf": 0.0}
    found = rf.campaign(OneMode(), part, known=known, shared=("M",), priors=priors)
    per = dict.fromkeys(("K0", "D", "lam"), "run")
    joint = plain_fit(OneMode(), part, known=known, per=per, priors=priors)
    assert joint.redchi > 2
    same_errors(found, joint)


def test_a_shared_mass_settles_where_runs_scatter_more_than_their_data_show(small):
    """A force that jitters makes noise in proportion to the response: each run takes its readings with the noise that
    its residuals show. The shared mass is then that of one large problem with all readings so weighed, to a thousandth
    of its error: the noise found at the solution moves it by less."""
    table, _ = small
    part = table.select(np.isin(table.run, [f"r{i:02d}" for i in range(6)]))
    jitter = np.random.default_rng(3).normal(size=(2, len(part)))
    part = replace(
        part,
        speed=100.0 * 1.02 ** np.array([int(run[1:]) for run in part.run.tolist()]),  # runs at one speed share noise
        response=part.response * (1 + 0.03 * (jitter[0] + 1j * jitter[1])),
        sigma=np.full(len(part), np.nan),
    )
    known = {"K": 8000.0, "Ds": 8.0}
    found = rf.campaign(OneMode(), part, known=known, shared=["M"])
    assert found.success
    weighed = [run.noise for run in found.runs]
    assert sum(noise is not None for noise in weighed) >= 4
    problem = build_problem(OneMode(), part, FitSettings(known=known, per=dict.fromkeys(FLUID, "run")))
    block = problem.blocks[0]
    factor = np.ones(block.measured.size)
    for run, noise in zip(found.runs, weighed, strict=True):
        if noise is not None:
            factor[block.run == run.name] = noise.factors[0]
    problem = replace(problem, blocks=(block.with_noise(factor),))
    best = minimise(problem, find_start(problem, {}).x)
    joint = dict(zip(problem.space.names, best.x, strict=True))
    assert abs(found.shared["M"].value - joint["M"]) < 1e-3 * found.shared["M"].stderr
    for run in found.runs:
        for name in FLUID:
            assert abs(run.params[name].value - joint[f"{name}[run={run.name}]"]) < 1e-3 * run.params[name].stderr


def test_what_cannot_be_shared(small):
    table, _ = small
    model = OneMode()
    with refuses(ValueError):
        rf.campaign(model, table, known=KNOWN, shared=["M"])
    with refuses(ValueError):
        rf.campaign(model, table, known=KNOWN, shared=FLUID)
    with refuses(KeyError):
        rf.campaign(model, table, known=KNOWN, shared=["k0"])
    with refuses(ValueError):
        rf.campaign(model, table, known={"M": 1.2, "Ds": 8.0}, shared=["K"])  # K0 of each run takes it up
    with refuses(ValueError):
        rf.campaign(model, table, known=KNOWN, loss="cubic")
    with refuses(KeyError):
        rf.campaign(model, table, known=KNOWN, split="day")
    with refuses(KeyError):
        rf.campaign(model, table, known={"mass": 1.0})


# ---- trends -------------------------------------------------------------------------------------------------------


def by_a_walk(trend):
    """Covariance of NumPy's coefficients by a walk of the trend's step through its runs, about the walk's own mean."""
    steps = trend.step * np.tril(np.ones((trend.x.size, trend.x.size)))[np.argsort(np.argsort(trend.runs))]
    walked = steps - steps.mean(axis=0)
    moved = np.array([np.polyfit(trend.x, own, trend.degree, w=1 / trend.stderr) for own in walked.T])
    return moved.T @ moved


def test_trends_are_weighted_straight_lines(small, fitted):
    radial, anti = sorted(fitted.trends("lam", against="pressure_psi", by="inlet"), key=lambda t: t.group)[::-1]
    assert (radial.group, anti.group) == ("radial", "anti-swirl")
    coefficients, covariance = np.polyfit(anti.x, anti.value, 1, w=1 / anti.stderr, cov="unscaled")
    assert anti.slope.value == pytest.approx(coefficients[0], rel=1e-9)
    residual = (anti.value - np.polyval(coefficients, anti.x)) / anti.stderr
    scatter = float(np.sum(residual**2) / (anti.x.size - 2))
    assert anti.scatter == pytest.approx(scatter, rel=1e-6)
    widening = max(1.0, scatter)
    covariance = covariance * widening + by_a_walk(anti)
    assert anti.slope.stderr == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-6)
    at = np.array([40.0, 1.0])
    assert anti.at(40.0).stderr == pytest.approx(np.sqrt(at @ covariance @ at), rel=1e-6)
    # The truth of the seal.
    assert abs(anti.slope.value + 0.002) < 4 * anti.slope.stderr
    assert abs(radial.slope.value) < 4 * radial.slope.stderr
    gap = radial.at(40.0).value - anti.at(40.0).value
    assert gap == pytest.approx(0.45 - (0.30 - 0.08), abs=4 * np.hypot(radial.at(40.0).stderr, anti.at(40.0).stderr))
    text = fitted.summary(against="pressure_psi", by="inlet")
    assert "radial - anti-swirl at pressure_psi" in text
    assert "20 of 20 runs fitted" in text


def test_default_trends_and_single_conditions(small, fitted):
    every = fitted.trends(against="pressure_psi")
    assert [trend.parameter for trend in every] == ["K0", "lam", "D"]
    assert all(trend.group == "" and len(trend.runs) == 20 for trend in every)
    # lam depends on the inlet, not only on the pressure: the line does not explain it.
    assert every[1].scatter > 100
    table, _ = small
    one = rf.campaign(OneMode(), table.select(table.run == "r00"), known=KNOWN)
    (trend,) = one.trends("D", against="pressure_psi")
    assert np.isnan(trend.slope.value)
    assert trend.at(0.0).value == pytest.approx(one.runs[0].params["D"].value, rel=1e-12)
    assert "one condition" in one.summary(against="pressure_psi")


def test_conditions_that_are_not_known_or_change_within_a_run_are_told(small):
    table, _ = small
    pressure = table.attributes["pressure_psi"].copy()
    pressure[table.run == "r00"] = np.nan
    pressure[np.flatnonzero(table.run == "r01")[::2]] += 50.0
    odd = replace(table, attributes={**table.attributes, "pressure_psi": pressure})
    found = rf.campaign(OneMode(), odd, known=KNOWN)
    told = found.condition_remarks("pressure_psi")
    assert told[0] == "pressure_psi is not known in r00; left out of its trends"
    assert told[1].startswith("pressure_psi changed within r01, ")
    assert len(told) == 2
    assert all(sentence in found.summary(against="pressure_psi") for sentence in told)
    assert rf.campaign(OneMode(), table, known=KNOWN).condition_remarks("pressure_psi") == []


def test_wrong_words_for_trends(fitted):
    with refuses(KeyError):
        fitted.trends(against="pressure")
    with refuses(ValueError):
        fitted.trends(against="inlet")
    with refuses(KeyError):
        fitted.trends("M", against="pressure_psi")


def test_plot_shows_every_run_with_its_error(fitted):
    figure = fitted.plot.trends(against="pressure_psi", by="inlet")
    assert [axis.get_ylabel() for axis in figure.axes] == ["K0, kN/m", "lam", "D, N s/m"]
    assert figure.axes[-1].get_xlabel() == "pressure_psi"
    drawn = sum(len(container[0].get_xdata()) for container in figure.axes[1].containers)
    assert drawn == 20
    assert all({"radial", "anti-swirl"} == {text.get_text() for text in axis.texts} for axis in figure.axes)
    assert "Weighted lines, with one standard error" in " ".join(text.get_text() for text in figure.texts)
    assert faults_of(figure) == []
    heights = np.concatenate([container[0].get_ydata() for container in figure.axes[0].containers])
    np.testing.assert_allclose(np.sort(heights), np.sort(fitted.values("K0")[0] / 1000))


# ---- runs that do not go with the others --------------------------------------------------------------------------


def spoiled(table, run, **factors):
    return replace(table, **{name: np.where(table.run == run, f * getattr(table, name), getattr(table, name))
                             for name, f in factors.items()})  # fmt: skip


def test_a_run_of_other_units_or_speed_is_named(small):
    """Forces ten times as large, and a speed label of another run, leave single runs that pull a line along."""
    table, _ = small
    radial = replace(spoiled(table, "r04", force=10.0), attributes=dict(table.attributes))
    found = rf.campaign(OneMode(), spoiled(radial, "r08", speed=1.5), known=KNOWN)
    by_name = {(t.parameter, t.group): t.far for t in found.trends(against="pressure_psi", by="inlet")}
    assert by_name[("D", "radial")] == ("r04",)
    assert by_name[("lam", "radial")] == ("r08",)
    assert by_name[("lam", "anti-swirl")] == ()
    text = found.summary(against="pressure_psi", by="inlet")
    assert "far from the line of the others with radial: r04" in text
    assert "redchi is above 2, more than noise: r04 (" in text


def test_no_run_is_far_where_a_trend_bends(fitted):
    """K0 that goes with the square of the pressure scatters about any line, yet no run is at fault."""
    runs = [
        replace(run, params=run.params | {"K0": replace(run.params["K0"], value=run.attributes["pressure_psi"] ** 2)})
        for run in fitted.runs
    ]
    (trend,) = replace(fitted, runs=tuple(runs)).trends("K0", against="pressure_psi")
    assert trend.scatter > 100
    assert trend.far == ()


def test_trends_of_good_runs_name_none(fitted):
    assert all(t.far == () for t in fitted.trends(against="pressure_psi", by="inlet"))
    assert "far from" not in fitted.summary(against="pressure_psi", by="inlet")
    assert "more than noise" not in fitted.summary()


# ---- curved trends ------------------------------------------------------------------------------------------------


def test_curved_trends_are_weighted_polynomials(fitted):
    """Coefficients in powers of the pressure itself, as NumPy fits them."""
    for trend in fitted.trends(["K0", "D"], against="pressure_psi", by="inlet", degree=3):
        powers, covariance = np.polyfit(trend.x, trend.value, 3, w=1 / trend.stderr, cov="unscaled")
        residual = (trend.value - np.polyval(powers, trend.x)) / trend.stderr
        scatter = float(np.sum(residual**2) / (trend.x.size - 4))
        covariance = covariance * max(1.0, scatter) + by_a_walk(trend)
        errors = np.sqrt(np.diag(covariance))
        assert trend.degree == 3
        assert trend.scatter == pytest.approx(scatter, rel=1e-6)
        assert [c.value for c in trend.coefficients] == pytest.approx(powers[::-1], abs=1e-6 * errors[::-1].min())
        assert [c.stderr for c in trend.coefficients] == pytest.approx(errors[::-1], rel=1e-6)
        basis = 40.0 ** np.arange(3, -1, -1)
        assert trend.at(40.0).value == pytest.approx(np.polyval(powers, 40.0), rel=1e-9)
        assert trend.at(40.0).stderr == pytest.approx(np.sqrt(basis @ covariance @ basis), rel=1e-6)
        step = (trend.at(trend._centre + 1e-3).value - trend.at(trend._centre - 1e-3).value) / 2e-3
        assert trend.slope.value == pytest.approx(step, rel=1e-5)
    units = [c.unit for c in trend.coefficients]
    assert units == ["N s/m", *(f"N s/m per pressure_psi{power}" for power in ("", "^2", "^3"))]
    text = fitted.summary("D", against="pressure_psi", by="inlet", degree=2)
    assert "radial: D = " in text
    assert ") pressure_psi^2" in text


def test_intervals_of_a_curved_trend_hold(fitted):
    """K0 grows with the flow squared: 95 % intervals of the curve, between the runs and of its leading coefficient."""
    rng, draws = np.random.default_rng(8), 400
    flow = np.linspace(2.0, 12.0, len(fitted.runs))
    error = 200.0 * rng.uniform(0.5, 2.0, flow.size)
    held = {"at": 0, "square": 0}
    bent = 0
    for _ in range(draws):
        value = 3000.0 + 80.0 * flow**2 + error * rng.normal(size=flow.size)
        runs = []
        for run, q, k, e in zip(fitted.runs, flow, value, error, strict=True):
            K0 = replace(run.params["K0"], value=float(k), stderr=float(e))
            runs.append(replace(run, attributes={"flow": float(q)}, params={**run.params, "K0": K0}))
        changed = replace(fitted, runs=tuple(runs))
        (curve,) = changed.trends("K0", against="flow", degree=2)
        at, square = curve.at(7.0), curve.coefficients[2]
        held["at"] += abs(at.value - (3000.0 + 80.0 * 49.0)) < 1.96 * at.stderr
        held["square"] += abs(square.value - 80.0) < 1.96 * square.stderr
        (line,) = changed.trends("K0", against="flow")
        bent += line.scatter > 2.0
    # Three binomial deviations below 95 %; above it errors are widened where the runs scatter by chance.
    assert min(held.values()) > draws * (0.95 - 3 * np.sqrt(0.95 * 0.05 / draws)), held
    assert max(held.values()) < draws * 0.995
    assert bent == draws


@pytest.mark.parametrize(("step", "least"), [(0.0, 0.95), (0.3, 0.8), (1.0, 0.8), (3.0, 0.8)])
def test_slopes_of_what_wanders_from_run_to_run_hold(fitted, step, least):
    """Runs in the order of the condition; D wanders by a share of its error a run: the line alone held 30 in 100 at
    three errors a run. Of 200 draws, at most three binomial deviations fewer."""
    rng, draws, held = np.random.default_rng(11), 200, 0
    error = 4.0 * rng.uniform(0.7, 1.4, len(fitted.runs))
    for _ in range(draws):
        walked = 4.0 * step * np.cumsum(rng.normal(size=error.size))
        value = 400.0 + walked + error * rng.normal(size=error.size)
        runs = []
        for number, (run, k, e) in enumerate(zip(fitted.runs, value, error, strict=True)):
            D = replace(run.params["D"], value=float(k), stderr=float(e))
            runs.append(replace(run, attributes={"hours": float(number)}, params={**run.params, "D": D}))
        (trend,) = replace(fitted, runs=tuple(runs)).trends("D", against="hours")
        held += abs(trend.slope.value) < 1.96 * trend.slope.stderr
    assert held > draws * (least - 3 * np.sqrt(least * (1 - least) / draws)), held


def test_curves_in_several_conditions(fitted):
    """K0 with the square of the flow and a straight line of the temperature: one surface, two panels."""
    rng = np.random.default_rng(5)
    flow, oil = rng.uniform(2, 12, 20), rng.uniform(30, 60, 20)
    runs = []
    for run, q, t in zip(fitted.runs, flow, oil, strict=True):
        K0 = replace(run.params["K0"], value=float(3000 + 80 * q**2 - 12 * t), stderr=100.0)
        runs.append(replace(run, attributes={"flow": float(q), "oil_C": float(t)}, params={**run.params, "K0": K0}))
    by_flow, by_oil = replace(fitted, runs=tuple(runs)).trends("K0", against=("flow", "oil_C"), degree=2)
    assert [c.value for c in by_flow.coefficients] == pytest.approx([3000 - 12 * oil.mean(), 0.0, 80.0], abs=1e-6)
    assert [c.value for c in by_oil.coefficients][1:] == pytest.approx([-12.0, 0.0], abs=1e-6)
    np.testing.assert_allclose(by_flow.value, [by_flow.at(q).value for q in by_flow.x], rtol=1e-9)


def test_too_few_conditions_for_a_curve(small, fitted):
    table, _ = small
    pair = rf.campaign(OneMode(), table.select(np.isin(table.run, ["r00", "r02"])), known=KNOWN)
    with refuses(ValueError):
        pair.trends("D", against="pressure_psi", degree=2)
    with refuses(ValueError):
        fitted.trends("D", against="pressure_psi", degree=0)
    told = " ".join(text.get_text() for text in fitted.plot.trends(against="pressure_psi", degree=2).texts)
    assert "polynomials of degree 2" in told


def test_the_table_of_many_runs_looks_at_each_a_few_times(small):
    """A hundred thousand runs took an hour where each row looked at all runs."""

    class Counted(dict):
        looks = 0

        def __iter__(self):
            Counted.looks += 1
            return super().__iter__()

    found = rf.campaign(OneMode(), small[0], known=KNOWN)
    runs = [replace(run, attributes=Counted(run.attributes)) for run in found.runs]
    many = replace(found, runs=tuple(runs * 20))
    assert len(many.to_csv().splitlines()) == 1 + len(many.runs)
    many.table()
    assert Counted.looks <= 2 * len(many.runs)


def test_an_attribute_keeps_its_last_digit() -> None:
    from dataclasses import replace

    from rotorfit.studies.campaigns.runs import conditions

    test = rf.datasets.rig_open()
    told = replace(test, attributes={"oil_C": np.full(len(test), 16.49)})
    assert conditions(told)["oil_C"] == 16.49


def test_runs_that_lack_a_probe_lack_its_gain_alone(tmp_path):
    """A modal model has no gain of a probe that was not there: one run of three has that of de y."""
    w, noise, rng = np.linspace(60.0, 480.0, 40), 2e-8, np.random.default_rng(3)
    gains = {("de", "x"): 1.0, ("de", "y"): -1j, ("nde", "x"): -0.7}
    tests = []
    for number, probes in enumerate((list(gains), [("de", "x"), ("nde", "x")], [("de", "x"), ("nde", "x")])):
        motion = 2e-4 * w**2 / (40.0 * (300.0**2 - w**2 + 30j * w))
        read = np.concatenate([gains[probe] * motion for probe in probes])
        error = noise * (rng.normal(size=read.size) + 1j * rng.normal(size=read.size))
        speed = np.tile(w, len(probes))
        plane, axis = (np.repeat(own, w.size) for own in zip(*probes, strict=True))
        tests.append(
            rf.PerturbationTest(
                run=np.full(read.size, f"run {number}"), speed=speed, frequency=speed,
                force_plane=np.full(read.size, "A"), force=2e-4 * speed**2 + 0j, plane=plane, direction=axis,
                response=read + error, sigma=np.full(read.size, noise), source=f"{number}.csv",
            )
        )  # fmt: skip
    found = rf.campaign(rf.models.Modal(("de", "nde", "A"), force_planes=("A",), residuals=False), tests)
    value, stderr = found.values("g_nde_x")
    assert np.all(np.abs(value + 0.7) < 4 * stderr)
    assert np.isfinite(found.values("g_de_y")[0]).tolist() == [True, False, False]
    lines = found.table().splitlines()
    assert len(lines[1].split()) == len(lines[2].split()) + 4
    assert found.unit("g_de_y") == "1"
