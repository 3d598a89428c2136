"""Sentences of a plan: what to measure, what to add and what that costs, what stays open."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from rotorfit.models.digits import significant
from rotorfit.planning.additions import NAMED, additions, percent
from rotorfit.planning.candidates import too_fast
from rotorfit.planning.design import Design
from rotorfit.planning.record import Plan, duration
from rotorfit.planning.speed_choice import Alternatives
from rotorfit.planning.task import Task
from rotorfit.units import RPM_PER_RAD_S


def suggest(
    task: Task, plan: Plan, design: Design | None, alternatives: Alternatives | None, wanted: float | None
) -> tuple[str, ...]:
    """All sentences of a plan."""
    found: list[str] = []
    if alternatives is not None:
        found.append(_speeds(plan, alternatives))
    runs = np.array(plan.lines.run)
    shares = {name: float(plan.share[runs == name].sum()) for name in dict.fromkeys(plan.lines.run)}
    if design is not None:
        found += _runs(plan, shares)
        slow = too_fast(design, task.model, task.vector(), task.band)
        found += [slow] if slow else []
    elif len(shares) > 1:  # tests are given as they are
        best, share = max(shares.items(), key=lambda one: one[1])
        words = f"Run {best} determines most of {_aim(plan)}: {share:.0%} of any further time would go there."
        found.append(words)
    found += _for_wanted(plan, wanted)
    found += additions(task, plan, design, wanted)
    return tuple(found)


def _aim(plan: Plan) -> str:
    return " and ".join(plan.quantity) if plan.quantity else "all parameters together"


def _speeds(plan: Plan, alternatives: Alternatives) -> str:
    best = _listed(alternatives.speeds[0])
    worst = _listed(alternatives.speeds[-1])
    return (
        f"Run at {best} rpm: of {len(alternatives.speeds)} choices of {len(alternatives.speeds[0])} speeds these leave "
        f"the smallest errors of {_aim(plan)}; with {worst} rpm they are "
        f"{significant(alternatives.ratio[-1], 2)} times as large."
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
        gains = [plan.even[name].stderr / plan.expected[name].stderr for name in plan.quantity]
        if all(math.isfinite(gain) for gain in gains):
            factor = math.exp(sum(map(math.log, gains)) / len(gains))
            sentences.append(
                f"With as much time for every line the errors of {_aim(plan)} would be {significant(factor, 2)} "
                "times as large."
            )
    return sentences


def _for_wanted(plan: Plan, wanted: float | None) -> list[str]:
    if wanted is None:
        return []
    sentences, goal = [], f"{significant(100 * wanted, 2)} %"
    for name in plan.quantity or tuple(plan.expected):
        one, average = plan.expected[name], float(plan.lines.average.sum())
        factor = (one.relative / wanted) ** 2
        if not math.isfinite(one.stderr):
            sentences.append(f"No averaging brings {name} to {goal}: this test leaves it open.")
        elif factor <= 1:
            sentences.append(f"{name} comes to {percent(one)}, within the {goal} that are wanted.")
        else:
            more = "" if math.isnan(average) else f", {duration(average * (factor - 1))} more"
            take = f"{goal} take {significant(factor, 3)} times the averaging{more}"
            sentences.append(f"{name} comes to {percent(one)}; {take}.")
    return sentences
