"""Coverage of the coefficients of a seal on a floating stator, with a dry run taken out.

    python benchmarks/floating_stator.py --draws 60

writes results/floating_stator.md and results/floating_stator.csv. The rig (tests/rigs/seal_rig.py) has a stator of 14
kg on rods, a pipe that resonates at 90 Hz and 3 % of cross-talk between its shakers; it is shaken along x, then y, at
three speeds and dry, with 0.1 % of noise in the forces and 0.15 um in the motion. 24 coefficients a draw, and whether
the noise is given or found. Exit status 1 says that coverage is off by more than sampling error.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
sys.path.insert(0, str(HERE.parent / "tests" / "rigs"))  # the rig lives with the tests

from reporting import RESULTS, environment, table, write_csv  # noqa: E402
from seal_rig import FLUID, floating_stator  # noqa: E402

import rotorfit as rf  # noqa: E402

SPEEDS = (1500.0, 3000.0, 4500.0)
HZ = np.linspace(20.0, 200.0, 37)
NAMES = [kind + row + column for kind in "KD" for row in "xy" for column in "xy"]
NOISE: dict[str, Any] = {"force_noise": 0.6, "motion_noise": 0.15}
SAID: dict[str, Any] = {"force_sigma": 0.6, "sigma_um": 0.15}
CASES: dict[str, dict[str, Any]] = {
    "dry run at rest, the same 37 lines": {},
    "dry run at each speed": {"dry_speeds": SPEEDS},
    "dry run at 31 other lines": {"dry_lines": 31},
    "dry run at 60 other lines": {"dry_lines": 60},
    "noise of motion not given": {"said": {"force_sigma": 0.6}},
    "cross-talk of 10 %": {"cross_talk": 0.1},
}


@dataclass(frozen=True, kw_only=True)
class Row:
    """One way of testing.

    Attributes:
        test: what is done.
        covered: share of the 95 % intervals that hold the truth.
        pull: rms of the deviations over their standard errors.
        largest: largest of these.
        redchi: mean.
    """

    test: str
    covered: float
    pull: float
    largest: float
    redchi: float


def draw(seed: int, case: dict[str, Any]) -> rf.FitResult:
    """The fit of one draw."""
    options = {**NOISE, **case.get("said", SAID), "cross_talk": case.get("cross_talk", 0.03)}
    wet = rf.read(floating_stator(speeds_rpm=SPEEDS, frequency_hz=HZ, seed=2 * seed, **options))
    lines = np.linspace(HZ[0], HZ[-1], case.get("dry_lines", HZ.size))
    at = case.get("dry_speeds", (0.0,))
    dry = rf.read(floating_stator(speeds_rpm=at, frequency_hz=lines, fluid=None, seed=2 * seed + 1, **options))
    known = {f"M{i}{j}": 0.0 for i in "xy" for j in "xy"}
    model = rf.models.Anisotropic(("stator",))
    return rf.fit(model, wet, baseline=dry, known=known, per=dict.fromkeys(NAMES, "speed_rpm"))


def study(test: str, draws: int) -> Row:
    """Coverage over so many draws."""
    inside, pulls, redchi = [], [], []
    for seed in range(draws):
        fit = draw(seed, CASES[test])
        redchi.append(fit.redchi)
        for rpm in SPEEDS:
            for name in NAMES:
                p, truth = fit.params[f"{name}[speed_rpm={rpm:g}]"], FLUID(rpm)[name]
                low, high = p.interval(0.95, share="noise")
                inside.append(low <= truth <= high)
                pulls.append((p.value - truth) / p.stderr)
    return Row(
        test=test,
        covered=float(np.mean(inside)),
        pull=float(np.sqrt(np.mean(np.square(pulls)))),
        largest=float(np.abs(pulls).max()),
        redchi=float(np.mean(redchi)),
    )


def main() -> int:
    """Write the table; exit status 1 where an interval holds the truth too seldom."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=60, metavar="N")
    draws = parser.parse_args().draws
    rows = [study(test, draws) for test in CASES]
    # Coefficients of one draw hang together by the dry run: as if 8 of 24 were independent.
    margin = 3 * np.sqrt(0.05 * 0.95 / (8 * draws))
    least = 0.95 - margin
    off = [row.test for row in rows if row.covered < least]
    words = f"{draws} draws of 24 coefficients each, {environment('numpy', 'scipy')}. "
    words += f"Shares down to {least:.3f} are sampling error."
    cells = [[row.test, *(f"{getattr(row, f.name):.3f}" for f in fields(Row)[1:])] for row in rows]
    verdict = f"Too seldom covered: {', '.join(off)}." if off else "All coverage is within sampling error, or above."
    lines = ["# Floating stator", "", words, "", *table([f.name for f in fields(Row)], cells), "", verdict, ""]
    (RESULTS / "floating_stator.md").write_text("\n".join(lines), encoding="utf-8")
    write_csv(rows, RESULTS / "floating_stator.csv", f"python benchmarks/floating_stator.py --draws {draws}", words)
    print("\n".join(lines))
    return 1 if off else 0


if __name__ == "__main__":
    sys.exit(main())
