"""Runs of the sampler: the same for a seed, with progress, resumed where they were killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import emcee
import numpy as np
from posteriors import KNOWN, one_mode_test, quick
from sentences import refuses

import rotorfit as rf
from rotorfit.models import OneMode

# ---- reproducibility, progress, checkpoints -------------------------------------------------------------------------


def test_seed_and_compilation_do_not_matter_for_the_answer():
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN, causes=None)
    first, again = (quick(fit, max_steps=50, accelerate=False) for _ in range(2))
    np.testing.assert_array_equal(first.chain, again.chain)
    compiled = quick(fit, max_steps=50, accelerate=True)
    np.testing.assert_allclose(compiled.chain, first.chain, rtol=1e-9)
    free = fit.sample(walkers=16, max_steps=20)
    np.testing.assert_array_equal(fit.sample(walkers=16, max_steps=20, seed=free.seed).chain, free.chain)


def test_progress_is_reported(capsys):
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN, causes=None)
    seen = []
    post = quick(fit, progress=seen.append)
    assert [state.steps for state in seen] == sorted({state.steps for state in seen})
    assert seen[-1].steps == post.settings.steps
    assert seen[-1].ess > 1000
    quick(fit, progress=True)
    shown = capsys.readouterr().err
    assert f"{post.settings.steps} steps" in shown
    assert shown.endswith("\n")


CHILD = """
import sys
import numpy as np
sys.path.insert(0, sys.argv[2])
from test_posterior_checkpoints import interrupted
interrupted(sys.argv[1], lambda state: print(state.steps, flush=True))
"""


def interrupted(path, progress=False):
    """A run that never has enough and ends by its limit of steps."""
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN, causes=None)
    return fit.sample(seed=7, walkers=16, ess=1e12, max_steps=900, checkpoint=path, progress=progress, accelerate=False)


def test_a_killed_run_resumes_where_it_was(tmp_path):
    path = tmp_path / "run.h5"
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(path), str(Path(__file__).parent)],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
    )
    told = [int(child.stdout.readline()) for _ in range(3)]
    os.kill(child.pid, signal.SIGKILL)
    child.stdout.close()
    assert child.wait() == -signal.SIGKILL
    kept = emcee.backends.HDFBackend(str(path), read_only=True).iteration
    # Killed while it worked on the next stretch: that much, and no more, is lost.
    assert kept >= told[-1] == 300
    assert kept < 900
    resumed = []
    post = interrupted(path, lambda state: resumed.append(state.steps))
    assert resumed[0] > kept
    straight = interrupted(tmp_path / "straight.h5")
    # The fit that walkers start from differs in its last digits from process to process, where NumPy's arrays lie
    # elsewhere in memory. Moves carry that along and do not let it grow; other draws would differ by a hundredth.
    np.testing.assert_allclose(post.chain, straight.chain, rtol=1e-9)
    np.testing.assert_allclose(post.log_density, straight.log_density, atol=1e-6)
    np.testing.assert_array_equal(post.acceptance, straight.acceptance)
    assert post.message == straight.message
    # Asked again, there is nothing left to do.
    np.testing.assert_array_equal(interrupted(path).chain, post.chain)


def test_checkpoints_of_something_else_are_refused(tmp_path):
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN, causes=None)
    path = tmp_path / "run.h5"
    options = {"walkers": 16, "checkpoint": path, "max_steps": 50}
    fit.sample(seed=1, **options)
    with refuses(ValueError):
        fit.sample(seed=2, **options)
    with refuses(ValueError):
        fit.sample(**{**options, "walkers": 18})
    with refuses(ValueError):
        rf.fit(OneMode(), one_mode_test(seed=3), known=KNOWN, causes=None).sample(**options)
    with refuses(ValueError):
        fit.sample(**options, noise="fixed")
    path.write_bytes(b"not HDF5")
    with refuses(ValueError):
        fit.sample(**options)


def test_a_checkpoint_without_a_seed_keeps_the_one_drawn(tmp_path):
    fit = rf.fit(OneMode(), one_mode_test(), known=KNOWN, causes=None)
    path = tmp_path / "run.h5"
    first = fit.sample(walkers=16, checkpoint=path, max_steps=50)
    longer = fit.sample(walkers=16, checkpoint=path, max_steps=120)
    assert longer.seed == first.seed
    np.testing.assert_array_equal(
        longer.chain, fit.sample(walkers=16, seed=first.seed, checkpoint=tmp_path / "two.h5", max_steps=120).chain
    )
