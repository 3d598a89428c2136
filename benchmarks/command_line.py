"""Processor time and memory of commands on bundled tests in fresh processes, and what importing packages takes.

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
MODAL = ["-m", "rotorfit", "fit", str(datasets.path("rk4_sync.csv")), "--model", "modal", "--phase-offsets", "common"]
JUDGED = ["--max-speed", "2400", "--unbalance", "disk1=30", "--quiet"]
DRAWING = "import matplotlib.figure, matplotlib.backends.backend_agg"


def spent(words: list[str], compiled: Path) -> tuple[float, float]:
    """Processor time of a fresh interpreter, user and system, seconds, and the most memory that it held, MB.

    Args:
        words: its arguments.
        compiled: folder for compiled modules, which an installation keeps too.
    """
    place = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    place["PYTHONPYCACHEPREFIX"] = str(compiled)
    with subprocess.Popen(
        [sys.executable, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=place
    ) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{words} ended with {process.returncode}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3


def main() -> None:
    """Measure in turns and write the table."""
    with tempfile.TemporaryDirectory() as folder:
        out, modal = ["--out", str(Path(folder) / "fit")], Path(folder) / "modal"
        cases = {
            "the interpreter": ["-c", "pass"],
            "NumPy and CasADi": ["-c", "import numpy, casadi"],
            "the parts of SciPy that other fits use": ["-c", IMPORTS],
            "matplotlib": ["-c", DRAWING],
            "rotorfit fit FILE": FIT,
            "rotorfit fit FILE --out DIR --no-figures": [*FIT, *out, "--no-figures"],
            "rotorfit fit FILE --out DIR": [*FIT, *out],
            "rotorfit fit FILE --refine --out DIR": [*FIT, "--refine", *out],
            "rotorfit judge FIT --unbalance, one mode": ["-m", "rotorfit", "judge", str(modal / "fit.json"), *JUDGED],
        }
        spent([*MODAL, "--out", str(modal), "--no-figures", "--quiet"], Path(folder) / "compiled")
        taken: dict[str, list[tuple[float, float]]] = {name: [] for name in cases}
        for turn in range(RUNS + 1):
            for name, words in cases.items():
                found = spent(words, Path(folder) / "compiled")
                if turn:  # the first compiles modules and fills the caches of the disk
                    taken[name].append(found)
    rows = []
    for name, found in taken.items():
        times, memory = np.array(found).T
        rows.append([name, f"{np.median(times):.2f}", f"{min(times):.2f}", f"{max(memory):.0f}"])
    text = [
        "# Processor time of the command line", "",
        f"Made by `python benchmarks/command_line.py` on {environment('numpy', 'scipy', 'matplotlib')}.", "",
        "Fresh processes, user and system time, from start to end; imports include the interpreter and NumPy.",
        "", *table(["process", "s, median", "s, fastest", "most memory, MB"], rows),
    ]  # fmt: skip
    print("\n".join(text[6:]))
    (RESULTS / "command_line.md").write_text("\n".join(text) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
