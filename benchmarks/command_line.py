"""Processor time of `rotorfit fit` on the bundled rig in fresh processes, medians, and what importing packages takes.

python benchmarks/command_line.py
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from reporting import RESULTS, environment, table

from rotorfit import datasets

RUNS = 5
FIT = ["-m", "rotorfit", "fit", str(datasets.path("rig_open.csv")), "--model", "whirl-whip", "--known", "K3=6000"]
IMPORTS = "import scipy.special, scipy.linalg, scipy.optimize"
DRAWING = "import matplotlib.figure, matplotlib.backends.backend_agg"


def seconds(words: list[str], compiled: Path) -> float:
    """Processor time of a fresh interpreter, user and system, seconds.

    Args:
        words: its arguments.
        compiled: folder for compiled modules, which an installation keeps too.
    """
    place = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    place["PYTHONPYCACHEPREFIX"] = str(compiled)
    before = os.times()
    subprocess.run([sys.executable, *words], check=True, capture_output=True, env=place)
    after = os.times()
    return after.children_user - before.children_user + after.children_system - before.children_system


def main() -> None:
    """Measure in turns and write the table."""
    with tempfile.TemporaryDirectory() as folder:
        out = ["--out", str(Path(folder) / "fit")]
        cases = {
            "the interpreter": ["-c", "pass"],
            "NumPy and CasADi": ["-c", "import numpy, casadi"],
            "the parts of SciPy that other fits use": ["-c", IMPORTS],
            "matplotlib": ["-c", DRAWING],
            "rotorfit fit FILE": FIT,
            "rotorfit fit FILE --out DIR --no-figures": [*FIT, *out, "--no-figures"],
            "rotorfit fit FILE --out DIR": [*FIT, *out],
            "rotorfit fit FILE --refine --out DIR": [*FIT, "--refine", *out],
        }
        taken: dict[str, list[float]] = {name: [] for name in cases}
        for turn in range(RUNS + 1):
            for name, words in cases.items():
                found = seconds(words, Path(folder) / "compiled")
                if turn:  # the first compiles modules and fills the caches of the disk
                    taken[name].append(found)
    rows = [[name, f"{np.median(times):.2f}", f"{min(times):.2f}"] for name, times in taken.items()]
    text = [
        "# Processor time of the command line", "",
        f"Made by `python benchmarks/command_line.py` on {environment('numpy', 'scipy', 'matplotlib')}.", "",
        "Fresh processes, user and system time, from start to end; imports include the interpreter and NumPy.",
        "", *table(["process", "s, median", "s, fastest"], rows),
    ]  # fmt: skip
    print("\n".join(text[6:]))
    (RESULTS / "command_line.md").write_text("\n".join(text) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
