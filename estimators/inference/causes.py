"""Causes that a rig may have beside its model, each a column of changes of the predictions by a unit of its size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.estimators.blocks.caused import CausedResponses
from rotorfit.estimators.blocks.correlated import whiten
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.inference.cause_acts import (
    Act,
    Flexible,
    Motion,
    OffPlane,
    OfReadings,
    OfRotor,
    OfValues,
    SpeedLabel,
)
from rotorfit.estimators.misfit.problem import Problem


@dataclass(frozen=True, kw_only=True)
class Cause:
    """Something that the model does not hold and the rig may have."""

    name: str
    meaning: str  # in words
    unit: str  # of its size
    size: float  # standard uncertainty before the data
    act: Act
    one_sided: bool = False  # never negative
    reason: str = ""  # of its size
    source: str = ""
    remedy: str = ""  # what would tell it, or take it out
    parameter: str = ""  # of the model that is the same thing, known unless freed


def with_causes(problem: Problem, x: Float, causes: Sequence[Cause], sizes: Float) -> Problem:
    """The problem with causes of given sizes in its predictions: in full those of readings, and for linear rotors all,
    else to first order."""
    if not sizes.any():
        return problem
    theta = problem.space.theta(x)
    blocks = tuple(block_with_causes(block, theta, causes, sizes) for block in problem.blocks)
    return replace(problem, blocks=blocks)


def block_with_causes(block: Block, theta: Float, causes: Sequence[Cause], sizes: Float) -> Block:
    """As :func:`with_causes`, of one block at parameter vectors."""
    motion = Motion(block=block, theta=theta)
    acting = [(one.act, size) for one, size in zip(causes, sizes.tolist(), strict=True) if size]
    base = motion.linear
    if base is None or base is not block:
        whole, rest = _with_values(motion, acting)
        factors = [act.in_full(motion, size) for act, size in rest]
        others = [size * act.change(motion) for (act, size), own in zip(rest, factors, strict=True) if own is None]
        gain = np.exp(sum((own for own in factors if own is not None), 0j))
        moved = gain * (whole + sum(others, 0j)) - motion.predicted
        return block.with_measured(block.measured - moved)
    found = _values_with(base, acting)
    rotor, values = found.own, found.values(theta)
    parts = [part for act, size in acting if (part := act.stiffness(rotor, values, size)) is not None]
    stiffness = np.sum(parts, axis=0) if parts else None
    force, way, beside = base.force.copy(), np.zeros(base.line.size), np.zeros_like(base.force)
    towards = base.coordinate.copy()
    for act, size in acting:
        if isinstance(act, Flexible):
            beside = beside + size * act.moved(base)
        elif isinstance(act, OffPlane) and act.what == "force":
            force[:, act.at] -= size * base.force[:, act.at]
            force[:, act.towards] += size * base.force[:, act.at]
        elif isinstance(act, OffPlane):
            own = base.coordinate == act.at
            towards[own], way[own] = act.towards, size
    found = replace(found, force=force, stiffness=stiffness, towards=towards, way=way)
    moved = Motion(block=found, theta=theta).read(beside)
    found = found.with_readings(moved=moved, gain=found.gain, corner=0.0)
    moving = Motion(block=found, theta=theta)
    logarithms = [part for act, size in acting if (part := act.in_full(moving, size)) is not None]
    gain = np.exp(np.sum(logarithms, axis=0)) if logarithms else found.gain
    corner = sum(size for act, size in acting if isinstance(act, OfReadings) and act.how == "high-pass")
    return found.with_readings(moved=moved, gain=gain, corner=corner)


def _with_values(
    motion: Motion, acting: Sequence[tuple[Act, float]]
) -> tuple[ComplexArray, Sequence[tuple[Act, float]]]:
    """Predictions of a rotor that is not linear with the true speeds and values and with what acts on it, in full, and
    the other acts."""
    base, apart = motion.base, motion.block.apart
    if base is None or apart is None:
        return motion.predicted, acting
    _, group, speed = base.condition
    label = sum(size for act, size in acting if isinstance(act, SpeedLabel))
    changes = [(size, change) for act, size in acting if (change := act.changed(base.model, speed)) is not None]
    values = motion.theta[group] * (1 + sum((size * change[0] for size, change in changes), np.zeros(1)))
    values = values + sum((size * change[1] for size, change in changes), np.zeros(1))
    moved = apart.at_speeds(1 + label)
    if (own := moved.circular) is not None:
        parts = [act.stiffness(own, values, size) for act, size in acting if isinstance(act, OfRotor)]
        moved = moved.stiffened(np.sum([part for part in parts if part is not None], axis=0)) if parts else moved
    in_full = SpeedLabel | OfValues if own is None else SpeedLabel | OfValues | OfRotor
    rest = [(act, size) for act, size in acting if not isinstance(act, in_full)]
    return moved.predict(values), rest


def _values_with(block: Responses, acting: Sequence[tuple[Act, float]]) -> CausedResponses:
    """The responses with the true speeds and the values that the model has there."""
    speed = block.speed * (1 + sum(size for act, size in acting if isinstance(act, SpeedLabel)))
    at = block.condition[2] if not block.model.speed_dependent else replace(block, speed=speed).condition[2]
    changes = [(size, change) for act, size in acting if (change := act.changed(block.model, at)) is not None]
    shape, none = (at.size, len(block.model.parameter_names)), np.zeros(block.line.size)
    return CausedResponses(
        block,
        speed=speed,
        force=block.force,
        stiffness=None,
        scaled=sum((size * change[0] for size, change in changes), np.zeros(shape)),
        added=sum((size * change[1] for size, change in changes), np.zeros(shape)),
        towards=block.coordinate,
        way=none,
        moved=none.astype(complex),
        gain=np.ones(none.size, dtype=complex),
        high_pass=0.0,
    )


def columns(problem: Problem, x: Float, causes: Sequence[Cause]) -> ComplexArray:
    """Changes of the whitened residuals by a unit of each cause, shape ``(R, k)``."""
    theta, begin = problem.space.theta(x), 0
    found = np.empty((len(causes), problem.n_data // 2), dtype=complex)
    for number, block in enumerate(problem.blocks):
        motion = Motion(block=block, theta=theta)
        factor: ComplexArray | float = 1.0
        if problem.factors and problem.factors[number] is not None:
            factor = np.exp(np.asarray(problem.factors[number]) @ x[len(problem.space.names) :])
        here = slice(begin, begin + block.measured.size)
        for row, one in zip(found, causes, strict=True):
            row[here] = whiten(block, one.act.change(motion) * factor)
        begin += block.measured.size
    return found.T
