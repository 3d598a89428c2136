"""Standard errors that a plan predicts against the scatter of simulated fits, for every kind of test.

    python benchmarks/plan_errors.py --draws 500

writes results/plan_errors.md and results/plan_errors.csv. The data come from formulas that are written out in
honest_errors.py and tests/rigs/law_data.py, from the matrices of a start-up, and from recorded volts of a rotor that is
integrated in time; none goes through the code that plans. Fits know of the noise what a user's fits know: sigma where
"given", nothing of what runs differ by. Of runs that differ a fit may take one difference for another, the more easily
the fewer runs there are: such fits are counted, and are not in the ratios. Exit status 1 says that a ratio of standard
deviations is outside 0.9 to 1.1 by more than three Monte-Carlo errors.

    python benchmarks/plan_errors.py --draws 500 --only "sweeps, oil"

makes the rows of these cases anew and takes the others from the CSV.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
sys.path.insert(0, str(HERE.parent / "tests" / "rigs"))  # the formulas live with the tests

import honest_errors  # noqa: E402
import nonlinear_coverage  # noqa: E402
import start_ups  # noqa: E402
from reporting import RESULTS, environment, table, write_csv  # noqa: E402

import rotorfit as rf  # noqa: E402
from rotorfit.lab.data.rows import Experiment  # noqa: E402
from rotorfit.lab.simulation.instruments import record  # noqa: E402
from rotorfit.lab.simulation.recorded_kinds import dwell  # noqa: E402
from rotorfit.lab.simulation.rig import RecordedRig  # noqa: E402

LOW, HIGH = 0.9, 1.1
"""Ratio of the scatter to the standard error that a plan promises."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One kind of test with one kind of noise.

    Attributes:
        model, truth, known: the rotor.
        draw: a simulated test, or several, by seed.
        pattern: what the plan is given.
        noise: noise that the plan is given.
        start: whether fits begin at the truth.
    """

    model: rf.models.RotorModel
    truth: Mapping[str, float]
    known: Mapping[str, float]
    draw: Callable[[int], list[Experiment]]
    pattern: list[Experiment]
    noise: Mapping[str, Any]
    start: bool = False


def sweeps(noise: Mapping[str, Any], **world: Any) -> Case:
    """Sweeps of one mode at two speeds, whose readings go wrong as a world of honest_errors.py says."""
    made = honest_errors.World(**world)
    exact = np.concatenate(honest_errors.responses(made, made.truth))
    rms_um = float(np.sqrt(np.mean(np.abs(exact) ** 2))) * 1e6
    given = {name: value * rms_um if name == "noise_um" else value for name, value in noise.items()}
    return Case(
        model=rf.models.OneMode(),
        truth=made.truth,
        known={name: made.truth[name] for name in ("K", "Ds")},
        draw=lambda seed: [honest_errors.simulate(made, np.random.default_rng(seed))],
        pattern=[honest_errors.simulate(made, np.random.default_rng(0))],
        noise=given,
    )


def nonlinear(name: str) -> Case:
    """A rotor with a law of eccentricity."""
    model, truth, exact, known = nonlinear_coverage.cases()[name]

    def draw(seed: int) -> list[Experiment]:
        rng = np.random.default_rng(seed)
        return [nonlinear_coverage.noisy(test, rng) for test in exact]

    return Case(model=model, truth=truth, known=known, draw=draw, pattern=exact, noise={}, start=True)


def run_ups() -> Case:
    """Differenced start-ups of two disks."""

    def draw(seed: int) -> list[Experiment]:
        return [rf.difference_synchronous(start_ups.start_ups(seed, reference=False, sigma_given=True))]

    truth = start_ups.TRUTH
    known = {name: truth[name] for name in ("beta1", "beta2")}
    return Case(model=start_ups.MODEL, truth=truth, known=known, draw=draw, pattern=draw(0), noise={})


def recordings() -> Case:
    """Dwells at steady frequencies, recorded in volts; the plan has one earlier recording with its sigma as pattern."""
    model, truth = rf.models.OneMode(), honest_errors.TRUTH
    how = rf.Instruments(sample_rate=2560.0, noise=8e-3, keyphasor_noise=0.01, runout=(0.0,), wander=0.0)
    rng = np.random.default_rng(0)
    rig = RecordedRig(model=model, theta=model.vector(truth), rng=rng, instruments=how, residual=0.0)
    seconds = 4.0
    played = list(
        dwell(
            rig,
            speed_rpm=1000.0,
            frequency_rpm=[310, 620, 780, 1230, 1410, 1620, 1830],
            duration=seconds,
            unbalance=1e-5,
        )
    )

    def draw(seed: int) -> list[Experiment]:
        rng = np.random.default_rng(seed)
        with tempfile.TemporaryDirectory() as folder:
            paths = [record(one, how, Path(folder), rng) for one in played]
            return [rf.responses([rf.read_recording(path) for path in paths])]

    known = {name: truth[name] for name in ("K", "Ds")}
    return Case(model=model, truth=truth, known=known, draw=draw, pattern=draw(0), noise={})


CASES: dict[str, Callable[[], Case]] = {
    "sweeps, equal noise, given": lambda: sweeps({"noise_um": 0.005}, constant=0.005, sigma_given=True),
    "sweeps, equal noise": lambda: sweeps({"noise_um": 0.005}, constant=0.005),
    "sweeps, proportional noise 1 %": lambda: sweeps({"noise_share": 0.01}, proportional=0.01),
    "sweeps, jitter of the force 1 %": lambda: sweeps(
        {"noise_um": 0.002, "common_share": 0.01}, constant=0.002, force_jitter=0.01
    ),
    "sweeps, overlapping filters 0.7, 0.4, 0.1": lambda: sweeps(
        {"noise_um": 0.005, "memory": (0.7, 0.4, 0.1)}, constant=0.005, filters=0.3, sigma_given=True
    ),
    "sweeps, oil 1 % from run to run, 12 runs": lambda: sweeps(
        {"noise_um": 0.0035, "runs": {"fluid": 0.01}}, constant=0.0035, oil=0.01, repeats=3
    ),
    "sweeps, force 1 % from run to run, 12 runs": lambda: sweeps(
        {"noise_um": 0.0035, "runs": {"force": 0.01}}, constant=0.0035, gain=0.01, repeats=3
    ),
    "sweeps, speed label 0.5 % from run to run, 12 runs": lambda: sweeps(
        {"noise_um": 0.0035, "runs": {"lam": 0.005}}, constant=0.0035, label=0.005, repeats=3
    ),
    "sweeps, oil 1 % from run to run, 4 runs": lambda: sweeps(
        {"noise_um": 0.0035, "runs": {"fluid": 0.01}}, constant=0.0035, oil=0.01
    ),
    "sweeps, force 1 % from run to run, 4 runs": lambda: sweeps(
        {"noise_um": 0.0035, "runs": {"force": 0.01}}, constant=0.0035, gain=0.01
    ),
    "sweeps, speed label 0.5 % from run to run, 4 runs": lambda: sweeps(
        {"noise_um": 0.0035, "runs": {"lam": 0.005}}, constant=0.0035, label=0.005
    ),
    "start-ups of two disks, differenced": run_ups,
    "amplitude sweeps, four levels": lambda: nonlinear("sweeps, four levels"),
    "amplitude sweeps of two planes": lambda: nonlinear("sweeps of two planes"),
    "static loads": lambda: nonlinear("static loads (M, Mf, D known)"),
    "impulses": lambda: nonlinear("impulses (M, Mf known)"),
    "imposed orbits (squeeze film)": lambda: nonlinear("squeeze film (M, lam, b known)"),
    "sweeps, loads, impulses and orbits in one fit": lambda: nonlinear("all in one fit"),
    "recordings of dwells": recordings,
}
"""Kinds of tests and noise."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One quantity of one case.

    Attributes:
        predicted_percent: standard error by the plan, of the true value.
        ratio: standard deviation of the fits over it.
        ratio_error: Monte-Carlo error of that, from the fourth moment.
        failures: fits that did not converge.
        renamed: fits that take what differs between runs for something else; left out of the ratio.
    """

    case: str
    quantity: str
    predicted_percent: float
    ratio: float
    ratio_error: float
    failures: int
    renamed: int = 0

    @property
    def kept(self) -> bool:
        """True if the ratio is within what is promised, to three Monte-Carlo errors."""
        return LOW - 3 * self.ratio_error <= self.ratio <= HIGH + 3 * self.ratio_error


def study(name: str, draws: int) -> list[Row]:
    """All quantities of a case."""
    case = CASES[name]()
    free = {key: value for key, value in case.truth.items() if key not in case.known}
    plan = rf.plan(case.model, free, case.pattern, known=case.known, causes=None, **case.noise)
    wanted = [key for key in plan.expected if np.isfinite(plan.expected[key].stderr)]
    differing = {f"run_{kind}" for kind in case.noise.get("runs", ())}
    found, failures, renamed = [], 0, 0
    for seed in range(1, draws + 1):
        options = {"known": case.known, "causes": None} | ({"start": free} if case.start else {})
        fit = rf.fit(case.model, case.draw(seed), **options)
        failures += not fit.success
        if differing and {effect.kind for effect in fit.noise.effects} - differing:
            renamed += 1
            continue
        found.append([fit.threshold_speed().value if k == "threshold_speed" else fit.params[k].value for k in wanted])
    values = np.array(found)
    rows = []
    for key, column in zip(wanted, values.T, strict=True):
        away = column - column.mean()
        spread = column.std(ddof=1)
        kurtosis = float(np.mean(away**4) / np.mean(away**2) ** 2)
        ratio = float(spread / plan.expected[key].stderr)
        rows.append(
            Row(
                case=name, quantity=key, predicted_percent=100 * plan.expected[key].relative, ratio=ratio,
                ratio_error=ratio * float(np.sqrt(max(kurtosis - 1, 0.5) / len(values))) / 2, failures=failures,
                renamed=renamed,
            )
        )  # fmt: skip
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Run all cases, or those named, and write the table of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--only", help="cases whose name begins so; the others' rows are those of the CSV")
    options = parser.parse_args(arguments)
    names = [name for name in CASES if name.startswith(options.only or "")]
    rows = []
    for name in names:
        some = study(name, options.draws)
        rows += some
        for row in some:
            mark = "" if row.kept else "  MISSED"
            print(f"{row.case:46} {row.quantity:16} {row.ratio:.3f} +- {row.ratio_error:.3f}{mark}", flush=True)
    write(rows if options.only is None else [*rows, *written(names)], options.draws)
    return int(not all(row.kept for row in rows))


def written(names: list[str]) -> list[Row]:
    """Rows of the CSV, those of some cases left out."""
    with (RESULTS / "plan_errors.csv").open(encoding="utf-8") as stream:
        old = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    kinds = {field.name: {"str": str, "int": int, "float": float}[str(field.type)] for field in fields(Row)}
    return [Row(**{key: kinds[key](value) for key, value in row.items()}) for row in old if row["case"] not in names]


def write(rows: list[Row], draws: int) -> None:
    """Write the table, a row a case."""
    command = f"`python benchmarks/plan_errors.py --draws {draws}`. {environment('numpy', 'scipy')}"
    cells = []
    for name in (name for name in CASES if any(row.case == name for row in rows)):
        own = [row for row in rows if row.case == name]
        ratios = [row.ratio for row in own]
        middle = float(np.sqrt(np.mean(np.square(ratios))))
        missed = [row.quantity for row in own if not row.kept]
        errors = f"{min(r.predicted_percent for r in own):.2g} to {max(r.predicted_percent for r in own):.2g} %"
        cells.append(
            [
                name, str(len(own)), errors, f"{middle:.3f}", f"{min(ratios):.3f} to {max(ratios):.3f}",
                f"{max(row.ratio_error for row in own):.3f}", ", ".join(missed) or "-", str(own[0].failures),
                str(own[0].renamed) if "run to run" in name else "-",
            ]
        )  # fmt: skip
    head = [
        "test and noise", "quantities", "predicted errors", "rms ratio", "ratios", "their Monte-Carlo error",
        f"outside {LOW} to {HIGH}", "fits that failed", "fits that name another difference",
    ]  # fmt: skip
    text = [
        "# Predicted errors of plans against the scatter of fits",
        "",
        f"Standard deviation of {draws} simulated fits over the standard error that `rf.plan` predicts, of all "
        "parameters and the threshold speed.",
        "",
        *table(head, cells),
        "",
        command,
    ]
    (RESULTS / "plan_errors.md").write_text("\n".join(text) + "\n", encoding="utf-8")
    write_csv(rows, RESULTS / "plan_errors.csv", command)


if __name__ == "__main__":
    sys.exit(main())
