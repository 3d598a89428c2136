"""Code of the documents, and ordinary lines, as a strict type checker sees them."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

import rotorfit as rf

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("[!_]*.md")), *sorted((ROOT / "docs").glob("[!_]*/*.md"))]

ORDINARY = """
import numpy as np
import rotorfit as rf

rig = rf.datasets.rig_open()
reveal_type(rig)
print(rig.frequency.max(), rig.select(rig.force_plane == "disk").response, rf.datasets.rk4().plane)
read = rf.read("rig.csv")
print(read.frequency, read.plot.bode())
loads = rf.read("loads.csv", kind=rf.StaticTest)
reveal_type(loads)
fit = rf.fit(rf.models.WhirlWhip(), read, known={"K3": 6000.0})
print(2 * fit.params["lam"], np.sqrt(fit.params["K0"] / fit.params["Mf"]), abs(fit.params["D"]))
onset = fit.threshold_speed()
print(onset > 200.0, round(onset, 1), max(onset, 2 * onset), f"{onset.to('rpm'):.1f}", onset.to_uncertainties())
test = rf.simulate(fit.model, {"K3": 1.0}, speed_rpm=1000, frequency_rpm=[100, 200], force=1.0)
reveal_type(test)
reveal_type(rf.simulate(fit.model, {"K3": 1.0}, "static-load", speed_rpm=1000, load=[1.0]))
reveal_type(rf.simulate(fit.model, {"K3": 1.0}, "impulse", speed_rpm=1000, impulse=1.0))
reveal_type(rf.responses(rf.read_recording("sweep.h5")))
for frequency, damping, sense in fit.natural_frequencies(150.0):
    print(frequency.value, damping.stderr)
"""
KINDS = ["PerturbationTest", "StaticTest", "PerturbationTest", "StaticTest", "RingDownTest", "PerturbationTest"]
"""Types of the lines that reveal theirs, in their order."""


def checked(folder: Path, *, untyped: bool) -> tuple[str, int]:
    """What mypy says of the files of a folder; ``untyped`` lets their own functions go without annotations."""
    options = ["--allow-untyped-defs", "--allow-untyped-calls"] if untyped else []
    command = [sys.executable, "-m", "mypy", "--strict", "--ignore-missing-imports", "--follow-imports=silent"]
    cache = ["--cache-dir", str(ROOT / ".mypy_cache" / "documents")]
    files = sorted(map(str, folder.glob("*.py")))
    found = subprocess.run([*command, *options, *cache, *files], cwd=ROOT, capture_output=True, text=True, check=False)
    return found.stdout, found.returncode


def test_a_file_of_another_kind_is_refused() -> None:
    with pytest.raises(ValueError, match="holds a perturbation test, not a static-load test"):
        rf.read(rf.datasets.path("rig_open.csv"), kind=rf.StaticTest)


def test_data_sets_and_models_are_offered_alone() -> None:
    for room in (rf.datasets, rf.models):
        assert dir(room) == sorted(room.__all__)
        assert not [name for name in dir(room) if importlib.util.find_spec(f"{room.__name__}.{name}")]


@pytest.mark.slow
def test_ordinary_lines_have_the_types_of_what_they_make(tmp_path: Path) -> None:
    (tmp_path / "ordinary.py").write_text(ORDINARY)
    said, code = checked(tmp_path, untyped=False)
    assert code == 0, said
    assert re.findall(r'Revealed type is ".*\.(\w+)"', said) == KINDS


@pytest.mark.slow
def test_the_code_of_the_documents_passes_a_strict_checker(tmp_path: Path) -> None:
    for page in PAGES:
        blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
        if blocks:
            (tmp_path / f"{page.parent.name}_{page.stem}.py").write_text("\n".join(blocks))
    said, code = checked(tmp_path, untyped=True)
    assert code == 0, said
