"""Plan a test: the errors to expect, the best use of its time, and what it leaves open."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from types import MappingProxyType
from typing import Any

import numpy as np

from rotorfit.base.array_types import Float
from rotorfit.base.chance import Seed, seed_of
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.inference.optimal_shares import Lines
from rotorfit.identify.fitting.causes.calibration import Calibration
from rotorfit.identify.fitting.problem_setup import as_tuple, each_of
from rotorfit.identify.fitting.result import FitResult
from rotorfit.identify.fitting.settings import FitSettings, PhaseOffsets
from rotorfit.identify.uncertainty.posterior import Posterior
from rotorfit.lab.data.rows import Experiment
from rotorfit.models import RotorModel
from rotorfit.models.motion.stability import stability_band
from rotorfit.studies.planning.design import Design
from rotorfit.studies.planning.guesses import Values
from rotorfit.studies.planning.noise import NoiseOfFit, PlannedNoise
from rotorfit.studies.planning.record import Plan
from rotorfit.studies.planning.suggestions import Choices, suggest
from rotorfit.studies.planning.targets import Wanted, all_targets
from rotorfit.studies.planning.task import Task, errors_of


def plan(
    model: RotorModel,
    values: Values,
    tests: Experiment | Design | Sequence[Experiment | Design],
    *,
    noise_um: float | Mapping[str, float] | None = None,
    noise_share: float = 0.0,
    common_share: float = 0.0,
    memory: float | Sequence[float] = 0.0,
    runs: Mapping[str, float] | None = None,
    quantity: Wanted = None,
    wanted: float | None = None,
    known: Mapping[str, float | tuple[float, float] | None] | None = None,
    priors: Mapping[str, Any] | None = None,
    per: Mapping[str, str] | None = None,
    phase_offsets: PhaseOffsets = False,
    calibration: Calibration | None = None,
    causes: Mapping[str, float] | None = MappingProxyType({}),
    even: float = 0.3,
    draws: int = 16,
    rng: Seed = None,
    seed: Seed = None,
) -> Plan:
    """Say before a test which errors it will give, what it leaves open, and how its time is best spent.

    The test is laid out as the problem that its fit will solve, with the readings that the guessed rotor would give.

    Args:
        model: the rotor.
        values: its parameters by name, SI: a number, a range ``(low, high)`` or a frozen ``scipy.stats`` distribution;
            or an earlier fit or posterior, whose known values, causes and noise then hold where nothing else is said.
        tests: experiments as patterns, whose readings do not count, and at most one :class:`Design`: what the rig can
            do beyond these. Frequencies of an impulse test say which mode it excites.
        noise_um: standard deviation of the real and of the imaginary part of a reading, um (urad for slopes), one or by
            plane; unless given, the noise that the earlier fit found, or the patterns' sigma, which other tests than
            those of responses need in any case.
        noise_share: further noise of each reading, over its size.
        common_share: the same, common to all probes of a line: jitter of force or speed.
        memory: correlation of the noise of neighbouring lines, as by overlapping filters, falling as its powers; or the
            correlations at distances of 1, 2, ... lines.
        runs: standard deviations of differences from run to run, by kind: force, phase (rad), K0, D, lam, fluid.
        quantity: what the test is for: a name, several, a function of the parameters, or functions by name; unless
            given, all parameters together.
        wanted: relative standard error that the quantity is to have.
        known, priors, per, phase_offsets, calibration, causes: as the fit will have them; see :func:`rotorfit.fit`.
            Errors are those that it will print, causes included.
        even: part of the averaging time that is spread over all lines alike, against errors of the model.
        draws: vectors drawn where values are not numbers.
        rng: of the draws, a generator or its seed, 0 by default.
        seed: the same.

    Raises:
        TypeError: values or tests of another kind.
        KeyError: unknown parameters or quantities; the message names the nearest.
        ValueError: a speed at which the rotor is unstable, planes that the model has not, limits that nothing can meet,
            noise that is not known.

    Example:
        >>> design = rf.Design(speed_rpm=[1000, 1500, 2000], frequency_rpm=range(200, 2001, 200), force_N=5.0)
        >>> plan = rf.plan(rf.models.WhirlWhip(), fit, design, noise_um=0.5, quantity="lam", known={"K3": 6000.0})
        >>> plan.certificate.optimal, plan.expected["lam"].stderr < plan.even["lam"].stderr
        (True, True)
    """
    if not (isinstance(even, int | float) and 0 < even <= 1):
        raise ValueError(f"even is {even!r}; it is a part of the time, above 0 and up to 1")
    if isinstance(draws, bool) or not isinstance(draws, int) or draws < 1:
        raise ValueError(f"draws is {draws!r}; a whole number from 1 is needed")
    if wanted is not None and not (isinstance(wanted, int | float) and 0 < wanted < math.inf):
        raise ValueError(f"wanted is {wanted!r}; a relative standard error above zero is needed, 0.01 for 1 %")
    if not isinstance(model, RotorModel):
        raise TypeError(f"the model must be an instance such as rf.models.WhirlWhip(), not {model!r}")
    patterns, design = _apart(tests)
    earlier = values.fit if isinstance(values, Posterior) else values
    given = (noise_um, runs, memory) != (None, None, 0.0) or bool(noise_share or common_share)
    found = before = None
    if isinstance(earlier, FitResult):
        known = earlier.settings.known if known is None else known
        calibration = earlier.settings.calibration if calibration is None else calibration
        causes = None if earlier.settings.causes is None and not causes else causes
        found = None if given else NoiseOfFit.of(earlier)
        before = None if causes else _sizes_of(earlier)
    settings = FitSettings(
        known=known or {},
        priors=priors or {},
        per=each_of(model, per or {}, known or {}),
        phase_offsets=phase_offsets,
        calibration=calibration,
        causes=None if causes is None else dict(causes),
    )
    noise = PlannedNoise(
        additive=noise_um, share=noise_share, common=common_share, memory=memory if found is None else found.memory,
        runs=(runs or {}) if found is None else found.runs, found=found,
    )  # fmt: skip
    task = Task(
        model=model, values=values, patterns=patterns, settings=settings, noise=noise, quantity=quantity,
        even=float(even), draws=draws, seed=seed_of(rng, seed, 0), before=before,
        band=_band(model, earlier, patterns, design),
    )  # fmt: skip
    chosen, choices = (None, []) if design is None else with_best_speeds(task, design)
    made = task.solved(chosen)
    return replace(made, suggestions=suggest(task, made, chosen, choices, wanted))


def _sizes_of(fit: FitResult) -> Mapping[str, float]:
    """Sizes of causes that an earlier fit was given, and those that its data raised."""
    solved, given = fit.settings.solved, fit.settings.sizes
    if solved is None:
        return given
    every = solved.factor > 1
    return {**given, **{c.name: c.size for c in solved.causes if every or c.name in solved.raised}}


def _band(model: RotorModel, earlier: Any, patterns: Sequence[Experiment], design: Design | None) -> float:
    """Eigenvalues that count: with terms that hold in a band, those of the earlier fit's, else of the test's."""
    tested = [np.abs(test.frequencies).max(initial=0.0) for test in patterns]
    tested += [] if design is None else [design.frequencies.max()]
    return stability_band(model, earlier.band if isinstance(earlier, FitResult) else float(max(tested)))


def _apart(tests: Any) -> tuple[tuple[Experiment, ...], Design | None]:
    """Patterns and the design."""
    several = tuple(tests) if isinstance(tests, Sequence) and not isinstance(tests, str) else (tests,)
    designs = [one for one in several if isinstance(one, Design)]
    patterns = [one for one in several if not isinstance(one, Design)]
    for one in several:
        if not isinstance(one, Design | Experiment):
            raise TypeError(f"a plan needs experiments such as rf.read returns, or an rf.Design, not {one!r:.80}")
    if len(designs) > 1:
        raise ValueError(f"{len(designs)} designs; give one, with all speeds, planes and frequencies that are possible")
    if not designs or patterns:
        patterns = list(as_tuple(patterns))
    return tuple(patterns), designs[0] if designs else None


# ---- which of the possible speeds to run -----------------------------------------------------------------------------


def with_best_speeds(task: Task, design: Design) -> tuple[Design, Choices]:
    """The design with as many speeds as can be run, those of the even test with the least errors, and all choices."""
    count = design.speed_count
    if count is None or count == design.speeds.size:
        return design, []
    whole = replace(design, speed_count=None)
    test = task.candidates(whole)
    found = task.expect(test)
    targets, names = all_targets(found.problem.space, task.quantity, task.band)
    first = sum(block.measured.size for block in found.problem.blocks[: len(task.patterns)])
    errors = errors_of(found, targets)
    asked = [name for name in names or tuple(targets) if math.isfinite(errors[name].stderr)]
    lines, _ = task.lines(found, [targets[name] for name in asked if names or found.causes], first, found.told | True)
    speed = test.speed[test.lines_apart[0]]
    order = sorted(_compared(lines, speed, design.speeds, count).items(), key=lambda choice: choice[1])
    speeds, best = order[0]
    # The criterion is a mean logarithm of variances.
    choices = [(chosen, math.exp((criterion - best) / 2)) for chosen, criterion in order]
    return replace(whole, speed_rpm=np.array(speeds) * RPM_PER_RAD_S), choices


def _compared(lines: Lines, speed: Float, speeds: Float, count: int) -> dict[tuple[float, ...], float]:
    """Criterion of an even test at each choice of speeds."""

    def criterion(chosen: tuple[float, ...]) -> float:
        # Weight of lines at other speeds, so that a quantity that the chosen ones do not determine has a huge variance
        trace = 1e-9
        return lines.criterion(np.where(np.isin(speed, chosen), 1.0, trace))

    possible = speeds.tolist()
    most_choices = 2000  # choices of speeds that are all compared; of more, speeds are exchanged one by one
    if math.comb(len(possible), count) <= most_choices:
        return {chosen: criterion(chosen) for chosen in combinations(possible, count)}
    spread = np.unique(np.round(np.linspace(0, len(possible) - 1, count)).astype(int))
    best = tuple(possible[i] for i in spread.tolist())
    found = {best: criterion(best)}
    while True:
        near = [tuple(sorted({*best, new} - {old})) for old in best for new in possible if new not in best]
        found |= {chosen: criterion(chosen) for chosen in near if chosen not in found}
        better = min(near, key=lambda chosen: found[chosen])
        if found[better] >= found[best]:
            return found
        best = better
