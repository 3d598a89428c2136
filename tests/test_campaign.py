"""Campaigns: run by run, with shared parameters, over executors that lose workers, and their trends."""

from __future__ import annotations

import csv
import json
import logging
import os
import pickle
import signal
import warnings
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest
from scipy.stats import norm
from synthetic import circular_test

import rotorfit as rf
from rotorfit.campaigns import runs
from rotorfit.cli.main import main
from rotorfit.data.experiments import PerturbationTest
from rotorfit.estimators.minimisation.least_squares import minimise
from rotorfit.estimators.starting.starts import start_vector
from rotorfit.fitting.problem_setup import build_problem
from rotorfit.fitting.settings import FitSettings
from rotorfit.models import OneMode

KNOWN = {"M": 1.2, "K": 8000.0, "Ds": 8.0}
FLUID = ("K0", "D", "lam", "Mf")


def truth_at(pressure, inlet):
    """The seal of the tests: stiffness and damping rise with pressure, an anti-swirl inlet lowers lam."""
    swirl = 0.45 if inlet == "radial" else 0.30 - 0.002 * pressure
    return KNOWN | {"K0": 2000.0 + 150.0 * pressure, "D": 300.0 + 4.0 * pressure, "lam": swirl, "Mf": 0.4}


def seal_campaign(runs, lines=100, noise=0.01, seed=0):
    """One table of runs at pressures of 3 to 80 psi, radial and anti-swirl inlets in turn, and the true values."""
    model, rng = OneMode(), np.random.default_rng(seed)
    half = np.linspace(2.0, 300.0, lines // 2)
    frequency = np.concatenate([-half[::-1], half])
    parts, truths = [], []
    for number in range(runs):
        pressure, inlet = float(rng.uniform(3, 80)), ("radial", "anti-swirl")[number % 2]
        truths.append(truth_at(pressure, inlet))
        test = circular_test(
            model, model.vector(truths[-1]), speeds=(100.0 + rng.normal(),), frequency=frequency, noise=noise,
            seed=1000 * seed + number, sigma_known=True,
        )  # fmt: skip
        count = len(test)
        attributes = {"pressure_psi": np.full(count, pressure), "inlet": np.full(count, inlet)}
        parts.append(replace(test, run=np.full(count, f"r{number:02d}"), attributes=attributes))
    return joined(parts), truths


def joined(parts):
    names = ("run", "speed", "frequency", "force_plane", "force", "plane", "direction", "response", "sigma")
    columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    attributes = {name: np.concatenate([part.attributes[name] for part in parts]) for name in parts[0].attributes}
    return PerturbationTest(**columns, attributes=attributes, source="seal.csv")


@pytest.fixture(scope="module")
def small():
    return seal_campaign(20)


@pytest.fixture(scope="module")
def fitted(small):
    return rf.campaign(OneMode(), small[0], known=KNOWN)


def same_fits(one, other):
    assert [run.name for run in one.runs] == [run.name for run in other.runs]
    for a, b in zip(one.runs, other.runs, strict=True):
        assert a.attributes == b.attributes
        for name in FLUID:
            assert a.params[name].value == pytest.approx(b.params[name].value, rel=1e-9)
            assert a.params[name].stderr == pytest.approx(b.params[name].stderr, rel=1e-6)


# ---- run by run -------------------------------------------------------------------------------------------------


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
    alone = rf.fit(OneMode(), table.select(table.run == "r07"), known=KNOWN)
    again = fitted.fit("r07")
    run = fitted.runs[7]
    assert run.attributes["inlet"] == "anti-swirl"
    assert run.attributes["speed_rpm"] == pytest.approx(table.speed[table.run == "r07"][0] * 30 / np.pi, abs=1e-6)
    for result in (alone, again):
        for name in FLUID:
            assert result.params[name].value == pytest.approx(run.params[name].value, rel=1e-9)
        np.testing.assert_allclose(result.covar, run.covar, rtol=1e-6)
    with pytest.raises(KeyError, match="unknown run of the campaign"):
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
    joint = rf.fit(OneMode(), part, known=known, per=dict.fromkeys(FLUID, "run"))
    assert found.success
    assert found.shared["M"].value == pytest.approx(joint.params["M"].value, rel=1e-7)
    assert found.shared["M"].stderr_noise == pytest.approx(joint.params["M"].stderr_noise, rel=1e-4)
    for run in found.runs:
        assert "M" not in run.params
        for name in FLUID:
            other = joint.params[f"{name}[run={run.name}]"]
            assert abs(run.params[name].value - other.value) < 1e-4 * other.stderr
            assert run.params[name].stderr_noise == pytest.approx(other.stderr_noise, rel=1e-3)
    assert "shared M" in found.summary()
    value, stderr = found.values("M")
    assert np.ptp(value) == 0
    assert stderr[0] == found.shared["M"].stderr
    # The mass comes out of all runs better than of any one.
    alone = rf.fit(OneMode(), part.select(part.run == "r00"), known=known)
    assert found.shared["M"].stderr < 0.6 * alone.params["M"].stderr


def test_two_shared_parameters_and_a_robust_loss(small):
    table, _ = small
    part = table.select(np.isin(table.run, [f"r{i:02d}" for i in range(4)]))
    known = {"K": 8000.0, "Ds": 8.0}
    found = rf.campaign(OneMode(), part, known=known, shared=("M", "Mf"), loss="soft_l1")
    per = dict.fromkeys(("K0", "D", "lam"), "run")
    joint = rf.fit(OneMode(), part, known=known, per=per, loss="soft_l1")
    for name in ("M", "Mf"):
        assert abs(found.shared[name].value - joint.params[name].value) < 1e-3 * joint.params[name].stderr


def same_errors(found, joint):
    """Errors of a campaign against those of one large problem: the points differ by 1e-4 of an error at most, and the
    errors change with the point by less than that share of themselves."""
    for name, parameter in found.shared.items():
        for kind in ("stderr", "stderr_noise"):
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
    joint = rf.fit(OneMode(), part, known=known, per=dict.fromkeys(("K0", "D", "lam"), "run"), loss=loss)
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
    joint = rf.fit(OneMode(), part, known=known, per=per, priors=priors)
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
        part, response=part.response * (1 + 0.03 * (jitter[0] + 1j * jitter[1])), sigma=np.full(len(part), np.nan)
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
    best = minimise(problem, start_vector(problem, {})[0])
    joint = dict(zip(problem.space.names, best.x, strict=True))
    assert abs(found.shared["M"].value - joint["M"]) < 1e-3 * found.shared["M"].stderr
    for run in found.runs:
        for name in FLUID:
            assert abs(run.params[name].value - joint[f"{name}[run={run.name}]"]) < 1e-3 * run.params[name].stderr


def test_what_cannot_be_shared(small):
    table, _ = small
    model = OneMode()
    with pytest.raises(ValueError, match="cannot be known and shared"):
        rf.campaign(model, table, known=KNOWN, shared=["M"])
    with pytest.raises(ValueError, match="joint fit"):
        rf.campaign(model, table, known=KNOWN, shared=FLUID)
    with pytest.raises(KeyError, match="did you mean 'K0'"):
        rf.campaign(model, table, known=KNOWN, shared=["k0"])
    with pytest.raises(ValueError, match="do not determine the shared K"):
        rf.campaign(model, table, known={"M": 1.2, "Ds": 8.0}, shared=["K"])  # K0 of each run takes it up
    with pytest.raises(ValueError, match="unknown loss"):
        rf.campaign(model, table, known=KNOWN, loss="cubic")
    with pytest.raises(KeyError, match="no attribute 'day'"):
        rf.campaign(model, table, known=KNOWN, split="day")
    with pytest.raises(KeyError, match="unknown parameter"):
        rf.campaign(model, table, known={"mass": 1.0})


# ---- executors ----------------------------------------------------------------------------------------------------


def test_threads_and_processes(small, fitted):
    table, _ = small
    with ThreadPoolExecutor(2) as pool:
        same_fits(rf.campaign(OneMode(), table, known=KNOWN, executor=pool), fitted)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        seen = []
        found = rf.campaign(OneMode(), table, known=KNOWN, executor=pool, progress=lambda *n: seen.append(n))
        same_fits(found, fitted)
        assert seen[-1] == (20, 20)
        known = {"K": 8000.0, "Ds": 8.0}
        here = rf.campaign(OneMode(), table, known=known, shared=["M"])
        there = rf.campaign(OneMode(), table, known=known, shared=["M"], executor=pool)
        assert there.shared["M"].value == pytest.approx(here.shared["M"].value, rel=1e-9)


def test_a_killed_process_loses_no_run(small, monkeypatch):
    """A broken process pool takes no more work: what is left is fitted here.

    Runs are thin and sent one by one, so that three of them fit into a pipe: the pool of Pythons as old as 3.11.2 waits
    for ever where its worker dies while an item is written that does not.
    """
    table, _ = small
    thin = table.select(np.isin(table.frequency, np.unique(table.frequency)[::12]))
    monkeypatch.setattr(runs, "_BATCH", 1)
    assert 3 * len(pickle.dumps(thin.select(thin.run == thin.runs[0]))) < 2**16 - 2**13  # and the model beside each
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:

        def kill_once(done, total):
            for process in list((pool._processes or {}).values()):
                process.kill()

        found = rf.campaign(OneMode(), thin, known=KNOWN, executor=pool, progress=kill_once)
    same_fits(found, rf.campaign(OneMode(), thin, known=KNOWN))


class Unreliable(Executor):
    """Loses the first attempts at every batch."""

    def __init__(self, losses):
        self.losses, self.attempts = losses, 0

    def submit(self, fn, /, *args, **kwargs):
        self.attempts += 1
        future = Future()
        if self.attempts <= self.losses:
            future.set_exception(OSError("worker lost"))
        else:
            future.set_result(fn(*args, **kwargs))
        return future


@pytest.mark.parametrize("losses", [2, 1000])
def test_lost_batches_are_sent_again_and_done_here_in_the_end(small, fitted, losses):
    pool = Unreliable(losses)
    same_fits(rf.campaign(OneMode(), small[0], known=KNOWN, executor=pool), fitted)
    assert pool.attempts == (3 + 2 if losses == 2 else 3 * 3)


def test_an_error_of_the_work_itself_is_shown(small):
    class Broken(OneMode):
        def __reduce__(self):
            return Broken, ()

        def equation(self, p, speed, eccentricity):
            raise RuntimeError("no such equation")

    with ThreadPoolExecutor(1) as pool, pytest.raises(ValueError, match="class in a module of its own"):
        rf.campaign(Broken(), small[0], known=KNOWN, executor=pool)
    with pytest.raises(RuntimeError, match="no such equation"):
        rf.campaign(Broken(), small[0], known=KNOWN)


def test_dask_cluster_that_loses_a_worker(small, fitted):
    """A real local cluster of the distributed package, one of its two worker processes killed half way."""
    table, _ = small
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the cluster itself
        from distributed import Client, LocalCluster

        options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "silence_logs": logging.CRITICAL}
        with LocalCluster(**options) as cluster, Client(cluster) as client:
            pool = client.get_executor()
            same_fits(rf.campaign(OneMode(), table, known=KNOWN, executor=pool), fitted)
            killed = []

            def kill_one(done, total):
                if not killed:
                    killed.append(next(iter(cluster.workers.values())).pid)
                    os.kill(killed[0], signal.SIGKILL)

            found = rf.campaign(OneMode(), table, known=KNOWN, executor=pool, progress=kill_one)
            assert killed
            same_fits(found, fitted)


