"""A full disk is one sentence, and what was written before stays: every file that rotorfit writes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FULL = """
import resource, sys, warnings
from pathlib import Path
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import rotorfit as rf
from posteriors import KNOWN, one_mode_test
from rotorfit.lab.recordings.formats.files import open_raw
from rotorfit.lab.simulation.instruments import write_counts
from rotorfit.apps.study_files.folder import complete_folder
from scipy.io import savemat

warnings.simplefilter("ignore")
folder = Path(sys.argv[1])
test = one_mode_test(lines=200)
fit = rf.fit(rf.models.OneMode(), test, known=KNOWN)
draws = fit.sample(walkers=16, max_steps=100, seed=1, accelerate=False)
volts = {"x": np.random.default_rng(0).normal(size=20_000)}
np.savetxt(folder / "volts.txt", volts["x"], header="x", comments="")
np.savez(folder / "volts.npz", **volts, fs=100.0)
savemat(folder / "volts.mat", volts | {"fs": 100.0}, do_compression=True)
pq.write_table(pa.table(volts | {"time_s": np.arange(20_000) / 100.0}), folder / "volts.parquet")
rf.Store(folder / "machine.db")

def fill(path):
    with complete_folder(path) as draft:
        (draft / "curves.csv").write_text("0" * 10_000)

work = {
    "a.nc": lambda path: rf.write(test, path),
    "a.mat": lambda path: rf.write(test, path),
    "a.uff": lambda path: rf.write(test, path),
    "a.csv": lambda path: rf.write(test, path),
    "a.h5": lambda path: write_counts(path, volts, {"fs": 100.0}),
    "fit.json": fit.save,
    "posterior.nc": draws.save,
    "run.h5": lambda path: fit.sample(walkers=16, max_steps=100, seed=1, accelerate=False, checkpoint=path),
    "volts.txt": open_raw,
    "volts.npz": open_raw,
    "volts.mat": open_raw,
    "volts.parquet": open_raw,
    "results": lambda path: fill(path),
    "machine.db": lambda path: rf.Store(path).keep({"a": bytes(100_000)}),
}
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
for name, write in work.items():
    try:
        write(folder / name)
        print(name, "was written")
    except OSError as problem:
        print(problem)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no limit of file sizes")
def test_a_full_disk_is_one_sentence_and_leaves_old_files(tmp_path: Path) -> None:
    """In a process whose files cannot grow beyond 4 kB, over old files and into the folder for temporary ones."""
    names = ("a.nc", "a.mat", "a.uff", "a.csv", "a.h5", "fit.json", "posterior.nc")
    for name in names:
        (tmp_path / name).write_text("old", encoding="utf-8")
    command = [sys.executable, "-c", FULL, str(tmp_path)]
    # Python would cut off the bytecode of what it imports, too, and read it back in other tests.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "PYTHONDONTWRITEBYTECODE": "1"}
    child = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert child.returncode == 0, child.stderr
    *lines, store = child.stdout.splitlines()
    assert "machine.db cannot be used: " in store
    assert "rollback" not in store
    *lines, results = lines
    for name, line in zip((*names, "run.h5", "results"), (*lines[: len(names) + 1], results), strict=True):
        assert line.startswith("[Errno 27] ")
        assert line.endswith(f"'{tmp_path / name}'")
    spooled = lines[len(names) + 1 :]
    assert ["folder for temporary files" in line for line in spooled] == [True] * 4
    there = {p.name: p for p in tmp_path.iterdir() if p.stem not in ("volts", "machine")}
    assert {name: path.read_text(encoding="utf-8") for name, path in there.items()} == dict.fromkeys(names, "old")
