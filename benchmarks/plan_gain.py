"""Planned tests against even ones of equal time: is the gain as predicted, and is any rig worse off?

    python benchmarks/plan_gain.py --draws 400

writes results/plan_gain.md and results/plan_gain.csv. Six rigs are planned for lam and the threshold speed at three
speeds, all planes, both directions and 30 lines, once from their own values within 20 %, once from guesses that are off
by up to 15 % and known within 30 %. Planned and even tests are simulated and fitted. Exit status 1 says that a gain is
off by more than 10 % of what was predicted from the rig's own values, or below one, by more than three Monte-Carlo
errors.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from reporting import RESULTS, environment, table, write_csv  # noqa: E402
from rigs import RIGS  # noqa: E402

import rotorfit as rf  # noqa: E402
from rotorfit.base.array_types import Float  # noqa: E402
from rotorfit.base.units import RPM_PER_RAD_S  # noqa: E402
from rotorfit.lab.data.experiments import PerturbationTest  # noqa: E402

QUANTITIES = ("lam", "threshold_speed")
ONE, TWO = RIGS["one-mode"], RIGS["whirl-whip"]
CASES: dict[str, tuple[rf.models.RotorModel, Mapping[str, float], tuple[str, ...]]] = {
    "one mode": (ONE.model, ONE.truth, ONE.known),
    "one mode, sharp": (ONE.model, {**ONE.truth, "D": 60.0}, ONE.known),
    "one mode, swirl brakes": (ONE.model, {**ONE.truth, "lam": 0.25, "D": 250.0}, ONE.known),
    "whirl and whip": (TWO.model, TWO.truth, TWO.known),
    "whirl and whip, heavy disk": (TWO.model, {**TWO.truth, "Md": 2.5}, TWO.known),
    "whirl and whip, stiff film": (TWO.model, {**TWO.truth, "K0": 30e3, "D": 900.0}, TWO.known),
}
"""Model, truth and what is known."""
LINES, NOISE_UM, CLEARANCE_UM = 30, 0.3, 200.0


def planned(
    model: rf.models.RotorModel, values: Mapping[str, object], truth: Mapping[str, float], known: tuple[str, ...],
    even: float = 0.3,
) -> rf.Plan:  # fmt: skip
    """The plan of a test at three speeds below the threshold."""
    theta = model.vector(truth)
    onset = rf.models.threshold_speed(model, theta)
    if onset is None:
        raise ValueError("a rig without a threshold speed")
    design = rf.Design(
        speed_rpm=np.array([0.3, 0.5, 0.7]) * onset.speed * RPM_PER_RAD_S,
        frequency_rpm=np.linspace(0.1, 1.2, LINES) * onset.speed * RPM_PER_RAD_S,
        force_N=5.0,
        clearance_share=0.05,
        clearance_um=CLEARANCE_UM,
    )
    given = {name: truth[name] for name in known}
    options = {"noise_um": NOISE_UM, "quantity": QUANTITIES, "known": given, "causes": None}
    return rf.plan(model, values, design, even=even, **options)


def simulated(model: rf.models.RotorModel, theta: Float, test: PerturbationTest, seed: int) -> PerturbationTest:
    """A planned test filled in by the rotor's own matrices and noise."""
    rng = np.random.default_rng(seed)
    receptance = model.receptance(theta, test.frequency, test.speed)
    to, at = (
        np.array([model.coordinate(p, "z") for p in planes.tolist()]) for planes in (test.plane, test.force_plane)
    )
    z = receptance[np.arange(len(test)), to, at] * test.force
    back = test.frequency < 0
    x = np.where(back, z.conj(), z)
    exact = np.where(test.direction == "x", x, np.where(back, 1j, -1j) * x)
    noise = test.sigma * (rng.normal(size=len(test)) + 1j * rng.normal(size=len(test)))
    return replace(test, response=exact + noise, attributes={})


