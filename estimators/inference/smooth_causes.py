"""Smooth causes that a test may have beside the model, as changes of its predictions: few columns each.

Residuals that exceed the noise, and runs that differ, have a fixed cause more often than a random one: a probe that is
not linear, a fluid that stiffens with amplitude, a filter, a damping that drifts or is not viscous, values that change
with speed. To first order each is a column or a few beside those of the fitted values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.estimators.blocks.correlated import whiten
from rotorfit.estimators.blocks.nonlinear import OrbitResponses, responses_of
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.blocks.response import dynamic_stiffness, inverse, probe_factors
from rotorfit.estimators.blocks.set_speeds import once_per_turn
from rotorfit.estimators.blocks.term_sums import sums_terms
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models.model import RotorModel
from rotorfit.models.motion.neglected_terms import LeftOut, fluid_coordinates

FLUID = ("K0", "D", "lam")
"""Values of the fluid that may change with speed; lam stands for lam_D and lam_M too, as they turn together."""


class Kind(StrEnum):
    """Smooth cause."""

    PROBE = "probe amplitude"  # a probe that is not linear
    FLUID = "fluid amplitude"  # a fluid that changes with the journal's amplitude
    DELAY = "delay"  # a delay or a low-pass filter, also a phase reference that drifts along the sweep
    CLOCK = "clock"  # a delay that grows along the sweep, as where marks are sampled by a clock of their own
    DRIFT = "drift"  # damping that changes while a sweep goes on
    HYSTERESIS = "hysteresis"  # damping that does not grow with frequency
    SUPPORT = "supports"  # stiffness that differs in x and y, seen by one probe
    PAIR = "supports by both probes"  # the same, of which pairs of probes see the square
    ELSEWHERE = "fluid elsewhere"  # a second seal
    LOAD = "static load"  # that moves the orbits of a law of eccentricity off the centre
    RESIDUAL = "residual unbalance"  # that start-ups hold beside their weight
    SPEED = "change with speed"  # of a value of the fluid
    BEND = "bend with speed"  # of a value whose change in proportion to the speed is fitted


MEANINGS = {
    Kind.PROBE: ("probe that is not linear, share at the largest amplitude", "1"),
    Kind.FLUID: ("change of K0 at the largest amplitude, of D and D lam with it", "N/m"),
    Kind.DELAY: ("delay, filter or drifting phase reference", "s"),
    Kind.CLOCK: ("growth of a delay along a sweep, from its middle to its end", "s"),
    Kind.DRIFT: ("drift along a sweep, share from its middle to its end", "1"),
    Kind.HYSTERESIS: ("damping that does not grow with frequency", "N/m"),
    Kind.SUPPORT: ("half the difference of stiffness in x and y, seen by one probe", "N/m"),
    Kind.PAIR: ("square of half the difference of stiffness in x and y, by both probes", "N^2/m^2"),
    Kind.ELSEWHERE: ("D lam of a fluid where the model has none", "N s/m"),
    Kind.LOAD: ("square of a constant load, which moves the journal off the centre", "N^2"),
    Kind.RESIDUAL: ("unbalance of the rotor itself, which start-ups hold beside their weight", "kg m"),
}
"""Quantity that the size of a cause refers to, and its unit."""


_AT_PROBES = ((Kind.PROBE, 1), (Kind.DELAY, 1), (Kind.SUPPORT, 2), (Kind.PAIR, 1))
"""Causes at planes that are read, and their columns."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """One column of a cause, by a unit of its size."""

    kind: Kind
    at: int | None = None  # coordinate, none for all
    plane: str = ""  # its name
    power: int = 0  # which of several columns: stiffness, damping, cross-coupled damping; real and imaginary part
    value: str = ""  # parameter that changes
    centre: float = 0.0  # of the speeds or frequencies that it changes with, rad/s
    reach: float = 1.0  # largest amplitude, m, or the speeds' or frequencies' reach, rad/s, at which the size holds

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", Kind(self.kind))  # files hold its value


@dataclass(frozen=True, kw_only=True)
class Cause:
    """Columns that stand for one cause together, with the size of each once it is known."""

    parts: tuple[Part, ...]
    sizes: tuple[float, ...] = ()

    @property
    def kind(self) -> Kind:
        """Kind of the cause."""
        return self.parts[0].kind

    @property
    def name(self) -> str:
        """Its name in tables."""
        part = self.parts[0]
        return f"{self.kind.value}[{part.value or part.plane or 'all channels'}]"

    @property
    def size(self) -> float:
        """Size of the first column, of both where they are parts of a complex number."""
        if not self.sizes:
            return 1.0
        return math.hypot(*self.sizes) if self.kind in (Kind.SUPPORT, Kind.RESIDUAL) else self.sizes[0]

    @property
    def shares(self) -> Float:
        """Size of each part by a unit of :attr:`size`."""
        return np.array([size / self.size for size in self.sizes]) if self.sizes else np.ones(len(self.parts))


def causes_of(problem: Problem, x: Float) -> list[Cause]:
    """Causes that tests of a rotor in complex coordinates could show; with a law of eccentricity a static load."""
    blocks = [base for base in map(_base, problem.blocks) if base is not None]
    model = problem.space.model
    orbits = [block for block in problem.blocks if isinstance(block, OrbitResponses) and not block.base.imposed]
    if orbits and len(orbits) == len(problem.blocks):
        stiffness = 1 / np.concatenate([np.ravel(block.compliance(problem.space.theta(x))) for block in orbits])
        part = Part(kind=Kind.LOAD, plane=model.coordinates[orbits[0].journal.at].plane, reach=float(stiffness.mean()))
        return [Cause(parts=(part,))]
    if len(blocks) != len(problem.blocks) or model.frame != "z" or any(c.axis != "z" for c in model.coordinates):
        return []
    read = sorted({int(k) for base in blocks for k in np.unique(base.coordinate)})
    fluid = fluid_coordinates(model)
    theta = problem.space.theta(x)
    motion = np.concatenate([np.abs(Motion(base=base, theta=theta).planes) for base in blocks]).max(axis=0)
    w = np.abs(np.concatenate([base.frequency for base in blocks]))
    middle, half = float(w.max() + w.min()) / 2, float(w.max() - w.min()) / 2
    planes = [c.plane for c in model.coordinates]
    asked: list[tuple[Kind, int | None, int]] = [(Kind.DELAY, None, 1)]
    start_ups = all(once_per_turn(base.frequency, base.speed).all() for base in blocks)
    for at in range(len(planes)):
        asked += [(Kind.RESIDUAL, at, 2)] * start_ups
        asked += [(kind, at, columns) for kind, columns in _AT_PROBES if at in read]
        asked += [(Kind.HYSTERESIS, at, 1), (Kind.FLUID if at in fluid else Kind.ELSEWHERE, at, 3)]
    found = []
    for kind, place, columns in asked:
        where = Part(kind=kind)
        if place is not None:
            where = Part(kind=kind, at=place, plane=planes[place], reach=float(motion[place]))
        powers = range(columns)[:: -1 if kind is Kind.ELSEWHERE else 1]  # what is there may have stiffness and damping
        found.append(Cause(parts=tuple(replace(where, power=power) for power in powers)))
    if half > 0:
        clock = Part(kind=Kind.CLOCK, centre=middle, reach=half)
        found.append(Cause(parts=(clock, replace(clock, power=1))))
    if fluid and half > 0:
        found.append(Cause(parts=(Part(kind=Kind.DRIFT, value="D", centre=middle, reach=half),)))
    return [*found, *changes_with_speed(problem)]


def changes_with_speed(problem: Problem) -> list[Cause]:
    """A change of each value of the fluid in proportion to the speed, its size the share at twice the mean speed; in
    proportion to its square where a law has the former."""
    blocks = [base for base in map(_base, problem.blocks) if base is not None]
    model = problem.space.model
    if not blocks or not model.speed_dependent or problem.space.index.shape[0] > 1:
        return []
    mean = float(np.unique(np.abs(np.concatenate([base.set_speed for base in blocks]))).mean())
    if mean == 0:
        return []
    names = set(model.parameter_names)
    return [
        Cause(parts=(Part(kind=kind, value=name, centre=mean, reach=mean),))
        for name in FLUID
        for kind in [Kind.BEND if f"{name}_speed" in names else Kind.SPEED]
        if names & {name, f"{name}_D"}
    ]


def cause_columns(problem: Problem, x: Float, causes: Sequence[Cause]) -> ComplexArray:
    """Change of the whitened residuals by a unit of each part, causes in a row, shape ``(R, parts)``."""
    parts = [part for cause in causes for part in cause.parts]
    return whitened(problem, x, lambda block, theta: _changes(block, theta, parts))


def whitened(problem: Problem, x: Float, changes_of: Callable[[Block, Float], ComplexArray]) -> ComplexArray:
    """Changes of the whitened residuals, shape ``(R, k)``, by those of the predictions of each block, ``(k, R)``."""
    theta, rows = problem.space.theta(x), []
    for number, block in enumerate(problem.blocks):
        changes = changes_of(block, theta)
        if problem.factors and problem.factors[number] is not None:
            changes = changes * np.exp(np.asarray(problem.factors[number]) @ x[len(problem.space.names) :])
        rows.append(whiten(block, changes).T)
    return np.concatenate(rows)


def cause_change(block: Block, theta: Float, cause: Cause) -> ComplexArray:
    """Change of the predictions of a block by a unit of the size of a cause, shape ``(R,)``."""
    return np.asarray(cause.shares @ _changes(block, theta, cause.parts))


def changed_values(model: RotorModel, theta: Float, value: str) -> Float:
    """The values of parameter vectors that change where one of the fluid does, zero for the others, ``(..., P)``."""
    own = {value, f"{value}_D", f"{value}_M"}
    return np.where([name in own for name in model.parameter_names], theta, 0.0)


def beyond(part: Part, tested: Float) -> Float:
    """Quantity that a part grows with: the distance from its centre, or its square."""
    return np.asarray(((tested - part.centre) / part.reach) ** (2 if part.kind is Kind.BEND else 1))


def onset_terms(cause: Cause, whirl: float) -> list[LeftOut]:
    """Terms of the equation of motion that a unit of the size of a cause is at the onset of instability."""
    terms = []
    for part, share in zip(cause.parts, cause.shares.tolist(), strict=True):
        if part.at is None or part.kind not in (Kind.HYSTERESIS, Kind.ELSEWHERE):
            continue
        turns = part.kind is Kind.ELSEWHERE and part.power == 2
        factor = 1j * np.sign(whirl) if part.kind is Kind.HYSTERESIS else -1j if turns else 1.0
        acting = ((factor, int(part.power == 1), int(turns)),)
        terms.append(LeftOut("", "", "", ((part.at, part.at, share),), acting))
    return terms


def _changes(block: Block, theta: Float, parts: Sequence[Part]) -> ComplexArray:
    """Change of the predictions of a block by a unit of each part, shape ``(parts, R)``."""
    base = _base(block)
    shown_place = 0.1  # eccentricity by a static load whose effect is taken for that of its square
    if isinstance(block, OrbitResponses) and all(part.kind is Kind.LOAD for part in parts):
        loads = [shown_place * part.reach for part in parts]
        return np.array([load_change(block, theta, load) / load**2 for load in loads])
    if base is None:
        return np.zeros((len(parts), block.measured.size), dtype=complex)
    motion = Motion(base=base, theta=theta)
    return np.array([_change(motion, part) for part in parts]).reshape(len(parts), -1)


def load_change(block: OrbitResponses, theta: Float, load: float) -> ComplexArray:
    """Change of the predictions of a block by a constant load at the journal, shape ``(R,)``; none of static tests."""
    moving = block.base.frequency[block.base.line] != 0
    return np.asarray(np.where(moving, block.under_load(theta, load) - block.under_load(theta, 0.0), 0.0))


def _base(block: Block) -> Responses | None:
    """Responses of a linear rotor to circular forces; nothing for other blocks, nor where each probe has numbers of its
    own for every mode, which take up what its chain does."""
    base = responses_of(block)
    if not isinstance(base, Responses) or isinstance(block, OrbitResponses) or base.imposed or sums_terms(base):
        return None
    return base if base.frequency.any() else None


@dataclass(frozen=True, eq=False, kw_only=True)
class Motion:
    """Predicted motion of a block, and what changes of it are made of, each worked out once."""

    base: Responses
    theta: Float

    @cached_property
    def receptance(self) -> ComplexArray:
        """Shape ``(L, n, n)``."""
        return inverse(dynamic_stiffness(self.base, self.theta))

    @cached_property
    def mirrored(self) -> ComplexArray:
        """Conjugate of the receptance at -w, likewise."""
        other = replace(self.base, frequency=-self.base.frequency)
        return np.asarray(inverse(dynamic_stiffness(other, self.theta)).conj())

    @cached_property
    def planes(self) -> ComplexArray:
        """Motion of all planes, shape ``(L, n)``."""
        return np.asarray(np.einsum("lij,lj->li", self.receptance, self.base.force))

    @cached_property
    def factors(self) -> ComplexArray:
        """Factor of the probe of each reading, shape ``(R,)``."""
        return probe_factors(self.base, self.theta)

    @cached_property
    def by_theta(self) -> ComplexArray:
        """Derivatives of the predictions by the parameters, shape ``(R, P)``."""
        return self.base.predict_jacobian(self.theta)[1]


def _change(motion: Motion, part: Part) -> ComplexArray:
    """Change of the predictions of a block by a unit of a part of a cause, shape ``(R,)``."""
    base, z, at = motion.base, motion.planes, part.at
    line, read = base.line, base.coordinate
    pressed: ComplexArray
    match part.kind:
        case Kind.PROBE:
            own = z[line, read] * np.abs(z[line, read] / part.reach) ** 2
            return np.asarray(np.where(read == at, own * motion.factors, 0.0))
        case Kind.DELAY | Kind.CLOCK:
            grows = part.kind is Kind.CLOCK and part.power == 0
            along = (np.abs(base.frequency) - part.centre) / part.reach if grows else np.ones(base.s.size)
            own = -(base.s * along)[line] * z[line, read] * motion.factors
            return np.asarray(np.where(read == (read if at is None else at), own, 0.0))
        case Kind.DRIFT | Kind.SPEED | Kind.BEND:
            tested = np.abs(base.frequency if part.kind is Kind.DRIFT else base.speed)
            values = changed_values(base.model, motion.theta[base.group], part.value)[line]
            return np.asarray(np.sum(motion.by_theta * values, axis=1) * beyond(part, tested)[line])
        case Kind.SUPPORT:  # dK conj(z) couples w with -w, and one probe reads A + conj(B)
            against = motion.mirrored[:, :, at] * z[:, at, None]
            return np.asarray(-(1j**part.power) * against[line, read] * motion.factors)
        case Kind.RESIDUAL:
            own = 1j**part.power * base.frequency[:, None] ** 2 * motion.receptance[:, :, at]
            return np.asarray(own[line, read] * motion.factors)
        case Kind.PAIR:
            pressed = -motion.mirrored[:, at, at]
        case Kind.HYSTERESIS:
            pressed = 1j * np.sign(base.frequency)
        case _:  # stiffness, damping and cross-coupled damping of a fluid
            pressed = np.array([np.ones(base.s.size), base.s, -1j * base.speed])[part.power]
            if part.kind is Kind.FLUID:
                pressed = pressed * np.abs(z[:, at] / part.reach) ** 2
    return np.asarray(-(motion.receptance[:, :, at] * (pressed * z[:, at])[:, None])[line, read] * motion.factors)
