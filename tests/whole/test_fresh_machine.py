"""What a machine that has never run any of this sees: empty home, empty caches, warnings as errors."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def test_a_posterior_in_an_empty_home_shows_no_banner(tmp_path: Path) -> None:
    """ArviZ before 1.0 warns once a day and leaves a stamp in the user's cache: with an empty cache it is that day."""
    kept = {name: os.environ[name] for name in ("PATH", "PYTHONPATH", "OMP_NUM_THREADS") if name in os.environ}
    code = (
        "import rotorfit as rf\n"
        "fit = rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={'K3': 6000.0})\n"
        "post = fit.sample(seed=1, walkers=24, max_steps=100)\n"
        "post.summary(), post.to_arviz()"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        env={**kept, "HOME": str(tmp_path), "MPLBACKEND": "agg"}, check=False, capture_output=True, text=True,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
