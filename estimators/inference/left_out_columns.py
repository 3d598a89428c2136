"""Effect of terms that a model leaves out on its predictions, reading by reading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from rotorfit.estimators.blocks.correlated import whiten
from rotorfit.estimators.blocks.nonlinear import OrbitResponses, responses_of
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.blocks.response import dynamic_stiffness, inverse
from rotorfit.estimators.blocks.small_motion import FreeVibrations, OffCentreResponses
from rotorfit.estimators.inference.smooth_causes import Cause, cause_change, load_change
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.motion.neglected_terms import LeftOut


@dataclass(frozen=True, kw_only=True)
class Offset:
    """A probe or a force that is not at its plane, but a share of the way towards another."""

    kind: str  # "probe" or "force"
    at: int  # coordinate at which it is taken to be
    towards: int  # coordinate towards which it lies


@dataclass(frozen=True)
class Clearance:
    """The radial clearance that a model with a law of eccentricity takes as known; its size is a share of it."""


@dataclass(frozen=True, kw_only=True)
class Gain:
    """A gain that all readings share, of the force or of the chain, or those of one coordinate; its size is a share."""

    at: int | None = None  # coordinate


@dataclass(frozen=True, kw_only=True)
class Rest:
    """A journal that rests off centre. A model without a law of eccentricity sees the fluid of that place."""

    change: Float  # of the parameters by one unit of eccentricity, from that place to the centre, shape ``(P,)``
    eccentricity: float  # of which that is the secant


Term: TypeAlias = LeftOut | Offset | Clearance | Gain | Rest | Cause | int
"""A term of the equation of motion, an offset, the clearance, a gain, the place at rest, a smooth cause by a unit of
its size, or the place of a known parameter of the model."""


def whitened_columns(problem: Problem, x: Float, terms: Sequence[Term]) -> ComplexArray:
    """Derivatives of the whitened residuals by terms left out, shape ``(R, T)``."""
    theta = problem.space.theta(x)
    parts = []
    for number, block in enumerate(problem.blocks):
        changes = np.array([term_change(block, theta, term) for term in terms]).reshape(len(terms), block.measured.size)
        if problem.factors and problem.factors[number] is not None:
            nuisance = np.asarray(problem.factors[number]) @ x[len(problem.space.names) :]
            changes = changes * np.exp(nuisance)
        parts.append(whiten(block, changes).T)
    return np.concatenate(parts)


def is_linear(block: Block) -> bool:
    """True if a block holds responses of a linear rotor to circular forces, which left-out terms act on."""
    base = responses_of(block)
    return isinstance(base, Responses) and not isinstance(block, OrbitResponses) and not base.imposed


def _resized(block: Block, factor: float) -> Block:
    """A block in a bearing of another clearance, positions in metres kept; eccentricities that were given stay."""
    if not isinstance(block, OrbitResponses | OffCentreResponses | FreeVibrations):
        return block
    model = block.model.variant(clearance_um=1e6 * factor * (block.model.clearance or 0.0))
    eccentricity = block.eccentricity / factor
    if isinstance(block, OrbitResponses):
        return replace(block, base=replace(block.base, model=model), eccentricity=eccentricity)
    if isinstance(block, FreeVibrations):
        eccentricity = np.where(block.position_read, eccentricity, block.eccentricity)
    return replace(block, model=model, eccentricity=eccentricity)


def _resting(block: OrbitResponses, theta: Float, eccentricity: float) -> ComplexArray:
    """Change by a unit of eccentricity at rest, where a constant load moves the journal; static loads show theirs."""
    load = eccentricity / float(block.compliance(theta).mean())
    return load_change(block, theta, load) / eccentricity


def term_change(block: Block, theta: Float, term: Term) -> ComplexArray:
    """Change of the predictions of a block by a unit of a term, shape ``(R,)``."""
    if isinstance(term, Cause):
        return cause_change(block, theta, term)
    step = 1e-4  # share of the clearance for a central difference: truncated at 1e-8, rounded at 1e-12
    base = responses_of(block)
    change: ComplexArray = np.zeros(block.measured.size, dtype=complex)
    if isinstance(term, int):
        change = block.predict_jacobian(theta)[1][:, term]
    elif isinstance(term, Clearance):
        up, down = (_resized(block, 1 + sign * step).predict(theta) for sign in (1, -1))
        change = (up - down) / (2 * step)
    elif isinstance(term, Rest) and isinstance(block, OrbitResponses):
        change = _resting(block, theta, term.eccentricity)
    elif isinstance(term, Gain) and base is not None:
        change = np.where(term.at is None or base.coordinate == term.at, block.predict(theta), 0.0)
    elif isinstance(term, Rest) and is_linear(block):
        change = -block.predict_jacobian(theta)[1] @ term.change
    elif isinstance(term, LeftOut | Offset) and base is not None and is_linear(block):
        change = _linear_change(base, theta, term)
    return np.asarray(change)


def _linear_change(base: Responses, theta: Float, term: LeftOut | Offset) -> ComplexArray:
    H = inverse(dynamic_stiffness(base, theta))
    line, read = base.line, base.coordinate
    amplitude = np.einsum("lij,lj->li", H, base.force)
    if isinstance(term, LeftOut):
        factor = term.factor(base.s, base.speed)
        pressed = np.zeros_like(amplitude)
        for i, j, weight in term.entries:
            pressed[:, i] += weight * factor * amplitude[:, j]
        change = -np.einsum("lij,lj->li", H, pressed)[line, read]
    elif term.kind == "probe":
        change = np.where(read == term.at, amplitude[line, term.towards] - amplitude[line, term.at], 0.0)
    else:
        moved = base.force[:, term.at, None] * (H[:, :, term.towards] - H[:, :, term.at])
        change = moved[line, read]
    functions = base.model.functions
    if functions.has_probe_factors:
        change = change * functions.factors(theta)[base.reading_group, read]
    return np.asarray(change)
