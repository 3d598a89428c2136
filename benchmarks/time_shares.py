"""Where processor time goes, by sampling: Python itself against work on arrays, and library by library.

Linux's ``perf`` stops the process two thousand times a second of its processor time and notes the function of machine
code that it is in; nothing is slowed down, as it is by profilers that are called at every function. A sample counts as
work on arrays where the function belongs to BLAS, LAPACK, CasADi, SciPy, a random generator, compiled kernels or the
C mathematics library, is a loop of NumPy over elements (by its name), moves memory, or is the system's. The rest of
NumPy takes calls, finds types and makes arrays; all else is the interpreter with its memory management.

Libraries are told apart by the interpreter's own stack at ticks of the process's timer: a sample belongs to the
likelihood where that is being evaluated, else to the library whose function called whatever runs.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import FrameType

_FREQUENCY = 2000
_LIBRARIES = re.compile(
    r"openblas|lapack|casadi|gfortran|quadmath|_umath_linalg|scipy|_pcg64|_mt19937|_generator|mtrand|bounded_integers"
    r"|libm\.|libmvec|libz\.|\[JIT\]|kernel|\[vdso\]|llvmlite"
)
_LOOPS = re.compile(
    r"^[A-Z]+_[a-z]|_(aligned|strided|contig)|^(strided|contig)|sum_of_products|pairwise|mapiter_|[tT]ake|sort|xss|^nc_|simd"
)
_MEMORY = re.compile(r"mem(cpy|move|set|cmp|chr)")


def python_shares(run: Callable[[], object], seconds: float = 2.0) -> tuple[float, float]:
    """Shares of samples in the interpreter and in what NumPy does for a call besides its loops.

    Args:
        run: what to sample, called again and again.
        seconds: processor time to spend.

    Returns:
        0 to 1; NaN where ``perf`` is not installed or may not be used.
    """
    if shutil.which("perf") is None:
        return math.nan, math.nan
    with tempfile.TemporaryDirectory() as folder:
        notes = Path(folder) / "perf.data"
        record = ["perf", "record", "-q", "-e", "cpu-clock", "-F", str(_FREQUENCY), "-p", str(os.getpid())]
        with subprocess.Popen([*record, "-o", str(notes)], stderr=subprocess.DEVNULL) as recorder:
            time.sleep(0.5)  # until it is attached
            begin = time.process_time()
            while time.process_time() - begin < seconds:
                run()
            recorder.send_signal(signal.SIGINT)
        report = ["perf", "report", "-i", str(notes), "--stdio", "-F", "sample,dso,symbol", "-t", "|"]
        lines = subprocess.run(report, capture_output=True, text=True, check=False).stdout.splitlines()
    counts: Counter[str] = Counter()
    for line in lines:
        count, *rest = (cell.strip() for cell in line.split("|"))
        if count.isdigit() and len(rest) >= 2:
            counts[_kind(rest[0], rest[1].partition("]")[2].strip())] += int(count)
    total = sum(counts.values())
    return (counts["interpreter"] / total, counts["calls"] / total) if total else (math.nan, math.nan)


def _kind(library: str, function: str) -> str:
    if "_multiarray_umath" in library:
        return "arrays" if _LOOPS.search(function) else "calls"
    if library.startswith("libc."):
        return "arrays" if _MEMORY.search(function) else "interpreter"
    return "arrays" if _LIBRARIES.search(library) else "interpreter"


_OWNERS = re.compile(r"[/\\](emcee|scipy|rotorfit|estimators)[/\\]")


def library_shares(run: Callable[[], object], evaluation: str, seconds: float = 4.0) -> dict[str, float]:
    """Shares of processor time by who asked for the work: ``evaluation``, emcee, scipy, rotorfit, or other.

    Args:
        run: what to sample, called again and again.
        evaluation: name of the function that evaluates the likelihood.
        seconds: processor time to spend.
    """
    counts: Counter[str] = Counter()

    def note(number: int, frame: FrameType | None) -> None:
        owner = ""
        while frame is not None:
            if frame.f_code.co_qualname == evaluation:
                owner = evaluation
                break
            found = _OWNERS.search(frame.f_code.co_filename)
            owner = owner or (found[1].replace("estimators", "rotorfit") if found else "")
            frame = frame.f_back
        counts[owner or "other"] += 1

    before = signal.signal(signal.SIGPROF, note)
    signal.setitimer(signal.ITIMER_PROF, 0.002, 0.002)
    try:
        begin = time.process_time()
        while time.process_time() - begin < seconds:
            run()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    total = sum(counts.values())
    return {owner: count / total for owner, count in counts.most_common()}