# ---- trends -------------------------------------------------------------------------------------------------------


def test_trends_are_weighted_straight_lines(small, fitted):
    radial, anti = sorted(fitted.trends("lam", against="pressure_psi", by="inlet"), key=lambda t: t.group)[::-1]
    assert (radial.group, anti.group) == ("radial", "anti-swirl")
    coefficients, covariance = np.polyfit(anti.x, anti.value, 1, w=1 / anti.stderr, cov="unscaled")
    assert anti.slope.value == pytest.approx(coefficients[0], rel=1e-9)
    residual = (anti.value - np.polyval(coefficients, anti.x)) / anti.stderr
    scatter = float(np.sum(residual**2) / (anti.x.size - 2))
    assert anti.scatter == pytest.approx(scatter, rel=1e-6)
    widening = max(1.0, scatter)
    assert anti.slope.stderr == pytest.approx(np.sqrt(covariance[0, 0] * widening), rel=1e-6)
    at = np.array([40.0, 1.0])
    assert anti.at(40.0).stderr == pytest.approx(np.sqrt(at @ covariance @ at * widening), rel=1e-6)
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


def test_wrong_words_for_trends(fitted):
    with pytest.raises(KeyError, match=r"unknown attribute of the runs 'pressure', did you mean 'pressure_psi'"):
        fitted.trends(against="pressure")
    with pytest.raises(ValueError, match="inlet holds text"):
        fitted.trends(against="inlet")
    with pytest.raises(KeyError, match="unknown parameter fitted run by run 'M'"):
        fitted.trends("M", against="pressure_psi")


