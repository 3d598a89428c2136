"""Many vectors and many data sets at once: the misfit, its gradient and the optima of one at a time."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from batch_checks import check
from scipy import stats
from slow_cases import slow_but

from rotorfit.estimators.minimisation.batch import batch_fit, with_measured
from rotorfit.estimators.minimisation.least_squares import minimise
from rotorfit.estimators.misfit import accelerator
from rotorfit.estimators.misfit.kernels import Batch
from rotorfit.estimators.misfit.priors import Prior
from rotorfit.estimators.misfit.problem import LOSSES

LINES, MEMBERS = 20, 6


@pytest.fixture(scope="module", autouse=True)
def _benchmarks_on_the_path():
    sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
    yield
    sys.path.remove(str(Path(__file__).parents[2] / "benchmarks"))


@pytest.fixture(scope="module")
def make():
    """A noisy problem of a rig, with its true vector."""
    from rigs import RIGS, chain_rig, true_vector, with_noise

    def problem(name):
        rig = chain_rig(5) if name == "chain" else RIGS[name]
        noisy = with_noise(rig.problem(LINES, 0.02), np.random.default_rng(1))
        return noisy, true_vector(noisy, rig.truth)

    return problem


@pytest.mark.parametrize(
    ("name", "accelerate"),
    [
        *((name, False) for name in ("one-mode", "whirl-whip", "two-disk", "overhung", "anisotropic", "chain")),
        ("whirl-whip", True),
        *(pytest.param(name, True, marks=pytest.mark.slow) for name in ("anisotropic", "chain")),
    ],
)
def test_misfit_and_gradient_are_those_of_one_at_a_time(make, name, accelerate):
    problem, truth = make(name)
    check(problem, truth * (1 + 0.02 * np.random.default_rng(2).normal(size=(MEMBERS, truth.size))), accelerate)


@pytest.mark.parametrize(("name", "accelerate"), [("whirl-whip", True), ("anisotropic", False)])
def test_misses_are_those_of_one_at_a_time(make, name, accelerate):
    """Channel by channel, and turned as columns beside them are."""
    problem, truth = make(name)
    batch = Batch(problem, accelerate=accelerate)
    x = truth * (1 + 0.02 * np.random.default_rng(2).normal(size=(MEMBERS, truth.size)))
    found = batch.misses(x)
    squares = np.array([np.sum(found[:, part] ** 2, axis=1) for part in batch.parts]).T
    np.testing.assert_allclose(squares, problem.channel_sums(x), rtol=1e-10)
    columns = problem.jacobian(truth)[1]
    products = np.array([(columns.conj().T @ problem.residuals(row)).real for row in x])
    np.testing.assert_allclose(found @ batch.in_channels(columns.T).T, products, rtol=1e-9)


@pytest.mark.parametrize(
    ("loss", "accelerate"),
    slow_but(product(LOSSES, (False, True)), *product(LOSSES, (False,)), ("linear", True), ("cauchy", True)),
)
def test_robust_losses(make, loss, accelerate):
    problem, truth = make("one-mode")
    problem = replace(problem, loss=loss)
    check(problem, truth * (1 + 0.02 * np.random.default_rng(2).normal(size=(MEMBERS, truth.size))), accelerate)


@pytest.mark.parametrize("accelerate", [False, True])
@pytest.mark.parametrize("loss", ["linear", "soft_l1"])
def test_optima_are_those_of_one_at_a_time(make, loss, accelerate):
    problem, truth = make("whirl-whip")
    law = Prior(0, stats.norm(truth[0], 0.05 * truth[0]))
    problem = replace(problem, loss=loss, priors=(law,))
    rng = np.random.default_rng(4)
    exact, sigma = np.concatenate(problem.predict(truth)), problem.blocks[0].sigma
    noise = rng.normal(size=(MEMBERS, sigma.size)) + 1j * rng.normal(size=(MEMBERS, sigma.size))
    measured = exact + sigma * noise
    found = batch_fit(problem, measured, truth, accelerate=accelerate)
    assert found.converged.all()
    for x, cost, row in zip(found.x, found.cost, measured, strict=True):
        alone = with_measured(problem, row)
        expected = minimise(alone, truth)
        matrix = alone.gauss_newton(expected.x)[2]
        step = x - expected.x
        assert step @ matrix @ step < 1e-10  # squared distance in standard errors
        assert cost == pytest.approx(expected.cost, rel=1e-10)


def test_kernels_are_kept_only_where_nobody_else_writes(tmp_path, monkeypatch):
    mine, open_ = tmp_path / "mine", tmp_path / "open"
    open_.mkdir()
    open_.chmod(0o777)
    monkeypatch.setenv("ROTORFIT_CACHE_DIR", str(mine))
    assert accelerator.cache_directory() == mine
    assert mine.stat().st_mode & 0o077 == 0
    monkeypatch.setenv("ROTORFIT_CACHE_DIR", str(open_))
    assert accelerator.cache_directory() is None


def test_every_part_of_the_path_of_kernels_is_mine(tmp_path, monkeypatch):
    """Who may write a folder above can put another in its place."""
    below = tmp_path / "open" / "mine"
    below.mkdir(parents=True)
    below.chmod(0o700)
    below.parent.chmod(0o775)
    monkeypatch.setenv("ROTORFIT_CACHE_DIR", str(below))
    assert accelerator.cache_directory() is None
    below.parent.chmod(0o755)
    assert accelerator.cache_directory() == below
    (below / "__pycache__").chmod(0o777)
    assert accelerator.cache_directory() is None
    below.parent.chmod(0o1777)  # others may write there, but not rename what is not theirs
    (below / "__pycache__").chmod(0o700)
    assert accelerator.cache_directory() == below


KERNEL = """
@outer
def twice(x):
    return 2.0 * x
