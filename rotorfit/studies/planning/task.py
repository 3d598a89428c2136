"""A plan worked out: the problem of patterns and design, shares of its time, and the errors that these leave."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rotorfit.base.array_types import Bool, Float, Index
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.inference.covariance import prior_curvature, standard_error
from rotorfit.estimators.inference.identifiability import UNSEEN_CHANGE
from rotorfit.estimators.inference.optimal_shares import Lines, optimal_shares
from rotorfit.estimators.misfit.parameter_space import parameter_space
from rotorfit.identify.diagnosis.orbits import SYNCHRONOUS_DISTANCE
from rotorfit.identify.fitting.causes.solution import SolvedCauses
from rotorfit.identify.fitting.quantities import ErrorBar
from rotorfit.identify.fitting.settings import FitSettings
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import Experiment
from rotorfit.models import RotorModel
from rotorfit.studies.planning.design import Design, candidate_test, line_times
from rotorfit.studies.planning.expectation import Expectation, expect
from rotorfit.studies.planning.guesses import Values, guess
from rotorfit.studies.planning.noise import PlannedNoise
from rotorfit.studies.planning.record import ExpectedError, Plan, PlannedLines
from rotorfit.studies.planning.targets import Target, Wanted, all_targets


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """Input of a plan."""

    model: RotorModel
    values: Values
    patterns: tuple[Experiment, ...]
    settings: FitSettings
    noise: PlannedNoise
    quantity: Wanted
    even: float
    draws: int
    seed: int
    band: float  # modulus of eigenvalues that count, rad/s
    before: Mapping[str, float] | None = None  # sizes of causes of an earlier fit

    def expect(self, *further: Experiment, draws: int | None = None) -> Expectation:
        """The problem of the patterns and further tests."""
        tests, count = (*self.patterns, *further), self.draws if draws is None else draws
        how = (self.noise, count, self.seed, self.band, self.before)
        return expect(self.model, tests, self.settings, self.values, *how)

    def candidates(self, design: Design) -> PerturbationTest:
        """All lines of a design."""
        return candidate_test(design, self.model, self.vector(), self.band)

    def vector(self) -> Float:
        """The likeliest parameters, shape ``(P,)``."""
        space = parameter_space(self.model, known=self.settings.held, bounds={}, groups=[{}])
        return np.asarray(space.theta(guess(space, self.values, self.draws, self.seed).centre)[0])

    def lines(
        self, found: Expectation, asked: Sequence[Target], first: int, beside: Bool | None = None
    ) -> tuple[Lines, Float]:
        """Lines from the first reading of the design on, those before it as information that is there; and their draws.
        Draws at which less is determined than at others, because the rotor is unstable, are left out, and those without
        a threshold speed where it is asked for. ``beside``: causes that are further entries, each in its own size."""
        draws = found.guess.draws
        rows, line = found.rows(draws), np.repeat(found.line, 2)
        known = prior_curvature(found.problem, found.guess.centre)
        entries = np.arange(known.size)
        if beside is not None and beside.any():
            entries = np.append(entries, known.size + np.flatnonzero(beside))
            known = np.concatenate([known, np.ones(int(beside.sum()))])
            rows = np.concatenate([rows, found.columns(draws)[:, :, beside]], axis=2)
        gradients = np.array([[found.slopes(target, x)[entries] for target in asked] for x in draws])
        gradients = gradients.reshape(len(draws), len(asked), known.size)
        own = slice(2 * first, None)
        earlier = rows[:, : 2 * first]
        fixed = np.diag(known) + np.swapaxes(earlier, 1, 2) @ earlier
        whole = Lines(rows=rows[:, own], line=line[own] - line[own].min(), fixed=fixed, gradients=gradients)
        rank = whole.rank()
        kept = np.asarray((rank == rank.max()) & np.all(np.any(gradients != 0, axis=2), axis=1))
        if not kept.any():
            raise ValueError(
                f"at none of {len(draws)} draws of the values the test determines the quantity: narrow the ranges, or "
                "begin at lower speeds"
            )
        return whole.of_draws(kept), draws[kept]

    def solved(self, design: Design | None) -> Plan:
        """The plan without suggestions."""
        test = None if design is None else self.candidates(design)
        found = self.expect(*(() if test is None else (test,)))
        targets, names = all_targets(found.problem.space, self.quantity, self.band)
        first = 0 if test is None else sum(b.measured.size for b in found.problem.blocks[: len(self.patterns)])
        alike = errors_of(found, targets)
        open_ = [name for name in names if not math.isfinite(alike[name].stderr)]
        asked = [targets[name] for name in names if name not in open_]
        # What no line tells no line lowers: it has no say in what deserves the time.
        lines, _ = self.lines(found, asked, first, found.told if asked else None)
        whole = self.lines(found, asked, first, found.told | True)
        shares = optimal_shares(lines, self.even if not open_ or asked else 1.0)
        factor = np.ones(found.constant.size)
        table = _table(found, first)
        expected, planned, weight = alike, None, np.ones(shares.share.size)
        if design is not None and test is not None:
            weight = shares.share * shares.share.size
            factor[first:] = weight[lines.line[::2]]
            found = found.longer(factor)
            expected = errors_of(found, targets)
            table, planned = _timed(self, design, test, table, weight, _sizes(found, test))
        runs = len(dict.fromkeys(table.run))
        total = math.nan if design is None else float(table.time.sum()) + design.change_s * runs
        return Plan(
            model=self.model,
            quantity=names,
            expected=_with_ranges(with_floors(expected, found, targets), found, targets, *whole, weight),
            even=alike,
            lines=table,
            share=shares.share,
            certificate=shares,
            identifiability=found.errors()[1],
            suggestions=(),
            notes=(
                *(f"{name} stays open." for name in open_),
                *_unsteady(found),
                *([] if design is None else _of_design(found, first, design)),
            ),
            time_s=total,
            test=planned,
            expectation=found,
        )


def errors_of(found: Expectation, targets: Mapping[str, Target]) -> dict[str, ExpectedError]:
    """Expected errors of quantities, infinite where the test leaves them open."""
    covar, verdict = found.errors()
    null, centre = verdict.null_space, found.guess.centre
    result = {}
    for name, target in targets.items():
        value, slope = target.at(centre)
        leak = float(np.abs(slope[: null.shape[0]] @ null).max(initial=0.0)) if null.size else 0.0
        if leak > UNSEEN_CHANGE * abs(value) or math.isnan(value):
            result[name] = ExpectedError(value, math.inf, target.unit)
            continue
        noise, bar = float(standard_error(slope, covar)), None
        if found.solved is not None:
            bar = _bar(found.solved, noise, slope, target.by_causes(centre, found.solved))
        result[name] = ExpectedError(value, noise if bar is None else bar.stderr, target.unit, bar=bar)
    return result


def with_floors(
    expected: Mapping[str, ExpectedError], found: Expectation, targets: Mapping[str, Target]
) -> dict[str, ExpectedError]:
    """The errors with what of them stays however long is averaged."""
    ages = 1e4  # of averaging: noise falls to a hundredth
    ahead = found.longer(np.full(found.constant.size, ages))
    floors = errors_of(ahead, targets) if found.causes else {}
    return {name: replace(one, floor=floors[name].bar) if name in floors else one for name, one in expected.items()}


def _bar(solved: SolvedCauses, noise: float, by_values: Float, by_causes: Float) -> ErrorBar:
    names = [cause.name for cause in solved.causes]
    return ErrorBar.of(solved.errors, names, noise, solved.errors.along(by_values, by_causes))


def _with_ranges(
    expected: Mapping[str, ExpectedError],
    found: Expectation,
    targets: Mapping[str, Target],
    lines: Lines,
    draws: Float,
    weight: Float,
) -> dict[str, ExpectedError]:
    """The errors with their ranges over the draws."""
    result = {name: replace(one, low=one.stderr, high=one.stderr) for name, one in expected.items()}
    if len(draws) > 1:
        covar = lines.covariance(weight)
        for name, one in expected.items():
            if math.isfinite(one.stderr):
                slopes = np.array([found.slopes(targets[name], x) for x in draws])
                errors = np.sqrt(np.einsum("di,dij,dj->d", slopes, covar, slopes))
                result[name] = replace(one, low=float(errors.min()), high=float(errors.max()))
    return result


def _table(found: Expectation, first: int) -> PlannedLines:
    """Lines from a reading on, without times."""
    reading = np.unique(found.line, return_index=True)[1]
    reading = reading[reading >= first]
    speed, frequency = np.concatenate([_places(block) for block in found.problem.blocks], axis=1)[:, reading]
    runs, nothing = tuple(found.problem.run[reading].tolist()), np.full(reading.size, np.nan)
    return PlannedLines(run=runs, speed=speed, frequency=frequency, settle=nothing, average=nothing)


def _places(block: Any) -> Float:
    """Speed, NaN where there is none, and frequency of readings, of free vibration its own, shape ``(2, R)``."""
    base = block.responses or block
    line = getattr(base, "line", None)
    at = line if line is not None and line.dtype.kind == "i" else slice(None)
    speed, frequency = getattr(base, "speed", None), getattr(base, "frequency", None)
    at_speed = np.full(block.measured.size, np.nan) if speed is None else speed[at]
    return np.stack([at_speed, np.imag(block.measured) if frequency is None else frequency[at]])


def _timed(
    task: Task, design: Design, test: PerturbationTest, table: PlannedLines, weight: Float, sizes: Float
) -> tuple[PlannedLines, PerturbationTest]:
    """The lines with their times, and the test with averaging times and the noise that these leave."""
    first = test.lines_apart[0]
    settle, average = line_times(design, task.model, task.vector(), test, first, task.band)
    line: Index = test.lines_apart[1]
    shared = (average * weight)[line]
    relative = math.hypot(task.noise.share_of(test), task.noise.common)
    sigma = np.hypot(task.noise.of_rows(test), relative * sizes) / np.sqrt(weight[line])
    planned = replace(test, sigma=sigma, attributes={"average_s": shared}, source="plan")
    return replace(table, settle=settle, average=average * weight), planned


def _sizes(found: Expectation, test: PerturbationTest) -> Float:
    """Expected size of each row of the design's test, m."""
    model, block = found.problem.space.model, found.problem.blocks[-1].responses
    if block is None:
        raise ValueError(f"a design needs responses to turning forces, which {model.name} does not give")
    size = np.zeros((block.speed.size, len(model.coordinates)))
    size[block.line, block.coordinate] = np.abs(block.measured)
    turned = model.frame == "z"
    kinds = set(zip(test.plane.tolist(), test.direction.tolist(), strict=True))
    at = {(p, d): model.coordinate(p, (d[:-1] or "z") if turned else d) for p, d in kinds}
    channel = [at[one] for one in zip(test.plane.tolist(), test.direction.tolist(), strict=True)]
    return np.asarray(size[test.lines_apart[1], channel])