def test_plot_shows_every_run_with_its_error(fitted):
    figure = fitted.plot_trends(against="pressure_psi", by="inlet")
    assert [axis.get_ylabel() for axis in figure.axes] == ["K0 (kN/m)", "lam", "D (N s/m)"]
    assert figure.axes[-1].get_xlabel() == "pressure_psi"
    drawn = sum(len(container[0].get_xdata()) for container in figure.axes[1].containers)
    assert drawn == 20
    assert {text.get_text() for text in figure.legends[0].get_texts()} == {
        "inlet radial", "inlet anti-swirl", "line ± 1 standard error", "runs ± 1 standard error",
    }  # fmt: skip
    heights = np.concatenate([container[0].get_ydata() for container in figure.axes[0].containers])
    np.testing.assert_allclose(np.sort(heights), np.sort(fitted.values("K0")[0] / 1000))


# ---- command line -------------------------------------------------------------------------------------------------


def test_command_line(tmp_path, capsys, small, fitted):
    table, _ = small
    file, out = tmp_path / "seal.csv", tmp_path / "results"
    rf.write(table, file)
    words = ["campaign", str(file), "--model", "one-mode", "--known", "M=1.2,K=8000,Ds=8"]
    words += ["--against", "pressure_psi", "--by", "inlet"]
    assert main([*words, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "radial - anti-swirl at pressure_psi" in printed
    assert {path.name for path in out.iterdir()} == {"runs.csv", "summary.txt", "report.html", "trends.png"}
    rows = list(csv.DictReader((out / "runs.csv").read_text().splitlines()))
    assert [row["run"] for row in rows] == [run.name for run in fitted.runs]
    for row, run in zip(rows, fitted.runs, strict=True):
        # The file holds rounded readings.
        assert float(row["lam"]) == pytest.approx(run.params["lam"].value, abs=0.05 * run.params["lam"].stderr)
    assert main([*words, "--json", "--follow", "lam"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert len(result["runs"]) == 20
    assert [trend["group"] for trend in result["trends"]] == ["anti-swirl", "radial"]
    shared = ["campaign", str(file), "--model", "one-mode", "--known", "K=8000,Ds=8", "--shared", "M", "--quiet"]
    assert main(shared) == 0
    assert capsys.readouterr().out == ""
    assert main([*words, "--jobs", "2", "--quiet"]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--against", "pressure"], "did you mean 'pressure_psi'"),
        (["--by", "inlet"], "say --against what"),
        (["--shared", "M", "--against", "inlet"], "M cannot be known and shared"),
        (["--split", "day"], "no attribute 'day'"),
        (["--jobs", "0"], "--jobs takes a number of processes"),
    ],
)
def test_command_line_mistakes(tmp_path, capsys, small, words, message):
    file = tmp_path / "seal.csv"
    rf.write(small[0].select(small[0].run == "r00"), file)
    assert main(["campaign", str(file), "--model", "one-mode", "--known", "M=1.2,K=8000,Ds=8", *words]) == 2
    assert message in capsys.readouterr().err


def test_no_run_that_can_be_fitted_is_bad_input(tmp_path, capsys, small):
    """Planes of another name spoil every run alike: the reason is said, and nothing is written."""
    file, out = tmp_path / "seal.csv", tmp_path / "results"
    rf.write(small[0].select(np.isin(small[0].run, ["r00", "r01"])), file)
    words = ["campaign", str(file), "--model", "one-mode", "--planes", "seal", "--against", "pressure_psi"]
    assert main([*words, "--known", "M=1.2,K=8000,Ds=8", "--out", str(out)]) == 2
    assert "no run of the campaign can be fitted" in capsys.readouterr().err
    assert not out.exists()


def test_trends_that_no_run_resolves_leave_no_picture(tmp_path, capsys, small):
    """With K free only K + K0 is seen: K0 has no value in any run."""
    file, out = tmp_path / "seal.csv", tmp_path / "results"
    rf.write(small[0].select(np.isin(small[0].run, ["r00", "r01"])), file)
    words = ["campaign", str(file), "--model", "one-mode", "--known", "M=1.2,Ds=8", "--against", "pressure_psi"]
    assert main([*words, "--follow", "K0", "--out", str(out)]) == 0
    assert "no run has a resolved value" in capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {"runs.csv", "summary.txt", "report.html"}


def test_command_line_tells_of_failed_runs(tmp_path, capsys, small):
    table, _ = small
    keep = ~((table.run == "r01") & (np.arange(len(table)) > np.flatnonzero(table.run == "r01")[0]))
    file = tmp_path / "seal.csv"
    rf.write(table.select(keep & np.isin(table.run, ["r00", "r01"])), file)
    assert main(["campaign", str(file), "--model", "one-mode", "--known", "M=1.2,K=8000,Ds=8"]) == 1
    assert "1 of 2 runs did not converge: r01" in capsys.readouterr().err


# ---- runs that say nothing, several conditions, the report ----------------------------------------------------------


def with_a_dead_run(table):
    """The first run's readings replaced by noise of the size that its sigma says."""
    rng = np.random.default_rng(5)
    dead = table.run == "r00"
    noise = table.sigma * (rng.normal(size=len(table)) + 1j * rng.normal(size=len(table)))
    return replace(table, response=np.where(dead, noise, table.response))


def test_a_dead_run_is_flagged_and_flattens_nothing(tmp_path, capsys, small, fitted):
    """A probe that was not connected gave D = -6759 beside 300 to 620 N s/m, and a figure of one point and a line."""
    table, _ = small
    found = rf.campaign(OneMode(), with_a_dead_run(table), known=KNOWN)
    assert [run.name for run in found.runs if run.silent] == ["r00"]
    assert not any(run.silent for run in fitted.runs)
    assert "r00: says nothing" in found.summary()
    assert all("r00" not in trend.runs for trend in found.trends(against="pressure_psi"))
    axis = found.plot_trends("D", against="pressure_psi").axes[0]
    assert 200 < axis.get_ylim()[0] < axis.get_ylim()[1] < 800
    file = tmp_path / "seal.csv"
    rf.write(with_a_dead_run(table), file)
    main(["campaign", str(file), "--model", "one-mode", "--known", "M=1.2,K=8000,Ds=8"])
    assert "say nothing: r00" in capsys.readouterr().err


def test_noise_is_told_from_motion_whatever_the_seed():
    """Fifteen dead runs, and fifteen forced so weakly that the rms reading is only four times its noise."""
    model = OneMode()
    theta = model.vector(truth_at(40.0, "radial"))
    half = np.linspace(2.0, 300.0, 50)
    w = np.r_[-half[::-1], half]
    test = circular_test(model, theta, speeds=(100.0,), frequency=w, sigma_known=True, noise=0.01)
    scale = 1 / np.sqrt(np.mean(np.abs(test.response / test.sigma) ** 2))
    flagged = {"dead": 0, "weak": 0}
    for seed in range(15):
        rng = np.random.default_rng(seed)
        noise = test.sigma * (rng.normal(size=len(test)) + 1j * rng.normal(size=len(test)))
        for name, size in (("dead", 0.0), ("weak", 4.0)):
            run = replace(test, response=noise + size * scale * test.response, force=4 * scale * test.force)
            flagged[name] += rf.campaign(OneMode(), run, known=KNOWN).runs[0].silent
    # By chance, chi-squared falls by 1 to 5 a parameter; by signals of the noise's own size, which a search from a
    # start of noise does not always find, by some 50; by these, by 800.
    assert flagged == {"dead": 15, "weak": 0}


def test_two_conditions_are_told_apart():
    """D rises with pressure and falls with temperature, which rises with it: alone, either slope is wrong."""
    model, rng = OneMode(), np.random.default_rng(2)
    half = np.linspace(2.0, 300.0, 30)
    w = np.r_[-half[::-1], half]
    parts = []
    for number in range(14):
        pressure = float(rng.uniform(5, 80))
        oil = 25.0 + 0.3 * pressure + rng.normal(0, 5)
        values = KNOWN | {"K0": 4000.0, "D": 500.0 + 4 * pressure - 6 * oil, "lam": 0.45, "Mf": 0.4}
        test = circular_test(
            model, model.vector(values), speeds=(100.0,), frequency=w, noise=0.01, seed=number, sigma_known=True
        )
        count = len(test)
        attributes = {"pressure_psi": np.full(count, pressure), "oil_C": np.full(count, oil)}
        parts.append(replace(test, run=np.full(count, f"r{number:02d}"), attributes=attributes))
    found = rf.campaign(OneMode(), joined(parts), known=KNOWN)
    pressure, oil = found.trends("D", against=("pressure_psi", "oil_C"))
    assert abs(pressure.slope.value - 4) < 4 * pressure.slope.stderr < 1
    assert abs(oil.slope.value + 6) < 4 * oil.slope.stderr < 2
    (alone,) = found.trends("D", against="pressure_psi")
    assert abs(alone.slope.value - 4) > 5 * pressure.slope.stderr
    # The points of a panel are what is left for its attribute: they lie on its line.
    assert pressure.scatter < 3
    line = np.array([pressure.at(x).value for x in pressure.x])
    assert np.sqrt(np.mean(((pressure.value - line) / pressure.stderr) ** 2)) < 2
    assert "each with the others held" in found.summary("D", against=["pressure_psi", "oil_C"])
    assert len(found.plot_trends(["D", "lam"], against=["pressure_psi", "oil_C"]).axes) == 4
    with pytest.raises(ValueError, match="do not tell pressure_psi, oil_C apart"):
        rf.campaign(OneMode(), joined(parts[:2]), known=KNOWN).trends("D", against=("pressure_psi", "oil_C"))


def test_report_of_a_campaign(tmp_path, small):
    table, _ = small
    found = rf.campaign(OneMode(), with_a_dead_run(table), known=KNOWN)
    text = rf.write_campaign_report(found, tmp_path / "c.html", against="pressure_psi", by="inlet").read_text()
    assert "19 of 20 runs give an answer" in text
    assert "R00: says nothing" in text
    assert "data:image/png" in text
    for name in ("anti-swirl", "pressure_psi", "r19"):
        assert name in text