"""


def compiled_anew():
    """Machine code as another process would get it, and whether it came from disk."""
    accelerator.compile_kernels.cache_clear()
    kernel = accelerator.compile_kernels(KERNEL)["twice"]
    assert kernel(2.0) == 4.0
    return bool(kernel._cache_hits)


@pytest.mark.parametrize(
    "damage", [lambda whole: b"", lambda whole: whole[:40], lambda whole: whole[:-70] + whole[-69:]]
)
def test_damaged_machine_code_is_compiled_again(tmp_path, monkeypatch, damage):
    pytest.importorskip("numba")
    monkeypatch.setenv("ROTORFIT_CACHE_DIR", str(tmp_path / "kernels"))
    assert not compiled_anew()
    assert compiled_anew()
    files = sorted((tmp_path / "kernels" / "__pycache__").glob("*.nb[ic]"))
    assert len(files) == 2
    for file in files:
        file.write_bytes(damage(file.read_bytes()))
        assert not compiled_anew()
        assert compiled_anew()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
def test_only_files_are_machine_code(tmp_path, monkeypatch):
    """A pipe would be waited for without end; it is removed. A folder stays, and nothing is kept beside it."""
    pytest.importorskip("numba")
    monkeypatch.setenv("ROTORFIT_CACHE_DIR", str(tmp_path / "kernels"))
    assert not compiled_anew()
    for file in sorted((tmp_path / "kernels" / "__pycache__").glob("*.nb[ic]")):
        file.unlink()
        os.mkfifo(file)
        assert not compiled_anew()
        assert compiled_anew()
        file.unlink()
        (file / "mine").mkdir(parents=True)
        assert not compiled_anew()
        assert not compiled_anew()
        (file / "mine").rmdir()
        file.rmdir()


def test_machine_code_that_others_may_change_is_compiled_again(tmp_path, monkeypatch):
    """The folder may be seen by all; the files that numba makes there have the mode that the user's umask leaves."""
    pytest.importorskip("numba")
    (tmp_path / "kernels" / "__pycache__").mkdir(parents=True)
    monkeypatch.setenv("ROTORFIT_CACHE_DIR", str(tmp_path / "kernels"))
    before = os.umask(0o002)
    try:
        assert not compiled_anew()
    finally:
        os.umask(before)
    assert compiled_anew()
    files = sorted((tmp_path / "kernels" / "__pycache__").glob("*.nb[ic]"))
    assert [file.stat().st_mode & 0o777 for file in files] == [0o600, 0o600]
    files[0].chmod(0o666)
    assert not compiled_anew()


def test_machine_code_is_not_loaded_from_a_numba_folder_of_others(tmp_path, monkeypatch):
    numba = pytest.importorskip("numba")
    monkeypatch.setenv("ROTORFIT_CACHE_DIR", str(tmp_path / "kernels"))
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    theirs.chmod(0o777)
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(theirs))
    assert not compiled_anew()
    assert not compiled_anew()
    theirs.chmod(0o700)
    assert not compiled_anew()
    assert compiled_anew()