def _largest_motion(found: Expectation, first: int, design: Design) -> str:
    """How far the planned forces move the rotor."""
    size = np.abs(found.problem.measured[first:])
    block = found.problem.blocks[-1].responses
    if block is not None:
        size = np.where([block.model.coordinates[i].axis == "r" for i in block.coordinate.tolist()], 0.0, size)
    top = int(np.argmax(size))
    where = "" if block is None else f" at {block.model.coordinates[int(block.coordinate[top])].plane}"
    motion = float(f"{size[top] * 1e6:.3g}")
    said = f"The largest motion is {motion:g} um 0-peak{where}, in {found.problem.blocks[-1].run[top]}"
    # Motion, m, beyond the linear range of usual eddy-current probes, 80 mil or 2 mm from end to end
    probe_range = 1e-3
    if size[top] > probe_range:
        return f"{said}, beyond what probes read: reduce the force, or set clearance_share=."
    return f"{said}." if design.clearance_share is not None else f"{said}; clearance_share= limits it."


def _of_design(found: Expectation, first: int, design: Design) -> list[str]:
    """Cautions for a test by a design."""
    speeds = [v for v in design.speeds.tolist() if (np.abs(design.frequencies - v) <= SYNCHRONOUS_DISTANCE * v).any()]
    near = ", ".join(significant(v * RPM_PER_RAD_S, 5) for v in speeds if v)
    both = [f"Lines at once-per-turn frequency ({near} rpm) hold the residual unbalance too: leave them out."]
    return [*(both if near else []), _largest_motion(found, first, design)]


def _unsteady(found: Expectation) -> list[str]:
    """A caution where the rotor may be unstable at a speed of the test."""
    draws = found.guess.draws
    idle = sum(not found.steady(x).all() for x in draws) if len(draws) > 1 else 0
    words = (
        f"At {idle} of {len(draws)} draws of the values the rotor is unstable at a speed of the test: begin below and "
        "go up only as far as the first results allow."
    )
    return [words] if idle else []
