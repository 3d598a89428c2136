"""Commands where the home cannot be written, as of the account of a service or in a container."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rotorfit import datasets

STUDY = 'files = ["*.csv"]\nmodel = "whirl-whip"\nknown = {K3 = 6000.0}\n'


FIT = "fit rig.csv --model whirl-whip --known K3=6000 --quiet --no-figures --sample --max-steps 40 --out out"


@pytest.mark.parametrize(
    ("words", "home"),
    [
        (FIT, "/dev/null/x"),
        pytest.param(FIT, None, marks=pytest.mark.slow),
        pytest.param(
            "watch inbox --study study.toml --store watched.db --once --settle 0", "/dev/null/x", marks=pytest.mark.slow
        ),
        ("look volts.h5 --out out", "/dev/null/x"),
        ("open --port 99999", None),
    ],
)
def test_a_home_that_cannot_be_written_costs_one_line(words: str, home: str | None, tmp_path: Path) -> None:
    """Nor is there need of a home at all, as where a number stands for the user."""
    (tmp_path / "inbox").mkdir()
    for name in ("rig.csv", "inbox/rig.csv"):
        (tmp_path / name).write_bytes(datasets.path("rig_lumped.csv").read_bytes())
    (tmp_path / "volts.h5").write_bytes(datasets.path("volts_disk-fwd.h5").read_bytes())
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("XDG_", "MPL", "HOME", "ROTORFIT_"))}
    script = "import sys, rotorfit.apps.cli.main as m; sys.exit(m.main(sys.argv[1:]))"
    if home is None:  # of a user whom the machine does not know
        unknown = "os.path.expanduser = lambda path: real(path) if 'HOME' in os.environ else path"
        script = f"import os; real = os.path.expanduser; {unknown}; {script}"
    else:
        kept["HOME"] = home
    called = [sys.executable, "-c", script, *words.split()]
    done = subprocess.run(called, cwd=tmp_path, env=kept, capture_output=True, text=True, check=False)
    expected = {"fit": 1, "open": 2}  # sampling was cut short; there is no such port
    assert done.returncode == expected.get(words.split(maxsplit=1)[0], 0), done.stderr
    said = [line for line in done.stderr.splitlines() if "the folder for caches" in line]
    assert len(said) == 1
    assert all(line.startswith("rotorfit: ") for line in done.stderr.splitlines())
    assert not Path(said[0].rpartition(" ")[2]).exists()  # it is gone with the process
    if "out" in words:
        assert (tmp_path / "out" / ("posterior.nc" if "fit" in words else "summary.txt")).is_file()
