"""The plan of a test: expected errors, lines with their times, sentences; as text, table, file and figure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from rotorfit.base.accessors import Accessor
from rotorfit.base.array_types import Float
from rotorfit.base.atomic_file import whole_file
from rotorfit.base.chance import Seed, seed_of
from rotorfit.base.digits import significant, with_errors
from rotorfit.base.equality import ByValue
from rotorfit.base.names import unknown_name
from rotorfit.base.text_table import Table, Tabled
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.inference.identifiability import Identifiability
from rotorfit.estimators.inference.optimal_shares import Shares
from rotorfit.identify.fitting.quantities import ErrorBar, Quantity
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.models import RotorModel
from rotorfit.studies.planning.expectation import Expectation

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, repr=False)
class ExpectedError(Quantity):
    """A quantity at the guessed values with the standard error that a test will give it."""

    low: float = math.nan  # low, high: range of the standard error over the draws of what is not known
    high: float = math.nan
    bar: ErrorBar | None = field(default=None, compare=False, repr=False)
    floor: ErrorBar | None = field(default=None, compare=False, repr=False)  # what of it no averaging lowers

    @property
    def error(self) -> ErrorBar | None:
        """The error share by share; None without causes."""
        return self.bar

    @property
    def relative(self) -> float:
        """Standard error over value; infinite where the test does not determine the quantity."""
        return abs(self.stderr / self.value) if self.value else math.inf

    @property
    def at_floor(self) -> ExpectedError:
        """With what of the error no averaging lowers."""
        return self if self.floor is None else replace(self, stderr=self.floor.stderr, bar=self.floor)


@dataclass(frozen=True, eq=False, kw_only=True)
class PlannedLines:
    """Lines of a planned test, shape ``(K,)`` each."""

    run: tuple[str, ...]
    speed: Float  # rad/s
    frequency: Float  # rad/s, signed
    settle: Float  # time until the line can be read, s
    average: Float  # averaging time, s

    @property
    def time(self) -> Float:
        """Time of each line, s."""
        return self.settle + self.average


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Plan(ByValue, Tabled):
    """Expected errors of a test, and the best use of its time; see :func:`rotorfit.plan`.

    Attributes:
        model: the rotor.
        quantity: names of what the test is for; empty for all parameters together.
        expected: standard errors of parameters and quantities by name, of the test as planned.
        even: the same with as much time, all lines alike.
        lines: the lines among which the time is shared.
        share: share of the averaging time of each line, shape ``(K,)``.
        certificate: of the equivalence theorem, on the shares.
        identifiability: what the test determines, and what it leaves open.
        suggestions: what to measure, what to add and what it costs, in sentences.
        notes: what a reader must know of these numbers.
        time_s: duration of the test, s; NaN where only experiments were given as patterns.
        test: the planned test, not read yet; None where only experiments were given.
        expectation: the problem that its fit will solve, and the draws of what is not known.
    """

    model: RotorModel
    quantity: tuple[str, ...]
    expected: Mapping[str, ExpectedError]
    even: Mapping[str, ExpectedError]
    lines: PlannedLines
    share: Float
    certificate: Shares
    identifiability: Identifiability
    suggestions: tuple[str, ...]
    notes: tuple[str, ...]
    time_s: float
    test: PerturbationTest | None
    expectation: Expectation = field(repr=False)

    plot = Accessor()

    def to_dataframe(self) -> DataFrame:
        """The lines as a table, units in the names of its columns.

        Example:
            >>> plan = rf.plan(fit.model, fit, rig, noise_um=0.2, quantity="lam")
            >>> list(plan.to_dataframe().columns[:3])
            ['run', 'speed_rpm', 'frequency_rpm']
        """
        from pandas import DataFrame

        return DataFrame(
            {
                "run": self.lines.run,
                "speed_rpm": self.lines.speed * RPM_PER_RAD_S,
                "frequency_rpm": self.lines.frequency * RPM_PER_RAD_S,
                "share": self.share,
                "gain": self.certificate.phi,
                "settle_s": self.lines.settle,
                "average_s": self.lines.average,
            }
        )

    def to_csv(self, path: str | Path) -> None:
        """Write the planned test as a tidy CSV, to fill in amplitudes and phases.

        Args:
            path: of the file.

        Raises:
            ValueError: only experiments were given as patterns, which are files already.

        Example:
            >>> design = rf.Design(speed_rpm=1000, frequency_rpm=[400, 800, 1200], force_N=5.0)
            >>> plan = rf.plan(fit.model, fit, design, noise_um=0.2, quantity="lam")
            >>> plan.to_csv(folder / "planned.csv")
        """
        from rotorfit.lab.io.tables.tidy_csv import write_csv

        if self.test is None:
            raise ValueError("the plan holds experiments that exist; give a Design for a test to fill in")
        with whole_file(Path(path)) as draft:
            write_csv(self.test, draft)

    def virtual_run(
        self, *, values: Mapping[str, float] | None = None, rng: Seed = None, seed: Seed = None
    ) -> PerturbationTest:
        """The planned test as the rotor would fill it in: integrated in time, read with the planned noise.

        Args:
            values: true parameters, SI, where they are not the guessed ones.
            rng: of the noise, a generator or its seed, 0 by default.
            seed: the same.

        Raises:
            ValueError: only experiments were given as patterns; a rotor that is unstable at a speed of the test.
            KeyError: an unknown parameter.

        Example:
            >>> design = rf.Design(speed_rpm=1000, frequency_rpm=range(200, 2001, 100), force_N=5.0)
            >>> plan = rf.plan(fit.model, fit, design, noise_um=0.2, quantity="lam")
            >>> found = rf.fit(fit.model, plan.virtual_run(seed=1), known={"K3": 6000.0}, causes=None)
            >>> abs(found.params["lam"].value - fit.params["lam"].value) < 4 * plan.expected["lam"].stderr
            True
        """
        from rotorfit.studies.planning.virtual_run import virtual_run

        if self.test is None:
            raise ValueError("the plan holds experiments that exist; give a Design for a test to run")
        theta = self.expectation.problem.space.theta(self.expectation.guess.centre)[0]
        for name, value in (values or {}).items():
            if name not in self.model.parameter_names:
                raise KeyError(unknown_name(f"parameter of {self.model.name}", name, self.model.parameter_names))
            theta[self.model.parameter_names.index(name)] = value
        weight = self.share * self.share.size
        return virtual_run(self.model, theta, self.test, self.expectation.noise, weight, seed_of(rng, seed, 0))

    def parts(self) -> list[str | Table]:
        """What is printed."""
        more = ["noise", "bounded", "on trust"] * bool(self.expectation.causes)
        rows = [["", "value", "std error", *more, "relative", "over the draws", "all lines alike", "unit"]]
        for name, one in self.expected.items():
            bar = one.error
            parts = [math.nan] * len(more) if bar is None else [bar.noise, bar.bounded, bar.trust]
            value, error, *sizes = with_errors(one.value, one.stderr, one.stderr, *parts)
            found = math.isfinite(one.stderr)
            shares = [f"{significant(100 * which.relative, 2)} %" if found else "-" for which in (one, self.even[name])]
            ends = [significant(100 * abs(end / one.value), 2) if one.value else "-" for end in (one.low, one.high)]
            span = f"{ends[0]} to {ends[1]} %" if found and one.low < one.high else "-"
            rows.append([name, value, error if found else "open", *sizes, shares[0], span, shares[1], one.unit])
        aim = " and ".join(self.quantity) if self.quantity else "all parameters together"
        hours = "" if math.isnan(self.time_s) else f", {duration(self.time_s)}"
        head = f"plan of a test of {self.model.name} for {aim}: {self.share.size} lines{hours}"
        table = Table(rows, " ".join(["<16 >12 >12", *[">10"] * len(more), ">10 >18 >16 <8"]))
        return [head, table, f"{self.certificate}", *self.suggestions, *self.notes]


def duration(seconds: float) -> str:
    """A time in words, to two digits or so."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    if seconds < 100 * 60:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
