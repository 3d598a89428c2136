"""Which of the possible speeds of a test to run."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from math import comb
from typing import TypeAlias

import numpy as np

from rotorfit.estimators.inference.optimal_shares import Lines
from rotorfit.models.array_types import Float
from rotorfit.planning.design import Design
from rotorfit.planning.targets import all_targets
from rotorfit.planning.task import Task, errors_of
from rotorfit.units import RPM_PER_RAD_S

Choices: TypeAlias = list[tuple[tuple[float, ...], float]]
"""Choices of speeds, rad/s, best first, each with the standard errors of an even test over that of the best one."""


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
    lines, _ = task.lines(found, [targets[name] for name in names if math.isfinite(errors[name].stderr)], first)
    speed = test.speed[test.lines.apart()[1]]
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
    if comb(len(possible), count) <= most_choices:
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
