"""Stiffness and damping of two unknown orthotropic supports of a known shaft, with the fluid between them.

    python benchmarks/unknown_supports.py --draws 100

writes results/unknown_supports.md. A finite-element shaft with two disks and a seal in two supports that differ in x
and y (tests/supported_shaft.py, full matrices with x and y apart): 8 accelerometers along x at rest, then probes in x
and y at supports and seal at two speeds, 2 % noise. Exit status 1 says that errors or coverage are off.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from scipy import stats

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
sys.path.insert(0, str(HERE.parent / "tests"))  # the rig lives with the tests

from reporting import RESULTS, environment  # noqa: E402
from supported_shaft import FLUID, along_axes, at_rest, model, rotating  # noqa: E402

import rotorfit as rf  # noqa: E402

TAIL = 1e-2
"""Chance that exact intervals fail the limit of coverage, over all of them together."""


def draw(seed: int) -> tuple[dict[str, tuple[float, bool]], float]:
    """Relative error and whether the 95 % interval holds, by quantity; CPU time of the fit, s."""
    rng = np.random.default_rng(seed)
    tests = [at_rest(rng), rotating(rng)]
    begin = time.process_time()
    fit = rf.fit(model(), tests)
    spent = time.process_time() - begin
    found = {name: (fit.derive(lambda p, name=name: getattr(p, name)), truth) for name, truth in FLUID.items()}
    half = stats.norm.ppf(0.975)
    return {
        name: (q.value / truth - 1, bool(abs(q.value - truth) < half * q.stderr))
        for name, (q, truth) in (along_axes(fit) | found).items()
    }, spent


def main() -> int:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=100)
    draws = parser.parse_args().draws
    every = [draw(seed) for seed in range(draws)]
    names = list(every[0][0])
    held = {name: np.mean([one[name][1] for one, _ in every]) for name in names}
    worst = {name: max(abs(one[name][0]) for one, _ in every) for name in names}
    low, high = stats.binom.ppf([TAIL / 2 / len(names), 1 - TAIL / 2 / len(names)], draws, 0.95) / draws
    lines = [
        "# Unknown supports of a known shaft",
        "",
        f"{draws} draws, {environment('numpy', 'scipy')}. 8 accelerometers along x at rest (150 lines), x and y at "
        "three planes at two speeds forward and backward (80 lines), 2 % noise. A fit takes "
        f"{np.median([t for _, t in every]):.1f} s of processor time (median). Coverage within {low:.2f} to {high:.2f} "
        "is sampling error.",
        "",
        "| quantity | largest error | 95 % interval holds |",
        "| --- | --- | --- |",
        *(f"| {name} | {100 * worst[name]:.2f} % | {held[name]:.2f} |" for name in names),
        "",
    ]
    good = all(low <= held[name] <= high for name in names)
    good = good and all(worst[name] < (0.01 if name[0] == "k" else 0.05) for name in names if " " in name)
    verdict = "within 1 % (stiffness) and 5 % (damping), and coverage within sampling error" if good else "NOT within"
    lines += [f"All supports: {verdict}.", ""]
    (RESULTS / "unknown_supports.md").write_text("\n".join(lines), encoding="utf-8")
    print("\n".join(lines))
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
