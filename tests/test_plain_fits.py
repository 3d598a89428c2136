"""Runs of a campaign that are fitted together give what each gives by itself: every number and every sentence."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest
from slips import exchanged, lag_as_lead, thinned, turned
from synthetic import KNOWN, MODELS, SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of

import rotorfit as rf
from rotorfit.campaigns.pictures import curvature, curvatures, least_curvature
from rotorfit.campaigns.runs import Run, fit_run
from rotorfit.fitting.plain_fits import PlainFit, plain_fits
from rotorfit.fitting.settings import FitSettings

ROUND_OFF = 1e-9
"""Relative: the machine's 2e-16, sums of a few hundred readings, and a condition number of 1e2 twice, with a margin of
1e2. The searches end within 1e-10 of the misfit, by the same steps."""

ROUND = ("one-mode", "whirl-whip", "two-disk", "overhung")
"""Models that see complex coordinates, whose runs are fitted together."""


def runs_of(name, count, *, lines=100, noise=0.01, told=False, seed=0):
    """Runs of one plan at speeds and parameters of their own."""
    model, rng = MODELS[name](), np.random.default_rng(seed)
    typical = model.vector(TYPICAL[name])
    frequency = covering_frequencies(model, typical, SPEEDS[name][:1], lines)
    free = [i for i, parameter in enumerate(model.parameter_names) if parameter not in KNOWN[name]]
    found = []
    for number in range(count):
        theta = typical.copy()
        theta[free] *= rng.uniform(0.95, 1.05, len(free))
        speed = SPEEDS[name][0] * rng.uniform(0.95, 1.05)
        test = circular_test(
            model, theta, speeds=(speed,), frequency=frequency, noise=noise, seed=100 * seed + number,
            sigma_known=told,
        )  # fmt: skip
        found.append(one_run(test, f"r{number:02d}"))
    return model, known_of(name, TYPICAL[name]), found


def one_run(test, name):
    return replace(test, run=np.full(len(test), name), source=name)


def alone(model, test, known, **settings):
    """What :func:`rotorfit.fit` finds of one run, of which nothing is known yet."""
    run = Run(test.source, test.select(np.arange(len(test))), {})
    return fit_run(model, run, settings=FitSettings(known=known, **settings), start={})


def together(model, tests, known, **settings):
    """Numbers of the runs that are fitted together to the end."""
    found = plain_fits(model, tests, FitSettings(known=known, **settings), [{}] * len(tests))
    return {number for number, fit in found.items() if isinstance(fit, PlainFit)}


def assert_same(one, other):
    assert one.name == other.name
    for field in ("var_names", "ndata", "nfev", "success", "message", "warnings", "silent"):
        assert getattr(one, field) == getattr(other, field), (one.name, field)
    assert (one.noise is None) == (other.noise is None)
    for field in ("chisqr", "redchi"):
        np.testing.assert_allclose(getattr(one, field), getattr(other, field), rtol=ROUND_OFF, err_msg=one.name)
    # What cancels in a covariance is small beside the standard errors; a parameter that nothing tells of has none.
    error = np.sqrt(np.where(np.diag(other.covar) > 0, np.diag(other.covar), 1.0))
    unit = np.outer(error, error)
    np.testing.assert_allclose(one.covar / unit, other.covar / unit, atol=ROUND_OFF, err_msg=one.name)
    assert list(one.params) == list(other.params)
    for own, theirs in zip(one.params.values(), other.params.values(), strict=True):
        for field in ("name", "unit", "meaning", "min", "max", "vary", "resolved", "at_bound"):
            assert getattr(own, field) == getattr(theirs, field), (one.name, own.name, field)
        for field in ("value", "stderr", "stderr_noise", "init_value", "freedom"):
            expected = getattr(theirs, field)
            assert getattr(own, field) == pytest.approx(expected, rel=ROUND_OFF, nan_ok=True), (
                one.name,
                own.name,
                field,
            )


@pytest.mark.parametrize("told", [False, True])
@pytest.mark.parametrize("name", ROUND)
def test_plain_runs_are_fitted_as_by_themselves(name, told):
    model, known, tests = runs_of(name, 12, told=told)
    assert len(together(model, tests, known)) >= 6  # others are near enough to a limit to be looked at by themselves
    found = rf.campaign(model, tests, known=known, split=None)
    for run, test in zip(found.runs, tests, strict=True):
        assert_same(run, alone(model, test, known))


def faulty(tests):
    """The runs with a fault in each but the first five, by name of the fault."""
    rng = np.random.default_rng(5)
    half = tests[0].frequency > 0

    def louder(test, where, factor):
        size = factor * np.sqrt(np.mean(np.abs(test.response) ** 2))
        noise = rng.normal(size=len(test)) + 1j * rng.normal(size=len(test))
        return replace(test, response=test.response + np.where(where, size * noise, 0.0))

    def following(test):
        slow = np.cumsum(rng.normal(size=len(test)) + 1j * rng.normal(size=len(test)))
        slow = slow / np.std(slow) * 0.03 * np.sqrt(np.mean(np.abs(test.response) ** 2))
        return replace(test, response=test.response + slow)

    def resonant(test):
        s = 1j * np.abs(test.frequency)
        return replace(test, response=test.response * (1 + 0.3 * s**2 / (s**2 + 8 * s + 150.0**2)))

    def jittery(test):
        by_line = dict.fromkeys(test.frequency.tolist())
        gain = {w: 1 + 0.05 * rng.normal() for w in by_line}
        return replace(test, response=test.response * np.array([gain[w] for w in test.frequency.tolist()]))

    def with_value(test, row, value):
        response = test.response.copy()
        response[row] = value
        return replace(test, response=response)

    faults = {
        "turned probes": lambda test: turned(test, 40.0),
        "exchanged probes": exchanged,
        "lag as lead": lag_as_lead,
        "micrometres taken for metres": lambda test: replace(test, response=test.response * 1e6),
        "mils taken for micrometres": lambda test: replace(test, response=test.response * 25.4),
        "one probe louder": lambda test: louder(test, test.direction == "x", 0.1),
        "one direction louder": lambda test: louder(test, half, 0.05),
        "noise that follows": following,
        "another structure": resonant,
        "a force that jitters": jittery,
        "few lines": lambda test: thinned(test, 8),
        "very few lines": lambda test: thinned(test, 25),
        "missing lines": lambda test: test.select(np.arange(len(test)) % 7 != 3),
        "no y probe": lambda test: test.select(test.direction == "x"),
        "a dead probe": lambda test: replace(test, response=np.where(test.direction == "y", 0, test.response)),
        "dead probes": lambda test: replace(test, response=np.zeros(len(test), dtype=complex)),
        "a reading of zero": lambda test: with_value(test, 11, 0.0),
        "a reading that is not finite": lambda test: with_value(test, 11, np.nan),
        "an outlier": lambda test: with_value(test, 11, 20 * test.response[11]),
        "at rest": lambda test: replace(test, speed=np.zeros(len(test))),
        "reversed rotation": lambda test: replace(test, frequency=-test.frequency),
        "two runs in one": lambda test: replace(test, run=np.where(half, "up", "down")),
        "noise alone": lambda test: replace(
            test, response=1e-6 * (rng.normal(size=len(test)) + 1j * rng.normal(size=len(test)))
        ),
        "no noise": lambda test: replace(test, sigma=np.full(len(test), 1.0)),
    }
    changed = {name: change(test) for (name, change), test in zip(faults.items(), tests[5:], strict=True)}
    return [*tests[:5], *(replace(test, source=name) for name, test in changed.items())]


def test_exact_data_leave_round_off_and_are_fitted_by_themselves():
    model, known, tests = runs_of("whirl-whip", 3, noise=0.0)
    assert not plain_fits(model, tests, FitSettings(known=known), [{}] * len(tests))
    found = rf.campaign(model, tests, known=known, split=None)
    for run, test in zip(found.runs, tests, strict=True):
        assert_same(run, alone(model, test, known))


OPEN = ("few lines", "very few lines", "missing lines", "no y probe", "one direction louder", "an outlier")
"""Faults that may leave a plain fit: nothing is wrong with fewer readings whose noise is told, and noise is noise."""


@pytest.mark.parametrize("told", [False, True])
def test_faults_among_plain_runs_are_told_as_by_themselves(told):
    model, known, tests = runs_of("one-mode", 29, told=told, seed=3)
    tests = faulty(tests)
    plain = {tests[number].source for number in together(model, tests, known)}
    assert plain <= {"r00", "r01", "r02", "r03", "r04", *OPEN}
    found = rf.campaign(model, tests, known=known, split=None)
    for run, test in zip(found.runs, tests, strict=True):
        assert_same(run, alone(model, test, known))
    assert any(run.warnings for run in found.runs)


def test_a_parameter_at_its_bound_and_one_that_is_not_determined():
    model, known, tests = runs_of("one-mode", 6, seed=2)
    bounds = {"lam": (0.0, 0.4)}
    assert not together(model, tests, known, bounds=bounds)
    found = rf.campaign(model, tests, known=known, bounds=bounds, split=None)
    for run, test in zip(found.runs, tests, strict=True):
        assert_same(run, alone(model, test, known, bounds=bounds))
        assert run.params["lam"].at_bound
    freed = {"Ds": known["Ds"]}  # K and K0 only as a sum
    assert not together(model, tests, freed)
    found = rf.campaign(model, tests, known=freed, split=None)
    for run, test in zip(found.runs, tests, strict=True):
        assert_same(run, alone(model, test, freed))


@pytest.mark.parametrize("settings", [{"loss": "huber"}, {"priors": True}, {"start": {"D": 400.0}}])
def test_other_settings_are_left_to_fits_by_themselves(settings):
    from scipy.stats import norm

    if "priors" in settings:
        settings = {"priors": {"D": norm(TYPICAL["one-mode"]["D"], 50.0)}}
    model, known, tests = runs_of("one-mode", 3, seed=4)
    found = rf.campaign(model, tests, known=known, split=None, **settings)
    for run, test in zip(found.runs, tests, strict=True):
        fit = rf.fit(model, test, known=known, **settings)
        for name in fit.var_names:
            assert run.params[name].value == pytest.approx(fit.params[name].value, rel=ROUND_OFF)
            assert run.params[name].stderr == pytest.approx(fit.params[name].stderr, rel=ROUND_OFF)


def test_pictures_of_shared_parameters_are_those_of_single_runs():
    """Costs about the fit and, own parameters at their best, about other values of shared ones; some noise is found."""
    model, known, tests = runs_of("one-mode", 29, seed=3)
    tests = [
        test for test in faulty(tests) if test.source in ("r00", "r01", "r02", "one direction louder", "no y probe")
    ]
    shared = {"M": 1.01 * TYPICAL["one-mode"]["M"]}
    batch = []
    for test in tests:
        fit = alone(model, test, known)
        settings = FitSettings(known=known) if fit.noise is None else FitSettings(known=known, noise=fit.noise)
        at = {name: fit.params[name].value for name in fit.var_names}
        batch.append((Run(test.source, test, {}), {"settings": settings, "at": at}))
    plain = next(option["settings"] for _, option in batch if option["settings"].noise is None)
    for _, option in batch:
        if option["settings"].noise is None:
            option["settings"] = plain  # as a campaign has them
    for work, more in ((curvature, {}), (least_curvature, {"shared": shared})):
        asked = [(run, {**option, **more}) for run, option in batch]
        for (run, option), found in zip(asked, curvatures(model, asked), strict=True):
            single = work(model, run, **option)
            assert found.names == single.names
            scale = np.sqrt(np.diag(single.matrix))
            for field in ("x", "cost", "squares", "prior"):
                np.testing.assert_allclose(getattr(found, field), getattr(single, field), rtol=ROUND_OFF)
            unit = np.outer(scale, scale)
            np.testing.assert_allclose(found.matrix / unit, single.matrix / unit, atol=ROUND_OFF)
            # At an optimum a slope is round-off: compared in standard errors, as far as the search went.
            np.testing.assert_allclose(found.gradient / scale, single.gradient / scale, rtol=ROUND_OFF, atol=1e-7)


def test_models_with_x_and_y_apart_are_fitted_one_by_one():
    model, known, tests = runs_of("anisotropic", 3)
    assert not together(model, tests, known)
    found = rf.campaign(model, tests, known=known, split=None)
    for run, test in zip(found.runs, tests, strict=True):
        assert_same(run, alone(model, test, known))


def test_workers_of_an_executor_fit_together_too():
    model, known, tests = runs_of("one-mode", 29, seed=3)
    tests = faulty(tests)
    here = rf.campaign(model, tests, known=known, split=None)
    with ThreadPoolExecutor(2) as pool:
        there = rf.campaign(model, tests, known=known, split=None, executor=pool)
    for one, other in zip(here.runs, there.runs, strict=True):
        assert_same(one, other)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        there = rf.campaign(model, tests, known=known, split=None, executor=pool)
    for one, other in zip(here.runs, there.runs, strict=True):
        assert_same(one, other)
