"""Stiffness and damping of two unknown orthotropic supports of a known shaft, with the fluid between them.

    python benchmarks/unknown_supports.py --draws 100
    python benchmarks/unknown_supports.py --draws 100 --magnetic

writes results/unknown_supports.md; with --magnetic the supports are magnetic bearings, of which gains and delay are
fitted, and the table is results/magnetic_bearings.md. A finite-element shaft with two disks and a seal in two supports
that differ in x and y (tests/rigs/supported_shaft.py, full matrices with x and y apart): 8 accelerometers along x at
rest, then probes in x and y at supports and seal at two speeds, 2 % noise. Exit status 1: errors or coverage are off.
"""

from __future__ import annotations

import argparse
import re
import sys
import time
from pathlib import Path

import numpy as np
from scipy import stats

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
sys.path.insert(0, str(HERE.parent / "tests" / "rigs"))  # the rig lives with the tests

from reporting import RESULTS, environment  # noqa: E402
from supported_shaft import FLUID, along_axes, at_rest, magnets, model, rotating  # noqa: E402

import rotorfit as rf  # noqa: E402

TAIL = 1e-2
"""Chance that exact intervals fail the limit of coverage, over all of them together."""


def draw(seed: int, magnetic: bool) -> tuple[dict[str, tuple[float, bool]], float]:
    """Relative error and whether the 95 % interval holds, by quantity; CPU time of the fit, s."""
    rng = np.random.default_rng(seed)
    tests = [at_rest(rng, magnetic=magnetic), rotating(rng, magnetic=magnetic)]
    own = magnets() if magnetic else {}
    begin = time.process_time()
    fit = rf.fit(model(magnetic), tests, known={name: value for name, value in own.items() if name.startswith("Km")})
    spent = time.process_time() - begin
    truths = {name: value for name, value in (own | FLUID).items() if fit.params[name].vary}
    found = {name: (fit.derive(lambda p, name=name: getattr(p, name)), truth) for name, truth in truths.items()}
    half = stats.norm.ppf(0.975)
    return {
        name: (q.value / truth - 1, bool(abs(q.value - truth) < half * q.stderr))
        for name, (q, truth) in ((along_axes(fit) if not magnetic else {}) | found).items()
    }, spent


def main() -> int:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--magnetic", action="store_true")
    given = parser.parse_args()
    draws = given.draws
    every = [draw(seed, given.magnetic) for seed in range(draws)]
    names = list(every[0][0])
    held = {name: np.mean([one[name][1] for one, _ in every]) for name in names}
    worst = {name: max(abs(one[name][0]) for one, _ in every) for name in names}
    low, high = stats.binom.ppf([TAIL / 2 / len(names), 1 - TAIL / 2 / len(names)], draws, 0.95) / draws
    lines = [
        f"# Unknown {'magnetic bearings' if given.magnetic else 'supports'} of a known shaft",
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
    limits = {"k": (0.01, "stiffness"), "c": (0.05, "damping"), "Kp": (0.01, "gain"), "Kd": (0.02, "its derivative's")}
    limits |= {"tau": (0.1, "delay")}
    asked = {kind: limits[kind] for name in names if (kind := re.split(r"[xy] |_", name)[0]) in limits}
    good = good and all(worst[n] < asked.get(re.split(r"[xy] |_", n)[0], (np.inf,))[0] for n in names)
    within = ", ".join(f"{100 * size:.0f} % ({what})" for size, what in asked.values())
    verdict = f"within {within}, and coverage within sampling error" if good else "NOT within"
    lines += [f"All supports: {verdict}.", ""]
    (RESULTS / f"{'magnetic_bearings' if given.magnetic else 'unknown_supports'}.md").write_text(
        "\n".join(lines), encoding="utf-8"
    )
    print("\n".join(lines))
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