def spread(name: str, plan: rf.Plan, draws: int) -> Float:
    """Standard deviations of the quantities over fits of the planned test, shape ``(2,)``."""
    model, truth, known = CASES[name]
    theta, given = model.vector(truth), {key: truth[key] for key in known}
    found = []
    for seed in range(draws):
        fit = rf.fit(model, simulated(model, theta, plan.test, seed), known=given, causes=None)
        found.append([fit.params["lam"].value, fit.threshold_speed().value])
    return np.asarray(np.std(found, axis=0, ddof=1))


@dataclass(frozen=True, kw_only=True)
class Row:
    """One quantity of one rig.

    Attributes:
        even_percent: scatter of fits of the even test, of the true value.
        predicted: its ratio to that of the planned test, by the plan.
        gain: the same of simulated fits.
        gain_error: Monte-Carlo error of that.
        gain_off: gain of the test that was planned from guesses that are off.
    """

    rig: str
    quantity: str
    even_percent: float
    predicted: float
    gain: float
    gain_error: float
    gain_off: float

    @property
    def kept(self) -> bool:
        """True if the gain is as predicted within 10 %, and neither test is worse than the even one."""
        reach = 3 * self.gain_error / self.gain
        return abs(self.gain / self.predicted - 1) <= 0.1 + reach and min(self.gain, self.gain_off) >= 1 - reach


def study(name: str, draws: int) -> list[Row]:
    """Both quantities of a rig."""
    model, truth, known = CASES[name]
    free = [key for key in truth if key not in known]
    near = {key: (0.8 * truth[key], 1.2 * truth[key]) for key in free}
    rng = np.random.default_rng(len(name))
    guess = {key: truth[key] * (1 + rng.uniform(-0.15, 0.15)) for key in free}
    off = {key: (0.7 * guess[key], 1.3 * guess[key]) for key in free}
    plan, even = planned(model, near, truth, known), planned(model, near, truth, known, even=1.0)
    wrong = planned(model, off, truth, known)
    wide, narrow, other = (spread(name, one, draws) for one in (even, plan, wrong))
    rows = []
    for i, key in enumerate(QUANTITIES):
        gain = float(wide[i] / narrow[i])
        rows.append(
            Row(
                rig=name, quantity=key, even_percent=100 * float(wide[i]) / plan.expected[key].value,
                predicted=plan.even[key].stderr / plan.expected[key].stderr, gain=gain,
                gain_error=gain / float(np.sqrt(draws)), gain_off=float(wide[i] / other[i]),
            )
        )  # fmt: skip
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Run all rigs and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=400)
    draws = parser.parse_args(arguments).draws
    rows = []
    for name in CASES:
        rows += study(name, draws)
        print(rows[-2], rows[-1], sep="\n", flush=True)
    command = f"`python benchmarks/plan_gain.py --draws {draws}`. {environment('numpy', 'scipy')}"
    cells = [
        [
            row.rig, row.quantity, f"{row.even_percent:.2g} %", f"{row.predicted:.2f}",
            f"{row.gain:.2f} +- {row.gain_error:.2f}", f"{row.gain_off:.2f}", "yes" if row.kept else "no",
        ]
        for row in rows
    ]  # fmt: skip
    head = [
        "rig", "quantity", "scatter of the even test", "predicted gain", "gain", "planned from wrong guesses", "kept",
    ]  # fmt: skip
    text = [
        "# Planned tests against even ones of equal time",
        "",
        f"Gain: standard deviation of {draws} fits of the even test over that of as many of the planned one.",
        "",
        *table(head, cells),
        "",
        command,
    ]
    (RESULTS / "plan_gain.md").write_text("\n".join(text) + "\n", encoding="utf-8")
    write_csv(rows, RESULTS / "plan_gain.csv", command)
    return int(not all(row.kept for row in rows))


if __name__ == "__main__":
    sys.exit(main())
