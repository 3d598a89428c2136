"""Sentences of a plan: what to measure, what to add and what that costs, what would settle what stays open."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.identify.fitting.causes.table import size_of
from rotorfit.lab.data.experiments import PerturbationTest, perturbations
from rotorfit.lab.data.rows import Experiment
from rotorfit.models.motion.stability import decay_rate
from rotorfit.studies.planning.design import Design, candidate_test, line_times, too_fast
from rotorfit.studies.planning.record import ExpectedError, Plan, duration
from rotorfit.studies.planning.targets import all_targets
from rotorfit.studies.planning.task import Task, errors_of

Choices: TypeAlias = list[tuple[tuple[float, ...], float]]
"""Choices of speeds, rad/s, best first, each with the standard errors of an even test over that of the best one."""

NAMED = 3  # runs, lines and quantities that a sentence names


@dataclass(frozen=True, eq=False, kw_only=True)
class Addition:
    """A run that could be added."""

    test: PerturbationTest
    time_s: float
    errors: dict[str, ExpectedError]  # with it
    open: int  # combinations that it leaves open

    @property
    def name(self) -> str:
        """Plane, speed and direction."""
        return self.test.runs[0]


def additions(task: Task, plan: Plan, wanted: float | None) -> list[str]:
    """Sentences on runs that would be worth adding, best first, and on what would settle what stays open."""
    tests = [t for t in perturbations(task.patterns) if not t.synchronous and t.force.any()]
    tests = [t for t in tests if t.static_position is None and not t.linear.any()]
    if not tests:
        return _settled(plan, [], False)
    candidates = _candidates(task, tests)
    tried = [_with(task, (), run, time) for run, time in candidates]
    names = plan.quantity or tuple(plan.expected)
    sentences = _settled(plan, tried, bool(plan.identifiability.combinations))
    errors, added = dict(plan.expected), list[PerturbationTest]()
    rounds = NAMED if wanted is not None else 1
    for _ in range(rounds):
        if not tried or (wanted is not None and max(errors[name].relative for name in names) <= wanted):
            break
        order = sorted(tried, key=lambda one: _size(one.errors, names))
        least_gain = 1.05  # ratio of an error to that with a run added from which the run is suggested
        worth = [one for one in order if _size(errors, names) - _size(one.errors, names) > math.log(least_gain)]
        for one in worth[: 1 if wanted is not None else NAMED]:
            changes = [f"{name} {percent(errors[name])} -> {percent(one.errors[name])}" for name in names[:NAMED]]
            size = f"{len(np.unique(one.test.frequency))} lines, {duration(one.time_s)}"
            sentences.append(f"Add {one.name} ({size}): {', '.join(changes)}.")
        if not worth:
            break
        errors, added = worth[0].errors, [*added, worth[0].test]
        left = [(one.test, one.time_s) for one in tried if one.name != worth[0].name]
        tried = [_with(task, added, run, time) for run, time in left] if wanted is not None else []
    return sentences


def _candidates(task: Task, tests: Sequence[PerturbationTest]) -> list[tuple[PerturbationTest, float]]:
    """Runs like those of the tests, at planes, speeds and in directions that these have not, and their times."""
    model, theta = task.model, task.vector()
    most_lines, most_speeds, most_runs = 40, 4, 24  # of a run, of the tests, and of all that are tried
    speeds = np.unique(np.concatenate([np.round(test.speed, 6) for test in tests]))
    # Ratio of a speed that is tried to the lowest and highest of the tests, and room below the threshold speed
    step = 1.3
    speeds = np.unique([*_some(speeds, most_speeds), speeds[0] / step, speeds[-1] * step])
    speeds = speeds[[float(decay_rate(model, theta, step * speed, task.band)) > 0 for speed in speeds.tolist()]]
    w = _some(np.unique(np.concatenate([np.round(np.abs(test.frequency), 6) for test in tests])), most_lines)
    if not speeds.size:
        return []
    read = {(plane, d) for t in tests for plane, d in zip(t.plane.tolist(), t.direction.tolist(), strict=True)}
    probes = tuple(dict.fromkeys(p if d in ("x", "y", "z") else f"{p} {d.replace('z', 'x')}" for p, d in sorted(read)))
    force = np.concatenate([np.abs(test.force) for test in tests])
    like = Design(
        speed_rpm=speeds * RPM_PER_RAD_S,
        frequency_rpm=w * RPM_PER_RAD_S,
        probes=probes,
        force_N=float(np.median(force[force > 0])),
    )
    whole = candidate_test(like, model, theta, task.band)
    there = {
        (plane, speed, forward)
        for test in tests
        for plane, speed, forward in zip(test.force_plane, np.round(test.speed, 4), test.frequency > 0, strict=True)
    }
    found = []
    for name in whole.runs:
        run = whole.select(whole.run == name)
        if (str(run.force_plane[0]), round(float(run.speed[0]), 4), bool(run.frequency[0] > 0)) in there:
            continue
        settle, average = line_times(like, model, theta, run, run.lines_apart[0], task.band)
        found.append((_with_noise(task, run, tests), float(settle.sum() + average.sum())))
    return found[:most_runs]


def _some(values: Float, most: int) -> Float:
    """Some of ascending values, evenly chosen."""
    return np.asarray(values[np.linspace(0, values.size - 1, min(values.size, most)).round().astype(int)])


def _with_noise(task: Task, run: PerturbationTest, tests: Sequence[PerturbationTest]) -> PerturbationTest:
    """A run with the noise that the tests have at each plane, where it is not given for all."""
    if task.noise.additive is not None:
        return run
    sigma = np.full(len(run), np.nan)
    for plane in run.planes:
        known = np.concatenate([test.sigma[test.plane == plane] for test in tests])
        if np.isfinite(known).any():
            sigma[run.plane == plane] = np.nanmedian(known)
    return replace(run, sigma=sigma)


def _with(task: Task, added: Sequence[Experiment], run: PerturbationTest, time_s: float) -> Addition:
    found = task.expect(*added, run, draws=1)
    targets, _ = all_targets(found.problem.space, task.quantity, task.band)
    return Addition(test=run, time_s=time_s, errors=errors_of(found, targets), open=len(found.errors()[1].combinations))


def _size(errors: dict[str, ExpectedError], names: Sequence[str]) -> float:
    """Mean logarithm of the relative errors; those that are open count as a hundred times the value."""
    open_ = 100.0
    return float(np.mean([math.log(min(max(errors[name].relative, 1e-300), open_)) for name in names]))


def percent(error: ExpectedError) -> str:
    """A relative error in words."""
    return f"{significant(100 * error.relative, 2)} %" if math.isfinite(error.relative) else "open"


def _settled(plan: Plan, tried: Sequence[Addition], asked: bool) -> list[str]:
    """Parameters that stay undetermined, and the runs that would determine them."""
    count = len(plan.identifiability.combinations)
    sentences = [
        f"{'Weak' if math.isfinite(one.stderr) else 'Open, however long is averaged'}: {one.message}"
        for one in plan.identifiability.combinations
    ]
    if asked:
        settling = [one.name for one in tried if one.open < count]
        it = "it" if count == 1 else "some of it"
        none = "No further run of rotating forces at these speeds settles it."
        sentences.append(f"One run more would settle {it}: {'; '.join(settling[:NAMED])}." if settling else none)
    return sentences


def _whole_rig(task: Task, plan: Plan, design: Design) -> list[str]:
    """Parameters that a design leaves undetermined, and those that forces at all planes, all probes and both
    directions would determine."""
    sentences = _settled(plan, (), False)
    whole = replace(design, force_planes=None, probes=None, directions=("forward", "backward"))
    if not sentences or whole == design:
        return sentences
    left = len(task.expect(task.candidates(whole)).errors()[1].combinations)
    if left >= len(sentences):
        return [*sentences, "Neither more planes and probes nor the other direction settle it."]
    it = "some of it" if left else "it"
    return [*sentences, f"Forces at all planes, all probes and both directions would settle {it}."]


def suggest(task: Task, plan: Plan, design: Design | None, choices: Choices, wanted: float | None) -> tuple[str, ...]:
    """All sentences of a plan."""
    found = [_speeds(plan, choices)] if choices else []
    runs = np.array(plan.lines.run)
    shares = {name: float(plan.share[runs == name].sum()) for name in dict.fromkeys(plan.lines.run)}
    if design is not None:
        found += _runs(plan, shares)
        slow = too_fast(design, task.model, task.vector(), task.band)
        found += [slow] if slow else []
    elif len(shares) > 1:  # tests are given as they are
        best, share = max(shares.items(), key=lambda one: one[1])
        found.append(f"Run {best} determines most of {_aim(plan)}: {share:.0%} of any further time would go there.")
    found += [*_for_wanted(task, plan, wanted), *_floors(plan)]
    return (*found, *(additions(task, plan, wanted) if design is None else _whole_rig(task, plan, design)))


def _aim(plan: Plan) -> str:
    return " and ".join(plan.quantity) if plan.quantity else "all parameters together"


def _speeds(plan: Plan, choices: Choices) -> str:
    (best, _), (worst, ratio) = choices[0], choices[-1]
    return (
        f"Run at {_listed(best)} rpm: of {len(choices)} choices of {len(best)} speeds these leave the smallest errors "
        f"of {_aim(plan)}; with {_listed(worst)} rpm they are {significant(ratio, 2)} times as large."
    )


def _listed(speeds: tuple[float, ...]) -> str:
    words = [significant(speed * RPM_PER_RAD_S, 5) for speed in speeds]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _runs(plan: Plan, shares: Mapping[str, float]) -> list[str]:
    """Runs that deserve most of the time, and the lines in them."""
    runs = np.array(plan.lines.run)
    clear = 2.0  # share of a line over that of an even test from which it is named
    sentences = []
    for name in sorted(shares, key=lambda name: -shares[name])[:NAMED]:
        own = np.flatnonzero(runs == name)
        rich = own[plan.share[own] * plan.share.size > clear]
        at = sorted({float(f"{abs(w) * RPM_PER_RAD_S:.4g}") for w in plan.lines.frequency[rich].tolist()})
        where = f", most at {', '.join(f'{w:g}' for w in at[:NAMED])} rpm" if at else ""
        sentences.append(f"{name}: {shares[name]:.0%} of the averaging time{where}.")
    if plan.quantity:
        gains = [plan.even[name].noise / plan.expected[name].noise for name in plan.quantity]
        if all(math.isfinite(gain) for gain in gains):
            factor = math.exp(sum(map(math.log, gains)) / len(gains))
            by_noise = "by the noise " if plan.expectation.causes else ""
            sentences.append(
                f"With as much time for every line the errors of {_aim(plan)} {by_noise}would be "
                f"{significant(factor, 2)} times as large."
            )
    return sentences


def _floors(plan: Plan) -> list[str]:
    """What no averaging lowers, by the cause on trust that it mostly rests on, and what would tell that cause."""
    weighty = 0.5  # share of a floor in an error from which more averaging is hardly worth it
    resting: dict[str, list[str]] = {}
    for name in plan.quantity or tuple(plan.expected):
        one = plan.expected[name]
        if one.floor is not None and math.isfinite(one.stderr) and one.floor.stderr > weighty * one.stderr:
            resting.setdefault(one.floor.largest_on_trust, []).append(f"{name} at {percent(one.at_floor)}")
    causes = {cause.name: cause for cause in plan.expectation.causes}
    return [
        f"However long such lines are averaged, errors stay: {', '.join(names)}, resting on {cause} "
        f"{size_of(causes[cause])} ({causes[cause].meaning}); to bound it, {causes[cause].remedy}."
        for cause, names in resting.items()
    ]


def _averaging(task: Task, plan: Plan, name: str, wanted: float) -> float:
    """Times the averaging that brings a quantity to a relative error, infinite where none does."""
    one, found = plan.expected[name], plan.expectation
    if one.floor is None:
        return (one.relative / wanted) ** 2
    if one.floor.stderr >= wanted * abs(one.value):
        return math.inf
    target = {name: all_targets(found.problem.space, task.quantity, task.band)[0][name]}
    low, high = 1.0, 1e8
    for _ in range(20):  # to a factor of one in a hundred thousand
        middle = math.sqrt(low * high)
        longer = errors_of(found.longer(np.full(found.constant.size, middle)), target)[name]
        low, high = (middle, high) if longer.relative > wanted else (low, middle)
    return high


def _for_wanted(task: Task, plan: Plan, wanted: float | None) -> list[str]:
    if wanted is None:
        return []
    sentences, goal = [], f"{significant(100 * wanted, 2)} %"
    for name in plan.quantity or tuple(plan.expected):
        one, average = plan.expected[name], float(plan.lines.average.sum())
        factor = _averaging(task, plan, name, wanted)
        if not math.isfinite(one.stderr):
            sentences.append(f"No averaging brings {name} to {goal}: this test leaves it open.")
        elif one.relative <= wanted:
            sentences.append(f"{name} comes to {percent(one)}, within the {goal} that are wanted.")
        elif math.isinf(factor):
            sentences.append(f"No averaging brings {name} from {percent(one)} to {goal}: causes on trust hold it.")
        else:
            more = "" if math.isnan(average) else f", {duration(average * (factor - 1))} more"
            take = f"{goal} take {significant(factor, 3)} times the averaging{more}"
            sentences.append(f"{name} comes to {percent(one)}; {take}.")
    return sentences
